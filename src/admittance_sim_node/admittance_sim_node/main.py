"""Entry point of `ros2 run admittance_sim_node admittance_sim_node`."""

import sys

from rig_runtime.run import run

from admittance_sim_node.node import AdmittanceSimNode


def main() -> None:
    """Spin the node until it is told to end."""
    sys.exit(run(AdmittanceSimNode))


if __name__ == "__main__":
    main()
