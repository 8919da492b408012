"""What is said in `/diagnostics` when one message serves again and again."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from rig_runtime.diagnostics import Diagnostics


def test_each_message_says_what_holds_then(single_graph: Any) -> None:
    node = single_graph.node
    heard: list[DiagnosticArray] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    diagnostics = Diagnostics(node)
    single_graph.until(lambda: node.count_subscribers("/diagnostics") == 1)
    said = (
        (DiagnosticStatus.OK, "running", {"ticks": 1, "mode": "off"}),
        (DiagnosticStatus.OK, "running", {"ticks": 2, "mode": "off"}),
        (DiagnosticStatus.ERROR, "silent", {"ticks": 2, "reason late": 7, "mode": "training"}),
        (DiagnosticStatus.OK, "running", {}),
    )
    for second, (level, message, values) in enumerate(said):
        diagnostics.publish(Time(sec=second), level, message, values)
    single_graph.until(lambda: len(heard) == len(said))
    for second, (array, (level, message, values)) in enumerate(zip(heard, said, strict=True)):
        (status,) = array.status
        assert array.header.stamp == Time(sec=second)
        assert (status.level, status.message, status.hardware_id) == (level, message, "rig")
        assert status.name == node.get_fully_qualified_name()
        assert {pair.key: pair.value for pair in status.values} == {key: str(value) for key, value in values.items()}
