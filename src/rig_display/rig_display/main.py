"""Entry point of `ros2 run rig_display display`."""

import sys

from rig_display.node import DisplayNode
from rig_runtime.run import run


def main() -> None:
    """Spin the node until it is told to end."""
    sys.exit(run(DisplayNode))


if __name__ == "__main__":
    main()
