"""The readiness proof: nothing starts before every reader that reported is matched by every writer."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rig_runtime.readiness import ReadinessGate, Report


def ring(matched: int = 1, uid: int = 1) -> list[Report]:
    return [
        Report("/a", uid, "", {"/x": matched}, {"/y": 1}),
        Report("/b", uid, "", {"/y": matched}, {"/x": 1}),
    ]


def gate_with(reports: list[Report]) -> ReadinessGate:
    gate = ReadinessGate(["/a", "/b"])
    for report in reports:
        gate.put(report)
    return gate


def test_a_matched_ring_is_ready() -> None:
    assert gate_with(ring()).missing(1) == []


def test_each_missing_thing_is_named() -> None:
    assert gate_with(ring()[:1]).missing(1) == ["/b has not reported"]
    assert "/a has matched 0 of 1 readers of /x (/b)" in gate_with(ring(matched=0)).missing(1)
    assert "/b has not reset itself for trial 2" in gate_with(ring()).missing(2)
    broken = Report("/b", 1, "no kernel", {"/y": 1}, {"/x": 1})
    assert "/b cannot take part: no kernel" in gate_with([ring()[0], broken]).missing(1)
    lonely = Report("/b", 1, "", {"/y": 1}, {"/x": 0})
    assert "/b waits for a publisher of /x" in gate_with([ring()[0], lonely]).missing(1)


def test_a_node_that_has_vanished_must_report_again() -> None:
    gate = gate_with(ring())
    gate.forget("/b")
    gate.forget("/nobody")
    assert gate.missing(1) == ["/b has not reported"]
    assert gate.slowest(["/b", "/a"], 0) == "/b has never reported"
    gate.put(ring()[1])
    assert gate.missing(1) == []


def test_a_second_reader_must_be_matched_too() -> None:
    gate = ReadinessGate(["/a", "/b", "/recorder"])
    for report in [*ring(), Report("/recorder", 1, "", {}, {"/x": 1, "/y": 1})]:
        gate.put(report)
    assert len(gate.missing(1)) == 2
    for report in ring(matched=2):
        gate.put(report)
    assert gate.missing(1) == []


@given(st.lists(st.sampled_from(["/user", "/filter", "/robot"]), unique=True), st.integers(0, 5))
def test_the_first_that_has_not_answered_is_named(answered: list[str], tick: int) -> None:
    order = ["/user", "/filter", "/robot"]
    gate = ReadinessGate(order)
    for name in order:
        gate.put(Report(name, 1, "", {}, {}, ticks_done=tick + 1 if name in answered else tick))
    first = next((name for name in order if name not in answered), None)
    said = gate.slowest(order, tick)
    assert said.startswith(first) if first else "lost" in said
