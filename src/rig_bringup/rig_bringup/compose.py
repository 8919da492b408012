"""`ros2 run rig_bringup compose --ros-args ...`: the whole graph in one process, on one executor."""

from __future__ import annotations

import os
import sys

from admittance_sim_node.node import AdmittanceSimNode
from mig_filter_node.node import MigFilterNode
from rig_bag.recorder import make_recorder
from rig_runtime.run import NodeFactory, run
from task_sim_node.node import TaskSimNode
from user_sim_node.node import UserSimNode


def graph(record: bool, person: bool = False) -> list[NodeFactory]:
    """The nodes of the graph, in the order of the loop; the recorder first, so that it misses nothing.

    With `person` the display takes the place of the simulated user.
    """
    nodes: list[NodeFactory] = [_display() if person else UserSimNode, MigFilterNode, AdmittanceSimNode, TaskSimNode]
    return [make_recorder, *nodes] if record else nodes


def _display() -> NodeFactory:
    # Imported here: it brings a web server, which a run without a person need not wait for.
    from rig_display.node import DisplayNode

    return DisplayNode


def main() -> None:
    """Spin the graph until it is told to end. RIG_RECORD=0 leaves the recorder out, RIG_USER=display takes a person."""
    person = os.environ.get("RIG_USER") == "display"
    arguments = list(sys.argv)
    if person:
        # In front: what the command line and its files say counts.
        arguments[1:1] = ["--ros-args", "-p", "recovery:=explicit"]
    # A page's server has work of its own beside the loop.
    sys.exit(run(*graph(os.environ.get("RIG_RECORD", "1") != "0", person), args=arguments, alone=not person))


if __name__ == "__main__":
    main()
