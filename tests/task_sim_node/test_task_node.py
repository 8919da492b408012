"""The pacemaker alone, with the test in the place of the rest of the loop."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from mig_interfaces.msg import EndEffectorState, TaskState, TrialState
from mig_interfaces.srv import AbortTrial, StartTrial
from rig_runtime import topics
from rig_runtime.ticks import from_stamp
from shared_control import tasks
from shared_control.parameters import ParameterError
from task_sim_node.node import TaskSimNode

LOCKSTEP = ("pacing:=lockstep", "duration:=0.1", "required_nodes:=['']")


class Bench:
    """The pacemaker, and a robot that accelerates as it is told."""

    def __init__(self, graph: Any, *parameters: str, answer: bool = True) -> None:
        self.graph = graph
        self.states: list[TaskState] = []
        self._by_stamp: dict[int, TaskState] = {}
        self.trials: list[TrialState] = graph.collect(topics.TRIAL_STATE)
        self.motions = graph.publisher(topics.END_EFFECTOR)
        self.answers = answer
        graph.node.create_subscription(TaskState, topics.TASK_STATE.name, self._on_state, topics.TASK_STATE.qos)
        self.node = graph.make(TaskSimNode, "autostart:=false", *parameters)
        graph.until(lambda: all(self._counts()))

    def _counts(self) -> list[int]:
        report = self.node.make_report()
        return [*report.matched_subscriptions, *report.matched_publishers, self.motions.get_subscription_count()]

    def _on_state(self, state: TaskState) -> None:
        self.states.append(state)
        self._by_stamp[from_stamp(state.header.stamp)] = state
        if self.answers:
            motion = EndEffectorState(tick=state.tick)
            motion.header.stamp = state.header.stamp
            motion.acceleration.x = 1.0
            self.motions.publish(motion)

    def start(self, **request: Any) -> StartTrial.Response:
        return self.graph.call(StartTrial, topics.START_SERVICE, StartTrial.Request(**request))

    def ended(self) -> bool:
        return bool(self.trials) and self.trials[-1].phase in (TrialState.PHASE_FINISHED, TrialState.PHASE_ABORTED)

    def newest_of(self, messages: list[Any], stamp: Callable[[Any], Any]) -> tuple[Any, TaskState]:
        """The newest of these messages that was made of a state that has come (they are on other topics), and it."""

        def found() -> list[Any]:
            return [message for message in messages if from_stamp(stamp(message)) in self._by_stamp]

        self.graph.until(lambda: bool(found()))
        message = found()[-1]
        return message, self._by_stamp[from_stamp(stamp(message))]

    def run(self, **request: Any) -> list[TaskState]:
        assert self.start(**request).success
        self.graph.until(self.ended)
        self.graph.until(lambda: len(self.states) == self.trials[-1].ticks_published)
        return self.states


def test_a_lockstep_trial_has_every_tick_once(graph: Any) -> None:
    bench = Bench(graph, *LOCKSTEP)
    states = bench.run(subject="S1", group="training", set="2", trial=7, seed=9)
    assert [s.tick for s in states] == list(range(10))
    assert [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in states] == [
        10**9 + k * 10**7 for k in range(10)
    ]
    assert not any(s.held for s in states)
    assert {getattr(s, name) for s in states for name in ("delay", "compute_time", "motion_age")} == {0.0}
    assert [list(s.control) for s in states] == [[0.0]] + [[1.0]] * 9
    assert states[0].state[0] == pytest.approx(math.pi, abs=0.05)
    trial = bench.trials[-1]
    assert (trial.phase, trial.ticks_published, trial.ticks_planned) == (TrialState.PHASE_FINISHED, 10, 10)
    assert (trial.subject, trial.group, trial.set, trial.trial, trial.seed) == ("S1", "training", "2", 7, 9)
    assert trial.state_names[0] == "theta"
    assert len(trial.state_units) == len(trial.state_names) == 4
    where = dict(pair.split("=", 1) for pair in trial.surroundings)
    assert where["host"] == platform.node()
    assert where["version numpy"] == np.__version__
    assert where["scheduling"] == "other"


def test_the_same_trial_again_is_the_same(single_graph: Any) -> None:
    bench = Bench(single_graph, *LOCKSTEP)
    first = [list(s.state) for s in bench.run()]
    bench.states.clear()
    bench.trials.clear()
    assert [list(s.state) for s in bench.run()] == first


def test_in_real_time_silence_is_held_then_zeroed_and_counted(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "duration:=0.15", "required_nodes:=['']", answer=False)
    states = bench.run()
    assert [s.tick for s in states] == list(range(15))
    assert all(s.held for s in states[1:])
    assert [s.missed_deadlines for s in states] == list(range(15))
    assert bench.trials[-1].missed_deadlines == 15


def test_a_robot_that_does_not_answer_is_in_the_diagnostics_until_it_does(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "duration:=60.0", "required_nodes:=['']")
    said = graph.diagnostics("task_sim")
    assert bench.start().success
    graph.until(lambda: len(bench.states) > 10)
    graph.until(lambda: bool(said) and said[-1].message == "pacing")
    assert said[-1].values["no force because"] == ""
    bench.answers = False
    graph.until(lambda: said[-1].values["no force because"] == "no motion")
    assert said[-1].level == DiagnosticStatus.WARN
    assert said[-1].message.startswith("coasting under no force")
    graph.until(lambda: said[-1].message.startswith("coasting under no force for "))
    coasting = bench.states[-1]
    assert coasting.held
    assert list(coasting.control) == [0.0]
    bench.answers = True
    graph.until(lambda: said[-1].values["no force because"] == "")
    assert said[-1].level == DiagnosticStatus.WARN
    assert said[-1].message.startswith("pacing; coasting under no force for ")
    assert said[-1].message.endswith(" ago: no motion")


def test_in_real_time_each_state_says_when_it_was_made(graph: Any) -> None:
    bench = Bench(graph, "pacing:=realtime", "duration:=0.1", "required_nodes:=['']")
    states = bench.run()
    # Never before its time; the system's clock and the steady one are read one after the other.
    assert min(s.delay for s in states) > -1e-3
    assert min(s.compute_time for s in states) > 0.0
    assert states[0].motion_age == 0.0
    assert all((s.motion_age > 0.0) is not s.held for s in states[1:])
    values = bench.node.stage.values()
    assert str(values["begins after due [ms]"]).startswith("p50 ")
    assert str(values["takes [ms]"]).endswith("of 10 ticks")


def test_lockstep_that_stands_still_is_aborted_with_the_name_of_who_is_missing(single_graph: Any) -> None:
    bench = Bench(single_graph, *LOCKSTEP, "lockstep_timeout:=0.3", answer=False)
    bench.run()
    assert bench.trials[-1].phase == TrialState.PHASE_ABORTED
    assert "stood still" in bench.trials[-1].message


def test_a_trial_waits_for_the_nodes_it_needs_and_says_so(single_graph: Any) -> None:
    bench = Bench(single_graph, "pacing:=lockstep", "required_nodes:=['mig_filter']", "ready_timeout:=0.3")
    bench.run()
    assert bench.states == []
    assert "/rig/mig_filter has not reported" in bench.trials[-1].message


def test_services_start_abort_and_reset(single_graph: Any) -> None:
    bench = Bench(single_graph, "pacing:=realtime", "duration:=60.0", "required_nodes:=['']")
    first = bench.start()
    assert first.success
    single_graph.until(lambda: len(bench.states) > 3)
    again = bench.start()
    assert not again.success
    assert topics.ABORT_SERVICE in again.message
    aborted = single_graph.call(AbortTrial, topics.ABORT_SERVICE, AbortTrial.Request(reason="enough"))
    assert aborted.success
    single_graph.until(bench.ended)
    assert bench.trials[-1].message == "enough"
    assert not single_graph.call(AbortTrial, topics.ABORT_SERVICE, AbortTrial.Request()).success
    assert single_graph.call(Trigger, topics.RESET_SERVICE, Trigger.Request()).success
    single_graph.until(lambda: bench.trials[-1].phase == TrialState.PHASE_IDLE)
    assert not bench.start(duration=-1.0).success
    assert bench.start(duration=0.05).uid == first.uid + 1


@pytest.mark.parametrize("task", tasks.names())
def test_the_picture_is_published_for_viewers(single_graph: Any, task: str) -> None:
    robot = ("robot_damping:=40.0",) if task == "slip" else ()
    pictures, joints = single_graph.collect(topics.MARKERS), single_graph.collect(topics.JOINT_STATES)
    bench = Bench(single_graph, f"task:={task}", "duration:=60.0", "required_nodes:=['']", "view_rate:=100.0", *robot)
    single_graph.until(lambda: bench.node.count_subscribers(topics.MARKERS.name) > 0)
    assert bench.start().success
    single_graph.until(lambda: len(pictures) > 3 and len(joints) > 3 and len(bench.states) > 10)
    # What is slow on a busy machine must not also have more and more to look at.
    assert single_graph.call(AbortTrial, topics.ABORT_SERVICE, AbortTrial.Request()).success
    picture = pictures[-1]
    joint, state = bench.newest_of(joints, lambda joint: joint.header.stamp)
    names = tasks.get(task).state_names
    values = dict(zip(names, state.state, strict=True))
    assert list(joint.position) == [values[name] for name in joint.name]
    for name, velocity in zip(joint.name, joint.velocity, strict=True):
        assert velocity == values[f"{name}_dot"] if f"{name}_dot" in values else math.isnan(velocity)
    assert {marker.header.frame_id for marker in picture.markers} == {topics.TASK_FRAME}
    assert len({marker.id for marker in picture.markers}) == len(picture.markers) > 2


def test_the_pendulum_stands_in_the_picture_where_it_is(single_graph: Any) -> None:
    pictures = single_graph.collect(topics.MARKERS)
    bench = Bench(
        single_graph, "duration:=60.0", "required_nodes:=['']", "initial_state:=[0.5, 0.0, 3.0, 0.0]", answer=False
    )
    single_graph.until(lambda: bench.node.count_subscribers(topics.MARKERS.name) > 0)
    assert bench.start().success
    single_graph.until(lambda: bool(pictures))
    picture, state = bench.newest_of(pictures, lambda picture: picture.markers[0].header.stamp)
    spheres = [marker for marker in picture.markers if marker.type == Marker.SPHERE]
    theta, cart = state.state[0], state.state[2]
    bob = spheres[-1].pose.position
    assert (bob.x, bob.z) == pytest.approx((cart + 2.0 * math.sin(theta), 2.0 * math.cos(theta)))


def test_a_bad_parameter_is_refused_by_name(single_graph: Any) -> None:
    with pytest.raises(ParameterError, match=r"sample_time.*-0.01"):
        single_graph.make(TaskSimNode, "sample_time:=-0.01")
