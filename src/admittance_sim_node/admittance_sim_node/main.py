"""Entry point of `ros2 run admittance_sim_node admittance_sim_node`."""

import sys

from admittance_sim_node.node import AdmittanceSimNode
from rig_runtime.run import run


def main() -> None:
    """Spin the node until it is told to end."""
    sys.exit(run(AdmittanceSimNode))


if __name__ == "__main__":
    main()
