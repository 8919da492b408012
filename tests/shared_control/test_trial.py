"""Trials: the agents by hand give the same floats, any process gives the same floats."""

from __future__ import annotations

import dataclasses
import math
import os
import subprocess
import sys

import numpy as np
import pytest

from shared_control import loop
from shared_control.filter import Reason, Verdict
from shared_control.parameters import ParameterError
from shared_control.scenario import load
from shared_control.trial import judged, run_trial, run_trials


def equal(a, b):
    for field in dataclasses.fields(a):
        left, right = getattr(a, field.name), getattr(b, field.name)
        if isinstance(left, np.ndarray):
            assert np.array_equal(left, right, equal_nan=left.dtype.kind == "f"), field.name
        elif field.name != "measures":
            assert left == right, field.name
        else:
            assert repr(left) == repr(right)
    return True


def test_agents_by_hand(scenario):
    result = run_trial(scenario, 3)
    user, filter_ = loop.make_user(scenario, 3), loop.make_filter(scenario)
    robot, plant = loop.make_robot(scenario), loop.make_plant(scenario, 3)
    for agent in (user, filter_, robot, plant):
        agent.warm_up()
    x = plant.state
    assert np.array_equal(result.states[0], x)
    for k in range(len(result.time)):
        force = user.act(k, result.time[k], x, plant.task_mode)
        outcome = filter_.decide(x, force, plant.task_mode)
        x = plant.step(robot.step(outcome.admitted_force), outcome.admitted_force)
        assert np.array_equal(result.states[k + 1], x)
        assert np.array_equal(result.user_force[k], force)
        assert np.array_equal(result.admitted_force[k], outcome.admitted_force)
        assert result.verdict[k] == outcome.decision.verdict
        assert np.array_equal(plant.control, outcome.decision.applied_control)


def test_shapes_and_consistency(scenario):
    result = run_trial(scenario)
    assert result.seed == scenario.loop.seed
    assert result.time.shape == (100,)
    assert result.time[37] == 37 * 0.01
    assert result.states.shape == (101, 4)
    assert result.user_force.shape == result.admitted_force.shape == (100, 3)
    assert result.user_control.shape == result.applied_control.shape == (100, 1)
    accepted = result.verdict == Verdict.ACCEPTED
    assert 20 < accepted.sum() < 80
    assert np.array_equal(accepted, result.criterion <= 0.0)
    assert np.all(result.reason == Reason.CRITERION)
    assert np.array_equal(result.applied_control[accepted], result.user_control[accepted])
    assert result.measures.pra_trial == pytest.approx(1.0 - accepted.mean())


def test_any_number_of_workers(scenario, capsys):
    seeds = [4, 2, 9]
    one, two = (run_trials(scenario, seeds, workers=workers, progress=True) for workers in (1, 2))
    assert [result.seed for result in one] == seeds
    assert all(equal(a, b) for a, b in zip(one, two, strict=True))
    assert equal(one[1], run_trial(scenario, 2))
    assert not np.array_equal(one[0].states, one[1].states)
    assert "3/3" in capsys.readouterr().err


def test_any_process(scenario):
    """An interpreter of its own, with other hashes and another thread count, gives the same floats."""
    code = (
        "from shared_control.trial import run_trial\n"
        "result = run_trial({'/**': {'ros__parameters': {'duration': 1.0}}}, 3)\n"
        "print((result.states.tobytes() + result.admitted_force.tobytes()).hex())\n"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "5", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment, timeout=300
    )
    here = run_trial(scenario, 3)
    assert run.stdout.strip() == (here.states.tobytes() + here.admitted_force.tobytes()).hex()


def test_no_seeds_and_no_workers(scenario):
    assert run_trials(scenario, [], workers=2) == []
    with pytest.raises(ParameterError, match="workers"):
        run_trials(scenario, [1], workers=0)


def test_idle_user_is_never_stopped(scenario):
    result = run_trial(dataclasses.replace(scenario, user=dataclasses.replace(scenario.user, user="idle")))
    assert np.all(result.reason == Reason.NULL_ACTION)
    assert np.isnan(result.measures.pra_trial)
    assert np.abs(result.states[-1, 0]) == pytest.approx(np.pi)


def test_only_a_runner_with_a_purpose_has_a_speed_to_keep():
    for name, kept in (("slip_skilled_off", True), ("slip_noise_off", False)):
        runner = load(name)
        short = dataclasses.replace(runner, loop=dataclasses.replace(runner.loop, duration=2.5))
        measures = run_trial(short, 3).measures
        assert math.isfinite(measures.speed_rmse) == kept
        assert math.isfinite(measures.stride_speed_rmse) == kept
        assert math.isfinite(measures.mean_speed)


def test_judged_after_the_fact(scenario):
    """In training a verdict depends on state and action only: judging the record gives what the filter gave."""
    training = dataclasses.replace(scenario, filter=dataclasses.replace(scenario.filter, mode="training"))
    result = run_trial(training, 3)
    assert repr(judged(result, training)) == repr(result.measures)
    alone = run_trial(dataclasses.replace(scenario, filter=dataclasses.replace(scenario.filter, mode="off")), 3)
    assert alone.measures.pra_trial == 0.0
    assert 0.2 < judged(alone, training).pra_trial < 0.8
