"""The four nodes and the recorder in one process: a lockstep run repeats itself, and is what the science says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from whole_graph import assert_same, data, sections

import rig_bag
from shared_control.trial import run_trial


@pytest.mark.parametrize(
    ("mode", "executor"), [("assistance", "events"), ("training", "events"), ("assistance", "single")]
)
def test_lockstep_equals_the_headless_trial_exactly(
    run_composed: Callable[..., Path], tmp_path: Path, mode: str, executor: str
) -> None:
    got = data(run_composed("bag", mode, executor))
    science = {key: value for key, value in sections(tmp_path, mode).items() if "recorder" not in key}
    del science["/**/task_sim"]
    headless = run_trial(science, 7)
    state, decision = got["/rig/task/state"], got["/rig/mig_filter/decision"]
    np.testing.assert_array_equal(state["state"], headless.states[:-1])
    np.testing.assert_array_equal(got["/rig/force_sensor/wrench"]["wrench.force"], headless.user_force)
    np.testing.assert_array_equal(got["/rig/mig_filter/command"]["wrench.force"], headless.admitted_force)
    for field in ("user_control", "applied_control", "verdict", "reason", "criterion"):
        np.testing.assert_array_equal(decision[field], getattr(headless, field), err_msg=field)
    assert len(state) == 200


def test_lockstep_runs_are_identical_with_one_seed_and_differ_with_another(
    run_composed: Callable[..., Path],
) -> None:
    first = data(run_composed("first"))
    assert_same(first, data(run_composed("again")))
    other = data(run_composed("other", seed=8))
    assert not np.array_equal(
        first["/rig/force_sensor/wrench"]["wrench.force"], other["/rig/force_sensor/wrench"]["wrench.force"]
    )


@pytest.mark.parametrize("executor", ["events", "single"])
def test_realtime_has_every_tick_and_every_decision(run_composed: Callable[..., Path], executor: str) -> None:
    bag = run_composed("bag", executor=executor, pacing="realtime", duration=1.0)
    got = data(bag)
    for topic in ("task/state", "force_sensor/wrench", "mig_filter/command", "mig_filter/decision"):
        assert len(got[f"/rig/{topic}"]) == 100, topic
    np.testing.assert_array_equal(got["/rig/mig_filter/decision"]["tick"], np.arange(100))
    by_verdict = [len(got[f"/rig/mig_filter/{name}"]) for name in ("accepted", "rejected", "replaced")]
    assert sum(by_verdict) == 100
    stamps = got["/rig/task/state"]["stamp"]
    np.testing.assert_array_equal(np.diff(stamps), 10_000_000)
    last = rig_bag.read(bag, ["/rig/trial/state"])["/rig/trial/state"][-1]
    missed = last["missed_deadlines"] if isinstance(last, np.void) else last.missed_deadlines
    assert missed >= np.count_nonzero(got["/rig/task/state"]["held"])
