"""The admittance-controlled robot: a force becomes the motion of an end effector.

    m v' + b v = f    on each free axis,    M(s) = 1/(m s + b)

The force is held over a sample, so the model is discretised exactly (zero-order hold): with z = b h/m,
phi = (1 - e^-z)/z, psi = (z - 1 + e^-z)/z^2 and a_0 = (f - b v)/m,

    mean acceleration = phi a_0,    v <- v + h phi a_0,    p <- p + h v + h^2 psi a_0.

For b = 0 the mean acceleration is f/m to the last bit. The drives are ideal: the velocity is the model's reference
velocity. An axis that is not free is held by springs so stiff that it does not move. Source: the paper, Fig. 1 and
'Experimental Platform'.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from shared_control.parameters import parameter
from shared_control.tasks.task import SAMPLE_TIME, Array, Robot

__all__ = ["Admittance", "AdmittanceConfig", "Motion"]


class Motion(NamedTuple):
    """Motion over one sample, each (3,): x along the cart's path, z up."""

    position: Array  # [m] at the end of the sample
    velocity: Array  # [m/s] at the end of the sample
    acceleration: Array  # [m/s^2] mean over the sample
    reference_velocity: Array  # [m/s] of the admittance model, at the end of the sample


@dataclasses.dataclass(frozen=True)
class AdmittanceConfig:
    """Parameters of the robot besides its apparent mass and damping, which are the loop's."""

    free_axes: tuple[bool, ...] = parameter(
        (True, False, False), "Which of x, y, z move; the others are held to the cart's path.", length=3
    )


class Admittance:
    """Three axes of M(s), sampled."""

    def __init__(
        self, config: AdmittanceConfig | None = None, robot: Robot | None = None, *, sample_time: float = SAMPLE_TIME
    ) -> None:
        self.config = AdmittanceConfig() if config is None else config
        self.robot = robot = robot or Robot()
        self._free = [axis for axis in range(3) if self.config.free_axes[axis]]
        self._h = float(sample_time)
        z = robot.damping * self._h / robot.mass
        # Below this the series is exact to rounding and the quotients are not.
        small = z < 1e-4
        self._phi = 1.0 - z / 2.0 + z * z / 6.0 if small else -math.expm1(-z) / z
        self._psi = 0.5 - z / 6.0 + z * z / 24.0 if small else (z + math.expm1(-z)) / (z * z)
        self._position = [0.0, 0.0, 0.0]
        self._velocity = [0.0, 0.0, 0.0]

    def step(self, force: Array) -> Motion:
        """Advance by one sample under a force (3,) [N]; a component that is not finite counts as zero."""
        acceleration = [0.0, 0.0, 0.0]
        h = self._h
        for axis in self._free:
            f = float(force[axis])
            if not math.isfinite(f):
                f = 0.0
            v = self._velocity[axis]
            a = (f - self.robot.damping * v) / self.robot.mass
            acceleration[axis] = self._phi * a
            self._position[axis] += h * v + h * h * self._psi * a
            self._velocity[axis] = v + h * acceleration[axis]
        velocity = np.array(self._velocity)
        return Motion(np.array(self._position), velocity, np.array(acceleration), velocity.copy())

    def reset(self) -> None:
        """At rest at the origin."""
        self._position = [0.0, 0.0, 0.0]
        self._velocity = [0.0, 0.0, 0.0]
