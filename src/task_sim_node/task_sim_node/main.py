"""Entry point of `ros2 run task_sim_node task_sim_node`."""

import sys

from rig_runtime.run import run
from task_sim_node.node import TaskSimNode


def main() -> None:
    """Spin the node until it is told to end."""
    sys.exit(run(TaskSimNode))


if __name__ == "__main__":
    main()
