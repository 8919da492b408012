"""The controller against scipy's optimiser on a cost computed by other code, and its fallbacks."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from shared_control import controllers, tasks
from shared_control.cost import quadratic
from shared_control.parameters import ParameterError

TASK = tasks.get("cart_pendulum")
COST = quadratic(TASK)


def make(**options):
    return controllers.make("ilqr", TASK, COST, **options)


@pytest.mark.parametrize("limit", [20.0, 3.0])
@pytest.mark.parametrize("x", [(0.3, 0.5, 0.1, -0.2), (2.6, -1.0, 0.5, 0.0), (-1.2, 3.0, 0.0, 1.0)])
def test_against_scipy(oracle, x, limit):
    steps, dt = 12, 0.05
    controller = make(dt=dt, horizon=steps * dt, iterations=200, tolerance=1e-12, limits=(limit,))
    solution = controller.solve(np.array(x))

    def objective(us):
        j = oracle.cost(np.array(x)[:, None], [np.array([u]) for u in us], dt)
        return float(j[0])

    def gradient(us):
        bumped = us[:, None] + 1e-30j * np.eye(steps)
        return oracle.cost(np.array(x, complex)[:, None] * np.ones(steps), list(bumped), dt).imag / 1e-30

    best = minimize(
        objective, np.zeros(steps), jac=gradient, bounds=[(-limit, limit)] * steps, method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 2000},
    )  # fmt: skip
    assert solution.usable
    assert objective(controller.schedule[:, 0]) == pytest.approx(solution.cost, rel=1e-12)
    assert solution.cost == pytest.approx(best.fun, rel=1e-8)
    np.testing.assert_allclose(controller.schedule[:, 0], best.x, atol=2e-3 * limit)
    assert np.abs(controller.schedule).max() <= limit


def test_more_iterations_never_cost_more(states):
    for x in states(10, 21).T:
        costs = [make(iterations=i, tolerance=0.0).solve(x).cost for i in (1, 2, 5, 20)]
        assert all(b <= a for a, b in itertools.pairwise(costs))


def test_warm_start_shifts():
    controller = make(iterations=50)
    x = TASK.initial_state
    first = controller.solve(x)
    before = controller.schedule
    assert np.array_equal(first.control, before[0])
    assert np.array_equal(first.control, controller.fallback())
    controller.advance()
    assert np.array_equal(controller.schedule[:-1], before[1:])
    assert controller.schedule[-1] == 0.0
    assert np.array_equal(controller.fallback(), before[1])


def test_schedule_runs_out_and_is_forgotten():
    controller = make(horizon=0.05)
    controller.solve(np.array([0.3, 0.0, 0.0, 0.0]))
    assert controller.fallback() != 0.0
    for _ in range(5):
        controller.advance()
    assert np.array_equal(controller.fallback(), [0.0])
    controller.solve(np.array([0.3, 0.0, 0.0, 0.0]))
    controller.reset()
    assert np.array_equal(controller.fallback(), [0.0])


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e200])
def test_unusable_state_gives_last_valid_schedule(bad):
    controller = make()
    assert np.array_equal(controller.solve(np.array([0.0, 0.0, bad, 0.0])).control, [0.0])
    good = controller.solve(np.array([0.3, 0.0, 0.0, 0.0]))
    assert good.usable
    second = controller.schedule[1]
    controller.advance()
    lost = controller.solve(np.array([0.0, 0.0, bad, 0.0]))
    assert not lost.usable
    assert not lost.converged
    assert np.array_equal(lost.control, second)


anything = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=100, deadline=None)
@given(st.tuples(anything, anything, anything, anything))
def test_never_a_control_that_is_not_finite(x):
    controller = make(horizon=0.2)
    for _ in range(2):
        solution = controller.solve(np.array(x))
        assert np.all(np.abs(solution.control) <= 20.0)


def test_upright_at_rest_needs_nothing():
    solution = make().solve(np.zeros(4))
    assert solution.converged
    assert solution.cost == 0.0
    assert np.array_equal(solution.control, [0.0])


def test_mirror(states):
    for x in states(20, 22).T:
        assert np.array_equal(make().solve(x).control, -make().solve(-x).control)


def test_no_weight_on_control():
    cost = quadratic(TASK, control_weights=(0.0,))
    solution = controllers.make("ilqr", TASK, cost).solve(np.array([0.2, 0.0, 0.0, 0.0]))
    assert solution.usable
    assert abs(solution.control[0]) <= 20.0


@pytest.mark.parametrize(
    "options",
    [{"limits": (0.0,)}, {"limits": (1.0, 2.0)}, {"iterations": 0}, {"tolerance": math.nan}, {"horizon": 0.0}],
)
def test_refused(options):
    with pytest.raises(ParameterError):
        make(**options)
    with pytest.raises(ParameterError, match="did you mean ilqr"):
        controllers.make("ilqt", TASK, COST)
