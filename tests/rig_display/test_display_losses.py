"""What the pages say while no force is admitted, and what Release clears: from messages of the nodes to the page."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from loop_messages import trial
from page_client import Web, drive, serve

from mig_interfaces.msg import FilterDecision, TrialState
from rig_display.losses import REASONS
from rig_runtime import topics
from rig_runtime.node import NO_FORCE
from shared_control.filter import Reason, Verdict


def speaker(at: Any) -> Callable[..., None]:
    """What speaks in `/diagnostics` in the place of other nodes."""
    diagnostics = at.graph.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    at.until(lambda: diagnostics.get_subscription_count() > 0)

    def say(node: str, level: bytes, message: str, because: str | None = None) -> None:
        values = [] if because is None else [KeyValue(key=NO_FORCE, value=because)]
        status = DiagnosticStatus(name=node, level=level, message=message, values=values)
        diagnostics.publish(DiagnosticArray(status=[status]))

    return say


def test_a_fault_of_the_graph_is_shown_and_released(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    cleared = serve(at.graph, (topics.CLEAR_FILTER_SERVICE, topics.CLEAR_ROBOT_SERVICE))
    page, say = drive(at, web), speaker(at)
    kept = "stale wrench: no force until mig_filter/clear_fault is called"
    say("/elsewhere/mig_filter", DiagnosticStatus.ERROR, "not ours", "not ours")
    say("/rig/mig_filter", DiagnosticStatus.ERROR, kept, "stale wrench")
    at.until(lambda: page.status["faults"] == ["mig_filter: stale wrench"])
    at.until(lambda: all(client.service_is_ready() for client in at.node._desk._clearers.values()))
    page.say("release")
    at.until(lambda: [note["text"] for note in page.notes] == ["so be it"])
    # What nobody has seen is not released.
    assert cleared == [topics.CLEAR_FILTER_SERVICE]
    say("/rig/admittance_sim", DiagnosticStatus.ERROR, "it waits", "no command came in time")
    at.until(lambda: len(page.status["faults"]) == 2)
    page.say("release")
    at.until(lambda: len(page.notes) == 3)
    assert sorted(cleared[1:]) == sorted((topics.CLEAR_FILTER_SERVICE, topics.CLEAR_ROBOT_SERVICE))
    for node in ("mig_filter", "admittance_sim"):
        say(f"/rig/{node}", DiagnosticStatus.OK, "going on", "")
    at.until(lambda: page.status["faults"] == [])


def test_a_release_that_finds_nobody_does_not_wait_for_a_fault_to_come(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    page, say = drive(at, web), speaker(at)
    say("/rig/admittance_sim", DiagnosticStatus.ERROR, "it waits", "no command came in time")
    at.until(lambda: len(page.status["faults"]) == 1)
    page.say("release")
    at.until(lambda: bool(page.notes))
    assert f"nobody serves {topics.CLEAR_ROBOT_SERVICE}" in page.notes[0]["text"]
    cleared = serve(at.graph, (topics.CLEAR_ROBOT_SERVICE,))
    at.until(at.node._desk._clearers["admittance_sim"].service_is_ready)
    later = at.node.get_clock().now().nanoseconds + 200_000_000
    at.until(lambda: at.node.get_clock().now().nanoseconds > later)
    assert cleared == []


def test_what_fails_without_taking_the_force_is_no_fault_to_release(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    page, say = drive(at, web), speaker(at)
    say("/rig/recorder", DiagnosticStatus.ERROR, "the disk is full")
    at.until(lambda: page.status["troubles"] == ["recorder: the disk is full"])
    assert page.status["faults"] == []
    say("/rig/recorder", DiagnosticStatus.OK, "recording")
    at.until(lambda: page.status["troubles"] == [])


def run_trial(at: Any, phase: int = TrialState.PHASE_RUNNING) -> None:
    """Have a trial run, with its first tick."""
    at.trials.publish(trial(phase))
    at.until(lambda: at.node.trial.phase == phase)
    at.tick()


def test_why_a_decision_admits_nothing_is_on_the_pages_until_just_after(bench: Callable[..., Any], web: Web) -> None:
    # Silence is another matter.
    at = bench("command_timeout:=10.0")
    page = drive(at, web)
    run_trial(at)

    def decide(verdict: Verdict, reason: Reason) -> None:
        at.decisions.publish(FilterDecision(tick=0, verdict=verdict, reason=reason))
        at.until(lambda: page.status.get("decision") == f"{verdict.name.lower()}: {REASONS[reason]}")

    for reason in Reason:
        decide(Verdict.REJECTED, reason)
        if reason is Reason.CRITERION:
            assert page.status["loss"] == ""
        else:
            at.until(lambda reason=reason: page.status["loss"].endswith(f": {REASONS[reason]}"))
            assert page.status["loss"].startswith("no force")
    at.until(lambda: page.status["loss"].startswith("no force for "))
    decide(Verdict.REPLACED, Reason.NOT_CONVERGED)  # the controller's last schedule is a force
    at.until(lambda: " ago: " in page.status["loss"])
    decide(Verdict.ACCEPTED, Reason.CRITERION)
    at.until(lambda: page.status["loss"] == "")


def test_a_filter_and_a_task_that_do_not_answer_are_on_the_pages(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    page = drive(at, web)
    run_trial(at)

    def decide() -> None:
        at.tick()
        at.decisions.publish(FilterDecision(tick=at._tick))

    def tick_until(what: str, tick: Callable[[], Any]) -> None:
        for _ in range(3000):
            tick()
            if re.fullmatch(what, page.status["loss"]):
                return
        pytest.fail(f"the pages do not say {what!r} but {page.status['loss']!r}")

    at.until(lambda: "loss" in page.status)
    tick_until(r"no force for 0\.\d\d s: the filter does not answer", at.tick)
    assert page.status["decision"] is None, "one of long ago is none of now"
    tick_until(r"no force for \d\.\d+ s until 0\.\d s ago: the filter does not answer", decide)
    tick_until("", decide)
    at.until(lambda: page.status["loss"].endswith(": the task does not answer"))
    # Of a trial that has ended nobody has to say anything.
    at.trials.publish(trial(TrialState.PHASE_ABORTED))
    at.until(lambda: " ago: " in page.status["loss"])
    at.until(lambda: page.status["loss"] == "")


def test_what_task_and_robot_say_they_lack_is_on_the_pages(bench: Callable[..., Any], web: Web) -> None:
    at = bench("command_timeout:=10.0")
    page, say = drive(at, web), speaker(at)
    run_trial(at)
    for node, because in (("task_sim", "no motion"), ("admittance_sim", "no command came in time")):
        say(f"/rig/{node}", DiagnosticStatus.WARN, f"no force: {because}", because)
        at.until(lambda said=f": {because} ({node})": page.status["loss"].endswith(said))
        assert page.status["faults"] == page.status["troubles"] == []
        say(f"/rig/{node}", DiagnosticStatus.WARN, "moving", "")
        at.until(lambda: page.status["loss"] == "")


@pytest.mark.parametrize("field", ["mode", "verdict", "reason"])
def test_a_decision_that_no_filter_makes_is_not_shown(bench: Callable[..., Any], field: str) -> None:
    at = bench()
    at.decisions.publish(FilterDecision(**{field: 99}))
    at.until(lambda: at.node.refused == 1)
    assert at.node.feed.decision is None
