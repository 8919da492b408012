"""Whole graphs for tests: composed on one executor, or as separate processes through the scripts that people use."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from node_graph import Graph

import rig_bag
from mig_interfaces.msg import RecorderState, TrialState
from rig_bringup.compose import graph as graph_of
from rig_runtime import topics

#: Topics whose decoded messages a lockstep run determines.
DATA_TOPICS = tuple(f"/rig/{topic.name}" for topic in (*topics.PER_TICK, *topics.BY_VERDICT))

NODES = ["user_sim", "mig_filter", "admittance_sim", "recorder"]


def sections(bag: Path, mode: str = "assistance", **loop: Any) -> dict[str, Any]:
    """A scenario as its sections: lockstep, two seconds, unless said otherwise."""
    shared = {"pacing": "lockstep", "duration": 2.0, "seed": 7, **loop}
    return {
        "/**": {"ros__parameters": shared},
        "/**/mig_filter": {"ros__parameters": {"mode": mode}},
        "/**/user_sim": {"ros__parameters": {"user": "noise"}},
        "/**/task_sim": {"ros__parameters": {"required_nodes": NODES, "ready_timeout": 60.0}},
        "/**/recorder": {"ros__parameters": {"uri": str(bag)}},
    }


@pytest.fixture
def run_composed(tmp_path: Path) -> Callable[..., Path]:
    """Run a trial with all nodes on one executor; return its bag.

    Long trials take the events executor, which people run and which is several times as fast as the reference.
    """

    def run(name: str, mode: str = "assistance", executor: str = "events", **loop: Any) -> Path:
        bag = tmp_path / name
        file = tmp_path / f"{name}.yaml"
        file.write_text(yaml.safe_dump(sections(bag, mode, **loop)))
        # A graph for each run: in the events executor, calls of a destroyed node may still be queued.
        graph = Graph(executor)
        try:
            trials: list[TrialState] = graph.collect(topics.TRIAL_STATE)
            recorder: list[RecorderState] = graph.collect(topics.RECORDER_STATE)
            for factory in graph_of(record=True):
                graph.make(factory, params_file=file)
            graph.until(lambda: bool(trials) and trials[-1].phase >= TrialState.PHASE_FINISHED, limit=120.0)
            graph.until(lambda: bool(recorder) and not recorder[-1].recording)
            assert trials[-1].phase == TrialState.PHASE_FINISHED, trials[-1].message
        finally:
            graph.close()
        return bag

    return run


def data(bag: Path) -> dict[str, Any]:
    """The decoded messages of a bag's data topics, without the times at which the recorder got them."""
    arrays = rig_bag.read(bag, DATA_TOPICS)
    return {
        topic: table[[name for name in table.dtype.names if name not in ("log_time", "publish_time")]]
        for topic, table in arrays.items()
    }


def assert_same(first: dict[str, Any], second: dict[str, Any]) -> None:
    """Every topic has the same messages, to the last bit."""
    assert first.keys() == second.keys()
    for topic, table in first.items():
        assert len(table) == len(second[topic]), topic
        for field in table.dtype.names:
            np.testing.assert_array_equal(table[field], second[topic][field], err_msg=f"{topic} {field}")
