"""The filter node alone: a state and a wrench in, a command, a verdict and a decision out; never a silent pass."""

from __future__ import annotations

import math
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from loop_messages import state, trial, wrench
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from mig_filter_node.node import MigFilterNode
from mig_interfaces.msg import FilterDecision, TrialState
from rig_runtime import topics
from shared_control.filter import Mode, Reason, Verdict
from shared_control.parameters import ParameterError, declarations
from shared_control.scenario import FilterConfig

OUTPUTS = (topics.COMMAND, topics.DECISION, topics.ACCEPTED, topics.REJECTED, topics.REPLACED)


class Bench:
    """The filter node between two publishers and its collected outputs."""

    def __init__(self, graph: Any, *parameters: str) -> None:
        self.graph = graph
        self.node = graph.make(MigFilterNode, *parameters)
        self.states = graph.publisher(topics.TASK_STATE)
        self.wrenches = graph.publisher(topics.WRENCH)
        self.out = {topic: graph.collect(topic) for topic in OUTPUTS}
        graph.until(self._matched)

    def _matched(self) -> bool:
        report = self.node.make_report()
        inputs = (self.states.get_subscription_count(), self.wrenches.get_subscription_count())
        return all(inputs) and all(report.matched_publishers) and all(report.matched_subscriptions)

    def decide(self, tick: int, force: float, **changes: Any) -> FilterDecision:
        """One tick, as the loop would run it."""
        self.states.publish(state(tick, *changes.pop("x", [])))
        self.wrenches.publish(wrench(tick, force, **changes))
        return self.wait(tick)

    def wait(self, tick: int) -> FilterDecision:
        decisions = self.out[topics.DECISION]
        verdicts = [self.out[topic] for topic in topics.BY_VERDICT]
        self.graph.until(lambda: any(d.tick == tick for d in decisions))
        self.graph.until(lambda: len(self.out[topics.COMMAND]) == len(decisions) == sum(map(len, verdicts)))
        return next(d for d in decisions if d.tick == tick)


def test_parameters_are_declared_with_unit_and_description(single_graph: Any) -> None:
    node = single_graph.make(MigFilterNode)
    for declaration in declarations(FilterConfig):
        described: ParameterDescriptor = node.describe_parameter(declaration.name)
        assert declaration.description in described.description
        assert described.read_only is not declaration.live
    assert node.parameters.get(FilterConfig) == FilterConfig()


def test_the_message_counts_as_the_filter_does() -> None:
    for prefix, kind in (("VERDICT", Verdict), ("REASON", Reason), ("MODE", Mode)):
        for item in kind:
            assert getattr(FilterDecision, f"{prefix}_{item.name}") == item.value


def test_a_bad_parameter_is_refused_by_name(single_graph: Any) -> None:
    with pytest.raises(ParameterError, match=r"mode.*'hard'.*off, training, assistance"):
        single_graph.make(MigFilterNode, "mode:=hard")


def test_opposite_pushes_get_opposite_verdicts(graph: Any) -> None:
    bench = Bench(graph, "mode:=training", "pacing:=lockstep")
    pushes = [bench.decide(0, 4.0), bench.decide(1, -4.0)]
    verdicts = {decision.verdict for decision in pushes}
    assert verdicts == {FilterDecision.VERDICT_ACCEPTED, FilterDecision.VERDICT_REJECTED}
    for decision in pushes:
        assert decision.reason == FilterDecision.REASON_CRITERION
        assert (decision.criterion <= decision.threshold) == (decision.verdict == FilterDecision.VERDICT_ACCEPTED)
        accepted = decision.verdict == FilterDecision.VERDICT_ACCEPTED
        assert decision.admitted_force.x == (decision.user_force.x if accepted else 0.0)
        assert decision.added_force.x == decision.admitted_force.x - decision.user_force.x
        assert {getattr(decision, name) for name in ("delay", "compute_time", "state_age", "wrench_age")} == {0.0}
    assert [command.wrench.force.x for command in bench.out[topics.COMMAND]] == [d.admitted_force.x for d in pushes]


def test_assistance_replaces_what_training_rejects(graph: Any) -> None:
    bench = Bench(graph, "mode:=assistance", "pacing:=lockstep")
    pushes = [bench.decide(0, 4.0), bench.decide(1, -4.0)]
    replaced = [d for d in pushes if d.verdict == FilterDecision.VERDICT_REPLACED]
    assert len(replaced) == 1
    assert math.isfinite(replaced[0].admitted_force.x)
    # What is republished under the verdict is the user's force.
    assert [w.wrench.force.x for w in bench.out[topics.REPLACED]] == [replaced[0].user_force.x]


def test_mode_changes_in_flight_on_the_next_tick(graph: Any) -> None:
    bench = Bench(graph, "mode:=training", "pacing:=lockstep")
    push = next(f for k, f in enumerate((4.0, -4.0)) if bench.decide(k, f).verdict == FilterDecision.VERDICT_REJECTED)
    assert bench.node.set_parameters([Parameter("mode", value="off")])[0].successful
    off = bench.decide(2, push)
    assert (off.verdict, off.reason) == (FilterDecision.VERDICT_ACCEPTED, FilterDecision.REASON_FILTER_OFF)
    assert bench.node.set_parameters([Parameter("mode", value="assistance")])[0].successful
    assert bench.decide(3, push).verdict == FilterDecision.VERDICT_REPLACED
    refused = bench.node.set_parameters([Parameter("horizon", value=2.0)])[0]
    assert not refused.successful
    assert "horizon" in refused.reason


@pytest.mark.parametrize(
    ("force", "frame", "reason"),
    [
        (math.nan, topics.SENSOR_FRAME, FilterDecision.REASON_NON_FINITE_WRENCH),
        (math.inf, topics.SENSOR_FRAME, FilterDecision.REASON_NON_FINITE_WRENCH),
        (4.0, "somewhere", FilterDecision.REASON_UNKNOWN_FRAME),
        (10_001.0, topics.SENSOR_FRAME, Reason.EXCESSIVE_WRENCH),
        (-1e300, topics.SENSOR_FRAME, Reason.EXCESSIVE_WRENCH),
        (0.0, topics.SENSOR_FRAME, FilterDecision.REASON_NULL_ACTION),
    ],
)
@pytest.mark.parametrize("mode", ["off", "training", "assistance"])
def test_what_cannot_be_judged_is_never_passed(
    single_graph: Any, mode: str, force: float, frame: str, reason: int
) -> None:
    bench = Bench(single_graph, f"mode:='{mode}'", "pacing:=lockstep")
    decision = bench.decide(0, force, frame=frame)
    if mode == "off" and reason == FilterDecision.REASON_NULL_ACTION:
        reason = FilterDecision.REASON_FILTER_OFF
    assert decision.reason == reason
    assert bench.out[topics.COMMAND][0].wrench.force.x == 0.0


def test_a_state_that_is_not_finite_is_said_so(single_graph: Any) -> None:
    bench = Bench(single_graph, "mode:=assistance", "pacing:=lockstep")
    decision = bench.decide(0, 4.0, x=[(math.nan, 0.0, 0.0, 0.0)])
    assert decision.reason == FilterDecision.REASON_NON_FINITE_STATE
    assert bench.out[topics.COMMAND][0].wrench.force.x == 0.0


def test_order_of_arrival_does_not_matter(graph: Any) -> None:
    bench = Bench(graph, "mode:=training", "pacing:=lockstep")
    for tick in range(3):
        bench.wrenches.publish(wrench(tick, 4.0))
    for tick in range(3):
        bench.states.publish(state(tick))
    bench.wait(2)
    assert [d.tick for d in bench.out[topics.DECISION]] == [0, 1, 2]


def test_in_real_time_a_missing_wrench_gets_the_safe_command(graph: Any) -> None:
    bench = Bench(graph, "mode:=training", "pacing:=realtime", "command_timeout:=0.05")
    bench.states.publish(state(0))
    decision = bench.wait(0)
    assert decision.reason == FilterDecision.REASON_STALE_WRENCH
    # Ten looks of the watchdog; where the machine stalls between two of them they lie closer.
    assert decision.state_age >= 0.02
    assert bench.out[topics.COMMAND][0].wrench.force.x == 0.0
    bench.wrenches.publish(wrench(0, 4.0))
    graph.until(lambda: bench.node.diagnose()[2]["late"] == 1)
    later = bench.decide(1, 4.0)
    assert later.reason == FilterDecision.REASON_CRITERION
    assert later.compute_time > 0.0
    assert min(later.state_age, later.wrench_age) >= 0.0
    # These stamps lie long ago, so that is how late it is.
    assert later.delay > decision.delay > 1e6
    assert len(bench.out[topics.DECISION]) == 2, "the wrench that came too late got no second decision"
    assert bench.node.diagnose()[2]["late"] == 1


def test_a_user_who_is_silent_costs_the_timeout_once(graph: Any) -> None:
    bench = Bench(graph, "mode:=assistance", "pacing:=realtime", "command_timeout:=0.05")
    assert bench.decide(0, 4.0).reason == FilterDecision.REASON_CRITERION
    for tick in (1, 2, 3):
        bench.states.publish(state(tick))
    first = [bench.wait(tick) for tick in (1, 2, 3)]
    bench.states.publish(state(4))
    known = bench.wait(4)
    for decision in (*first, known):
        assert decision.reason == FilterDecision.REASON_STALE_WRENCH
        assert (decision.verdict, decision.admitted_force.x) == (FilterDecision.VERDICT_REJECTED, 0.0)


def test_a_wrench_that_waited_for_its_tick_is_stale(graph: Any) -> None:
    bench = Bench(graph, "mode:='off'", "pacing:=realtime", "command_timeout:=0.001")
    bench.wrenches.publish(wrench(7, 4.0))
    later = graph.node.get_clock().now().nanoseconds + 100_000_000
    graph.until(lambda: graph.node.get_clock().now().nanoseconds > later)
    bench.states.publish(state(7))
    decision = bench.wait(7)
    assert decision.reason == FilterDecision.REASON_STALE_WRENCH
    assert bench.out[topics.COMMAND][0].wrench.force.x == 0.0


def test_a_wrench_far_ahead_of_the_newest_state_is_dropped(graph: Any) -> None:
    bench = Bench(graph, "mode:='off'", "pacing:=realtime", "command_timeout:=0.05")
    assert bench.decide(0, 4.0).reason == FilterDecision.REASON_FILTER_OFF
    bench.wrenches.publish(wrench(6, 4.0))
    graph.until(lambda: bench.node.diagnose()[2]["ahead of time"] == 1)
    bench.states.publish(state(6))
    decision = bench.wait(6)
    assert decision.reason == FilterDecision.REASON_STALE_WRENCH
    assert bench.out[topics.COMMAND][1].wrench.force.x == 0.0


def test_a_state_that_comes_late_is_stale_where_that_is_asked_for(graph: Any) -> None:
    def late_state(*parameters: str) -> int:
        bench = Bench(graph, "mode:='off'", "pacing:=realtime", "command_timeout:=5.0", *parameters)
        bench.decide(0, 4.0)
        later = graph.node.get_clock().now().nanoseconds + 100_000_000
        graph.until(lambda: graph.node.get_clock().now().nanoseconds > later)
        # 10 ms after the first by its stamp, 100 ms or more by the clock on the wall.
        decision = bench.decide(1, 4.0)
        assert (decision.admitted_force.x == 0.0) == (decision.reason == Reason.STALE_STATE)
        graph.remove(bench.node)
        return decision.reason

    assert late_state() == FilterDecision.REASON_FILTER_OFF
    assert late_state("state_timeout:=0.05") == Reason.STALE_STATE


def test_explicit_recovery_keeps_the_first_fault_until_it_is_cleared(graph: Any) -> None:
    bench = Bench(graph, "mode:='off'", "pacing:=lockstep", "recovery:=explicit")
    assert bench.decide(0, 4.0).admitted_force.x == 4.0
    assert bench.decide(1, math.nan).reason == FilterDecision.REASON_NON_FINITE_WRENCH
    for tick in (2, 3):
        kept = bench.decide(tick, 4.0, frame=topics.SENSOR_FRAME if tick == 2 else "somewhere")
        assert (kept.reason, kept.admitted_force.x) == (FilterDecision.REASON_NON_FINITE_WRENCH, 0.0)
    level, message, _ = bench.node.diagnose()
    assert level == DiagnosticStatus.ERROR
    assert "non finite wrench" in message
    assert topics.CLEAR_FILTER_SERVICE in message
    answer = graph.call(Trigger, topics.CLEAR_FILTER_SERVICE, Trigger.Request())
    assert (answer.success, answer.message) == (True, "cleared: non finite wrench")
    assert bench.decide(4, 4.0).admitted_force.x == 4.0
    assert bench.node.diagnose()[0] != DiagnosticStatus.ERROR


def test_automatic_recovery_goes_on_when_the_input_is_good(graph: Any) -> None:
    bench = Bench(graph, "mode:='off'", "pacing:=lockstep")
    assert bench.decide(0, math.inf).admitted_force.x == 0.0
    assert bench.decide(1, 4.0).admitted_force.x == 4.0


@pytest.mark.parametrize("recovery", ["automatic", "explicit"])
def test_a_loss_is_in_the_diagnostics_at_once_and_so_is_its_end(graph: Any, recovery: str) -> None:
    bench = Bench(graph, "mode:='off'", "pacing:=realtime", "command_timeout:=5.0", f"recovery:={recovery}")
    said = graph.diagnostics("mig_filter")
    bench.decide(0, 4.0)
    graph.until(lambda: bool(said))
    assert (said[-1].level, said[-1].message) == (DiagnosticStatus.OK, "judging")
    assert said[-1].values["no force because"] == ""
    before = len(said)
    bench.decide(1, math.nan)
    graph.until(lambda: len(said) > before)
    lost = said[before]
    assert lost.values["no force because"] == "non finite wrench"
    assert lost.values["ticks"] == "2", "at once, not with the next beat"
    if recovery == "automatic":
        assert (lost.level, lost.message) == (DiagnosticStatus.WARN, "no force: non finite wrench")
    else:
        assert lost.level == DiagnosticStatus.ERROR
        assert lost.message == f"non finite wrench: no force until {topics.CLEAR_FILTER_SERVICE} is called"
    tick = 2
    while float(said[-1].values["no force for [s]"]) < 0.25:
        bench.decide(tick, math.nan)
        tick += 1
    if recovery == "automatic":
        assert said[-1].message.startswith("no force for ")
        bench.decide(tick, 4.0)
    else:
        graph.call(Trigger, topics.CLEAR_FILTER_SERVICE, Trigger.Request())
    graph.until(lambda: said[-1].values["no force because"] == "")
    assert said[-1].level == DiagnosticStatus.WARN, "what has been lost is counted for as long as the trial"
    assert said[-1].message.startswith("judging; no force for ")
    assert said[-1].message.endswith(" ago: non finite wrench")
    assert said[-1].values["reason non_finite_wrench"] == str(tick - 1)


def test_without_states_the_filter_says_so_until_they_are_back_or_the_trial_is_over(graph: Any) -> None:
    bench = Bench(graph, "mode:='off'", "pacing:=realtime", "command_timeout:=0.05")
    trials, said = graph.publisher(topics.TRIAL_STATE), graph.diagnostics("mig_filter")
    graph.until(lambda: trials.get_subscription_count() == 1)
    trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: bench.node.armed_uid == 1)

    def because() -> str:
        return said[-1].values["no force because"] if said else ""

    for tick, end in enumerate(("another state", "the end")):
        bench.decide(tick, 4.0)
        graph.until(lambda: because() == "no state")
        assert said[-1].level == DiagnosticStatus.WARN
        if end == "the end":
            trials.publish(trial(TrialState.PHASE_ABORTED))
            graph.until(lambda: because() == "")
    assert [each.tick for each in bench.out[topics.DECISION]] == [0, 1]


def test_what_is_refused_for_its_criterion_is_no_loss(graph: Any) -> None:
    bench = Bench(graph, "mode:=training", "pacing:=lockstep")
    assert FilterDecision.VERDICT_REJECTED in {bench.decide(0, 4.0).verdict, bench.decide(1, -4.0).verdict}
    assert bench.node.diagnose()[:2] == (DiagnosticStatus.OK, "judging")
