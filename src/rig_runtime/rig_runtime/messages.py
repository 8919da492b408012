"""Between numpy and messages."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Vector3


def set_vector(vector: Vector3, values: np.ndarray) -> None:
    """Write three numbers into a message's vector."""
    vector.x, vector.y, vector.z = values.tolist()
