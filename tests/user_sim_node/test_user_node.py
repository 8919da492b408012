"""The user's node alone: a state in, a force of its own seed out."""

from __future__ import annotations

from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from loop_messages import SAMPLE, state

from mig_interfaces.msg import TrialState
from rig_runtime import topics
from shared_control.parameters import ParameterError
from user_sim_node.node import UserSimNode


def forces(graph: Any, seed: int, uid: int, bench: dict[str, Any]) -> list[float]:
    message = TrialState(phase=TrialState.PHASE_ARMING, uid=uid, seed=seed)
    message.sample_time.nanosec = SAMPLE
    bench["trials"].publish(message)
    graph.until(lambda: bench["node"].armed_uid == uid)
    out: list[WrenchStamped] = bench["out"]
    out.clear()
    for tick in range(20):
        bench["states"].publish(state(tick))
    graph.until(lambda: len(out) == 20)
    assert [w.header.stamp for w in out] == [state(tick).header.stamp for tick in range(20)]
    assert all(w.header.frame_id == topics.SENSOR_FRAME for w in out)
    return [w.wrench.force.x for w in out]


def make(graph: Any, *parameters: str) -> dict[str, Any]:
    node = graph.make(UserSimNode, *parameters)
    bench = {
        "node": node,
        "states": graph.publisher(topics.TASK_STATE),
        "trials": graph.publisher(topics.TRIAL_STATE),
        "out": graph.collect(topics.WRENCH),
    }
    graph.until(lambda: bool(bench["states"].get_subscription_count() and bench["trials"].get_subscription_count()))
    graph.until(lambda: all(node.make_report().matched_subscriptions))
    return bench


def test_the_seed_of_the_trial_decides_the_noise(graph: Any) -> None:
    bench = make(graph, "user:=noise")
    first = forces(graph, seed=5, uid=1, bench=bench)
    assert len(set(first)) == 20
    assert forces(graph, seed=6, uid=2, bench=bench) != first
    assert forces(graph, seed=5, uid=3, bench=bench) == first


def test_an_idle_user_pushes_nothing(single_graph: Any) -> None:
    assert set(forces(single_graph, 0, 1, make(single_graph, "user:=idle"))) == {0.0}


def test_a_bad_parameter_is_refused_by_name(single_graph: Any) -> None:
    with pytest.raises(ParameterError, match=r"user.*'ghost'"):
        single_graph.make(UserSimNode, "user:=ghost")
