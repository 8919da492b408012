"""Entry point of `ros2 run mig_filter_node mig_filter_node`."""

import sys

from mig_filter_node.node import MigFilterNode
from rig_runtime.run import run


def main() -> None:
    """Spin the node until it is told to end."""
    sys.exit(run(MigFilterNode))


if __name__ == "__main__":
    main()
