"""The robot's node alone: an admitted force in, the ideal cart's motion out."""

from __future__ import annotations

import time
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from loop_messages import trial, wrench
from std_srvs.srv import Trigger

from admittance_sim_node.node import AdmittanceSimNode
from mig_interfaces.msg import EndEffectorState, TrialState
from rig_runtime import topics
from rig_runtime.faults import LOOKS
from shared_control.parameters import ParameterError
from shared_control.scenario import LoopConfig


class Bench:
    def __init__(self, graph: Any, *parameters: str) -> None:
        self.graph = graph
        # By itself so long that a command is not late that a busy machine brings when it comes to it.
        self.node = graph.make(AdmittanceSimNode, "command_timeout:=10.0", *parameters)
        self.mass = LoopConfig().robot_mass
        self.commands = graph.publisher(topics.COMMAND)
        self.trials = graph.publisher(topics.TRIAL_STATE)
        self.out: list[EndEffectorState] = graph.collect(topics.END_EFFECTOR)
        self.trials.publish(trial(TrialState.PHASE_ARMING))
        graph.until(lambda: self.node.armed_uid == 1)
        graph.until(lambda: bool(self.commands.get_subscription_count()))
        graph.until(lambda: all(self.node.make_report().matched_subscriptions))

    def push(self, tick: int, force: float) -> EndEffectorState:
        expected = len(self.out) + 1
        self.commands.publish(wrench(tick, force))
        self.graph.until(lambda: len(self.out) == expected)
        return self.out[-1]


def test_the_ideal_robot_accelerates_by_force_over_mass(graph: Any) -> None:
    bench = Bench(graph, "robot_mass:=4.0")
    velocity = 0.0
    for tick, force in enumerate((8.0, -2.0, 0.0)):
        state = bench.push(tick, force)
        velocity += 0.01 * force / 4.0
        assert state.tick == tick
        assert state.acceleration.x == force / 4.0
        assert state.velocity.x == pytest.approx(velocity, abs=1e-15)
        assert (state.position.y, state.position.z) == (0.0, 0.0)
        # These stamps lie long ago, so that is how late the commands were.
        assert state.delay > 1e6
        assert state.compute_time > 0.0


def test_ticks_without_a_command_passed_under_no_force(single_graph: Any) -> None:
    bench = Bench(single_graph)
    bench.push(0, 2.0)
    after = bench.push(3, 0.0)
    assert after.tick == 3
    assert bench.node.diagnose()[2]["ticks without command"] == 2
    bench.commands.publish(wrench(1, 2.0))
    assert bench.push(4, 0.0).tick == 4
    assert bench.node.diagnose()[2]["dropped"] == 1


def test_started_in_the_middle_of_a_trial_it_follows_once_it_knows_the_trial(graph: Any) -> None:
    node = graph.make(AdmittanceSimNode)
    commands, trials = graph.publisher(topics.COMMAND), graph.publisher(topics.TRIAL_STATE)
    out = graph.collect(topics.END_EFFECTOR)
    graph.until(lambda: commands.get_subscription_count() and all(node.make_report().matched_subscriptions))
    for tick in (20, 21):
        commands.publish(wrench(tick, 5.0))
    graph.until(lambda: node.diagnose()[2]["dropped"] == 2)
    trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: node.armed_uid == 1)
    commands.publish(wrench(22, 5.0))
    graph.until(lambda: bool(out))
    assert [state.tick for state in out] == [22]
    assert node.diagnose()[2]["ticks without command"] == 22


def test_a_command_from_beyond_the_trial_is_dropped(single_graph: Any) -> None:
    bench = Bench(single_graph)
    bench.push(0, 2.0)
    bench.commands.publish(wrench(100_000_000, 2.0))
    assert bench.push(1, 2.0).tick == 1
    assert bench.node.diagnose()[2]["dropped"] == 1


def test_a_new_trial_starts_from_rest(single_graph: Any) -> None:
    bench = Bench(single_graph)
    bench.push(0, 5.0)
    bench.trials.publish(trial(TrialState.PHASE_ARMING, uid=2))
    single_graph.until(lambda: bench.node.armed_uid == 2)
    assert bench.push(0, 0.0).velocity.x == 0.0


def test_without_commands_the_robot_goes_on_under_no_force_to_the_end_of_the_trial(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "robot_damping:=1.0", "command_timeout:=0.05")
    bench.trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_RUNNING)
    pushed = bench.push(0, 5.0)
    graph.until(lambda: len(bench.out) == 40)
    assert [state.tick for state in bench.out] == list(range(40)), "each tick once, none beyond the trial"
    assert all(state.force.x == 0.0 for state in bench.out[1:])
    assert 0.0 < bench.out[-1].velocity.x < pushed.velocity.x, "the robot's damping slows it"
    assert bench.node.diagnose()[2]["times without command"] == 1
    bench.commands.publish(wrench(3, 5.0))
    graph.until(lambda: bench.node.diagnose()[2]["late"] == 1)


def test_commands_that_come_late_one_after_another_are_as_none(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "command_timeout:=0.05")
    bench.trials.publish(trial(TrialState.PHASE_RUNNING, ticks=400))
    graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_RUNNING)
    bench.push(0, 5.0)
    begin, sent = time.monotonic(), 0

    def push_late() -> bool:
        nonlocal sent
        while sent < (time.monotonic() - begin - 0.3) / 0.01:
            sent += 1
            bench.commands.publish(wrench(sent, 5.0))
        return len(bench.out) >= 150

    graph.until(push_late)
    assert [state.tick for state in bench.out] == list(range(len(bench.out)))
    assert not any(state.force.x for state in bench.out[1:])
    assert bench.node.diagnose()[2]["late"] > 50
    assert bench.node.diagnose()[2]["times without command"] == 1, "and it never seemed to be over"


def test_explicit_recovery_admits_nothing_until_it_is_cleared(graph: Any) -> None:
    # So long that a busy machine does not stand still for it on its own.
    bench = Bench(graph, "pacing:=realtime", "recovery:=explicit", "command_timeout:=5.0")
    for timer in bench.node.timers:
        timer.cancel()
    bench.trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_RUNNING)
    bench.push(0, 5.0)
    for _ in range(LOOKS):
        bench.node._watchdog()
    graph.until(lambda: len(bench.out) == 40)
    # Of a tick that has not been yet, so that they are in time.
    bench.commands.publish(wrench(139, 5.0))
    graph.until(lambda: len(bench.out) == 41)
    assert bench.out[-1].force.x == 0.0
    assert bench.node.diagnose()[0] == DiagnosticStatus.ERROR
    answer = graph.call(Trigger, topics.CLEAR_ROBOT_SERVICE, Trigger.Request())
    assert answer.message == "cleared: no command came in time"
    bench.commands.publish(wrench(140, 5.0))
    graph.until(lambda: len(bench.out) == 42)
    assert bench.out[-1].force.x == 5.0


@pytest.mark.parametrize("recovery", ["automatic", "explicit"])
def test_a_lost_command_is_in_the_diagnostics_at_once_and_so_is_its_end(graph: Any, recovery: str) -> None:
    bench = Bench(graph, "pacing:=realtime", f"recovery:={recovery}", "command_timeout:=0.1")
    said = graph.diagnostics("admittance_sim")
    bench.trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_RUNNING and bool(said))
    assert (said[-1].level, said[-1].message) == (DiagnosticStatus.OK, "moving")
    bench.push(0, 5.0)
    graph.until(lambda: bench.out[-1].force.x == 0.0)
    graph.until(lambda: said[-1].values["no force because"] == "no command came in time")
    if recovery == "automatic":
        assert said[-1].level == DiagnosticStatus.WARN
        assert said[-1].message == "no force: no command came in time"
        graph.until(lambda: said[-1].message.startswith("no force for "))
    else:
        assert said[-1].level == DiagnosticStatus.ERROR
        assert said[-1].message == f"no command came in time: no force until {topics.CLEAR_ROBOT_SERVICE} is called"
        graph.until(lambda: float(said[-1].values["no force for [s]"]) > 0.2)
    bench.trials.publish(trial(TrialState.PHASE_FINISHED))
    if recovery == "explicit":
        graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_FINISHED)
        assert bench.node.diagnose()[0] == DiagnosticStatus.ERROR, "what is kept outlasts the trial"
        graph.call(Trigger, topics.CLEAR_ROBOT_SERVICE, Trigger.Request())
    graph.until(lambda: said[-1].values["no force because"] == "")
    assert said[-1].level == DiagnosticStatus.WARN
    assert said[-1].message.startswith("moving; no force for ")


def test_commands_that_are_not_finite_are_in_the_diagnostics_until_one_is(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "command_timeout:=5.0")
    said = graph.diagnostics("admittance_sim")
    bench.trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_RUNNING)
    bench.push(0, float("nan"))
    graph.until(lambda: bool(said) and said[-1].values["no force because"] == "the command is not finite")
    assert (said[-1].level, said[-1].message) == (DiagnosticStatus.WARN, "no force: the command is not finite")
    bench.push(1, 5.0)
    graph.until(lambda: said[-1].values["no force because"] == "")


def test_started_in_the_middle_of_a_trial_it_says_at_once_that_it_waits(graph: Any) -> None:
    graph.make(AdmittanceSimNode, "pacing:=realtime", "recovery:=explicit")
    trials, said = graph.publisher(topics.TRIAL_STATE), graph.diagnostics("admittance_sim")
    graph.until(lambda: bool(trials.get_subscription_count() and said))
    before = len(said)
    trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: len(said) > before and said[-1].level == DiagnosticStatus.ERROR)
    assert said[-1].values["no force because"] == "it was started in the middle of a trial"


def test_a_command_that_is_not_finite_is_no_force(graph: Any) -> None:
    bench = Bench(graph)
    assert bench.push(0, float("nan")).force.x == 0.0
    after = bench.push(1, 5.0)
    assert (after.force.x, after.velocity.x) == (5.0, 0.01 * 5.0 / bench.mass)
    assert bench.node.diagnose()[2]["dropped"] == 1


def test_a_fault_that_is_cleared_while_the_commands_are_still_lost_is_kept_again(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "recovery:=explicit", "command_timeout:=0.5")
    bench.trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_RUNNING)
    bench.push(0, 5.0)
    graph.until(lambda: bench.node.diagnose()[0] == DiagnosticStatus.ERROR)
    answer = graph.call(Trigger, topics.CLEAR_ROBOT_SERVICE, Trigger.Request())
    assert answer.message == "cleared: no command came in time"
    graph.until(lambda: bench.node.diagnose()[0] == DiagnosticStatus.ERROR)
    graph.until(lambda: len(bench.out) == 40)
    bench.commands.publish(wrench(40, 5.0))
    graph.until(lambda: len(bench.out) == 41)
    assert bench.out[-1].force.x == 0.0


@pytest.mark.parametrize("recovery", ["automatic", "explicit"])
def test_started_in_the_middle_of_a_trial_with_a_person_it_waits_to_be_cleared(graph: Any, recovery: str) -> None:
    node = graph.make(AdmittanceSimNode, "pacing:=realtime", f"recovery:={recovery}")
    commands, trials = graph.publisher(topics.COMMAND), graph.publisher(topics.TRIAL_STATE)
    out = graph.collect(topics.END_EFFECTOR)
    graph.until(lambda: commands.get_subscription_count() and all(node.make_report().matched_subscriptions))
    trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: node.armed_uid == 1)
    commands.publish(wrench(5, 5.0))
    graph.until(lambda: bool(out))
    assert out[0].force.x == (0.0 if recovery == "explicit" else 5.0)
    if recovery == "explicit":
        answer = graph.call(Trigger, topics.CLEAR_ROBOT_SERVICE, Trigger.Request())
        assert answer.message == "cleared: it was started in the middle of a trial"


def test_with_a_person_what_waited_while_it_stood_still_itself_is_no_force(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "recovery:=explicit", "command_timeout:=5.0")
    bench.trials.publish(trial(TrialState.PHASE_RUNNING))
    graph.until(lambda: bench.node.trial.phase == TrialState.PHASE_RUNNING)
    bench.push(0, 5.0)
    bench.node._looked -= 10_000_000_000  # its watchdog last looked ten seconds ago
    assert bench.push(1, 5.0).force.x == 0.0
    assert bench.node.diagnose()[1].startswith("it stood still itself: no force until")


def test_a_bad_parameter_is_refused_by_name(single_graph: Any) -> None:
    with pytest.raises(ParameterError, match=r"robot_mass.*-1"):
        single_graph.make(AdmittanceSimNode, "robot_mass:=-1.0")
