"""Entry point of `ros2 run user_sim_node user_sim_node`."""

import sys

from rig_runtime.run import run
from user_sim_node.node import UserSimNode


def main() -> None:
    """Spin the node until it is told to end."""
    sys.exit(run(UserSimNode))


if __name__ == "__main__":
    main()
