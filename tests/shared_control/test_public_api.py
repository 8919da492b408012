"""What others call by name: every entry exists, takes what it is said to take and gives what it is said to give."""

from __future__ import annotations

import inspect
import math

import numpy as np
import pytest
import yaml

from shared_control import controllers, measures, mig, tasks, trial, users
from shared_control.admittance import Admittance, AdmittanceConfig
from shared_control.cost import quadratic
from shared_control.filter import Decision, FilterConfig, MigFilter
from shared_control.scenario import find
from shared_control.trial import TrialResult

CART_PENDULUM = (
    "success", "time_to_success", "balance_time", "rms_error", "pra", "pra_trial", "cart_excursion",
    "upright_at_end",
)  # fmt: skip
SLIP = ("fell", "fall_time", "override", "mean_speed", "speed_rmse", "speed_correlation")
SLIP += ("stride_speed_rmse", "stride_speed_correlation")


def test_task():
    task = tasks.get("cart_pendulum", length=1.0, damping=0.0)
    assert isinstance(task, tasks.Task)
    assert (task.parameters.length, task.parameters.damping) == (1.0, 0.0)


@pytest.mark.parametrize("name", ["cart_pendulum", "slip"])
def test_criterion(name):
    task = tasks.get(name)
    x, u = task.initial_state, np.ones(task.m)
    by_default = mig.mig_integral(task, quadratic(task), x, u, horizon=0.3, dt=0.01)
    assert type(by_default) is float
    assert by_default == mig.mig_integral(task, quadratic(task), x, u, horizon=0.3, dt=0.01, adjoint_along="nominal")
    assert math.isfinite(mig.mig_integral(task, quadratic(task), x, u, horizon=0.3, dt=0.01, adjoint_along="user"))
    by_keyword = {p.name for p in inspect.signature(mig.mig_integral).parameters.values() if p.kind == p.KEYWORD_ONLY}
    assert {"horizon", "dt", "adjoint_along"} <= by_keyword


@pytest.mark.parametrize("name", ["cart_pendulum", "slip"])
@pytest.mark.parametrize("mode", ["off", "training", "assistance"])
def test_filter(name, mode):
    task = tasks.get(name)
    decision = MigFilter(task, FilterConfig(mode=mode, horizon=0.3)).decide(task.initial_state, np.ones(task.m))
    assert isinstance(decision, Decision)
    assert set(decision._fields) >= {
        "verdict", "reason", "criterion", "user_control", "nominal_control", "applied_control",
    }  # fmt: skip
    assert decision.applied_control.shape == (task.m,)


@pytest.mark.parametrize("name", ["cart_pendulum", "slip"])
@pytest.mark.parametrize("controller", ["sac", "ilqr"])
def test_controller(name, controller):
    task = tasks.get(name)
    solution = controllers.make(controller, task, quadratic(task), horizon=0.3).solve(task.initial_state)
    assert solution.control.shape == (task.m,)
    assert np.all(np.abs(solution.control) <= task.control_limits)
    assert solution.usable
    assert solution.converged in (True, False)


@pytest.mark.parametrize("name", ["cart_pendulum", "slip"])
@pytest.mark.parametrize("user", ["noise", "idle", "mpc", "graded", "human", "replay"])
def test_user(name, user, tmp_path):
    task = tasks.get(name)
    options = {}
    if user == "replay":
        np.save(tmp_path / "forces.npy", np.ones((2, 3)))
        options["recording"] = str(tmp_path / "forces.npy")
    robot = tasks.Robot(0.01, 40.0)
    force = users.make(user, task, seed=3, robot=robot, **options).act(0, 0.0, task.initial_state)
    assert force.shape == (3,)
    assert np.all(np.isfinite(force))


def test_measures():
    assert measures.cart_pendulum(np.zeros((11, 4)), 0.01)._fields == CART_PENDULUM
    assert measures.slip(np.ones((11, 5)), 0.01)._fields == SLIP


@pytest.mark.parametrize("name", ["cart_pendulum_noise_assistance", "slip_low_skill_assistance"])
def test_trial_from_a_path_and_from_a_mapping(name):
    content = yaml.safe_load(find(name).read_text())
    content["/**"]["ros__parameters"]["duration"] = 0.2
    result = trial.run_trial(content, 5)
    assert isinstance(result, TrialResult)
    assert type(result.measures)._fields == (SLIP if name.startswith("slip") else CART_PENDULUM)
    (again,) = trial.run_trials(content, [5], workers=None)
    assert np.array_equal(result.states, again.states)
    assert list(inspect.signature(trial.run_trial).parameters)[:2] == ["scenario", "seed"]


def test_scenarios_are_where_they_are_looked_for():
    for mode in ("off", "training", "assistance"):
        for which in ("cart_pendulum_noise", "slip_noise", "slip_low_skill", "slip_skilled"):
            assert find(f"{which}_{mode}").is_file()


def test_admittance():
    motion = Admittance(AdmittanceConfig()).step(np.array([3.0, 0.0, 0.0]))
    assert motion.acceleration[0] == 3.0 / tasks.Robot().mass
