"""The pacemaker's side of the readiness proof: collects the nodes' reports, its own included."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mig_interfaces.msg import NodeReport
from rig_runtime import topics
from rig_runtime.node import RigNode
from rig_runtime.readiness import ReadinessGate, Report
from rig_runtime.wire import MalformedError

#: Name of the node that follows the loop and is no part of it.
RECORDER = "recorder"


class Readiness:
    """Feeds a :class:`ReadinessGate` from `trial/reports`."""

    def __init__(self, node: RigNode, required: Sequence[str], on_change: Callable[[], None]) -> None:
        self._node = node
        self._on_change = on_change
        self._loop = [self.full_name(name) for name in required if name]
        self._gate = ReadinessGate([*self._loop, node.get_fully_qualified_name()])
        node.create_subscription(
            topics.NODE_REPORT.type, topics.NODE_REPORT.name, self._on_report, topics.NODE_REPORT.qos
        )

    def full_name(self, name: str) -> str:
        """A node's name with this namespace in front, unless it is absolute."""
        return name if name.startswith("/") else f"{self._node.get_namespace().rstrip('/')}/{name}"

    def begin(self, uid: int) -> None:
        """A trial is being armed: look at once, every node may be ready already."""
        if not self.missing(uid):
            self._on_change()

    def missing(self, uid: int) -> list[str]:
        """What trial `uid` still waits for."""
        self._gate.put(_from_message(self._node.make_report()))
        return self._gate.missing(uid)

    def slowest(self, tick: int) -> str:
        """The first node of the loop that has not answered `tick`."""
        return self._gate.slowest([name for name in self._loop if name != self.full_name(RECORDER)], tick)

    def _on_report(self, message: NodeReport) -> None:
        if message.node != self._node.get_fully_qualified_name():
            self._gate.put(_from_message(message))
            self._on_change()


def _from_message(message: NodeReport) -> Report:
    lengths = (
        (len(message.publishes), len(message.matched_subscriptions)),
        (
            len(message.subscribes),
            len(message.matched_publishers),
        ),
    )
    if any(names != counts for names, counts in lengths):
        raise MalformedError(f"a report with other numbers of topics than of matches: {lengths}")
    return Report(
        node=message.node,
        armed_uid=message.armed_uid,
        error=message.error,
        publishes=dict(zip(message.publishes, message.matched_subscriptions, strict=True)),
        subscribes=dict(zip(message.subscribes, message.matched_publishers, strict=True)),
        ticks_done=message.ticks_done,
    )
