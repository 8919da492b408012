"""The base of every node: which trials it takes, what it counts and says."""

from __future__ import annotations

from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from mig_interfaces.msg import TrialState
from rig_runtime import topics
from rig_runtime.node import RigNode


def trial(**changes: Any) -> TrialState:
    """A trial that a pacemaker could have announced, or nearly."""
    message = TrialState(phase=TrialState.PHASE_RUNNING, uid=1, ticks_planned=100)
    message.sample_time.nanosec = 10_000_000
    for name, value in changes.items():
        part: Any = message
        *path, last = name.split("__")
        for attribute in path:
            part = getattr(part, attribute)
        setattr(part, last, value)
    return message


@pytest.mark.parametrize(
    "changes",
    [
        {"phase": 200},
        {"sample_time__nanosec": 0},
        {"ticks_planned": 2**32 - 1},
        {"epoch__sec": -1},
        {"epoch__nanosec": 2 * 10**9},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_a_trial_that_cannot_be_is_counted_and_ends_nothing(single_graph: Any, changes: dict[str, Any]) -> None:
    node = single_graph.make(lambda **kwargs: RigNode("node", **kwargs))
    said: list[DiagnosticStatus] = []
    single_graph.node.create_subscription(DiagnosticArray, "/diagnostics", lambda array: said.extend(array.status), 10)
    trials = single_graph.publisher(topics.TRIAL_STATE)
    single_graph.until(lambda: trials.get_subscription_count() == 1)
    trials.publish(trial(**changes))
    single_graph.until(lambda: node.refused == 1)
    assert (node.armed_uid, node.clock) == (0, None)
    single_graph.until(lambda: any(pair.key == "malformed messages" and pair.value == "1" for pair in values(said)))
    assert (said[-1].level, said[-1].message) == (DiagnosticStatus.OK, "running")
    trials.publish(trial())
    single_graph.until(lambda: node.armed_uid == 1)
    assert node.refused == 1


def values(said: list[DiagnosticStatus]) -> list[Any]:
    return [pair for status in said for pair in status.values]


def test_before_any_trial_a_stamp_is_no_tick_and_the_first_of_one_is_tick_0(single_graph: Any) -> None:
    node = single_graph.make(lambda **kwargs: RigNode("node", **kwargs))
    assert node.tick_of(7) is None
    node.follow_trial(trial(phase=TrialState.PHASE_ARMING))
    # It overtakes the announcement of its t_0.
    assert [node.tick_of(stamp) for stamp in (7, 10_000_007, 10_000_008)] == [0, 1, None]


def test_only_while_a_trial_is_armed_a_node_wakes_more_than_four_times_a_second(graph: Any) -> None:
    node = graph.make(lambda **kwargs: RigNode("node", **kwargs))

    def periods() -> list[int]:
        return sorted(timer.timer_period_ns // 1_000_000 for timer in node.timers if not timer.is_canceled())

    assert periods() == [250]
    node.follow_trial(trial(phase=TrialState.PHASE_ARMING))
    assert periods() == [50, 250]
    node.follow_trial(trial())
    graph.until(lambda: periods() == [250])


def test_between_two_diagnostics_a_node_reports_twice(graph: Any) -> None:
    said: list[str] = []

    class Speaker(RigNode):
        def make_report(self) -> Any:
            said.append("report")
            return super().make_report()

        def diagnose(self) -> Any:
            said.append("diagnostics")
            return super().diagnose()

    graph.make(lambda **kwargs: Speaker("node", **kwargs))
    graph.until(lambda: len(said) >= 7)
    assert said[:7] == ["report", "report", "diagnostics", "report", "report", "diagnostics", "report"]


def test_who_spins_a_node_is_told_that_it_is_done_with_the_worst_code(single_graph: Any) -> None:
    node = single_graph.make(lambda **kwargs: RigNode("node", **kwargs))
    node.stop(3)
    told: list[int] = []
    node.on_stop(lambda: told.append(node.exit_code))
    node.stop(1)
    assert told == [3]


def test_the_end_of_a_trial_is_told_once_and_only_of_its_own(single_graph: Any) -> None:
    ended: list[int] = []

    class Listener(RigNode):
        def trial_ended(self, trial: TrialState) -> None:
            ended.append(trial.uid)

    node = single_graph.make(lambda **kwargs: Listener("node", **kwargs))
    node.follow_trial(trial(phase=TrialState.PHASE_FINISHED, uid=4))
    node.follow_trial(trial(uid=5))
    node.follow_trial(trial(phase=TrialState.PHASE_FINISHED, uid=5))
    node.follow_trial(trial(phase=TrialState.PHASE_FINISHED, uid=5))
    assert ended == [5]
