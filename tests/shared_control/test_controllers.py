"""iLQR against scipy's optimiser and SAC against its formula, on a cost computed by other code; their fallbacks."""

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


def make(name="ilqr", **options):
    return controllers.make(name, TASK, COST, **options)


BOTH = pytest.mark.parametrize("name", controllers.names())


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


@BOTH
def test_more_iterations_never_cost_more(name, states):
    for x in states(10, 21).T:
        costs = [make(name, iterations=i, tolerance=0.0).solve(x).cost for i in (1, 2, 5, 20)]
        assert all(b <= a for a, b in itertools.pairwise(costs))


@BOTH
def test_warm_start_shifts(name):
    controller = make(name, iterations=50)
    x = TASK.initial_state
    first = controller.solve(x)
    before = controller.schedule
    assert np.array_equal(first.control, before[0])
    assert np.array_equal(first.control, controller.fallback())
    controller.advance()
    assert np.array_equal(controller.schedule[:-1], before[1:])
    assert controller.schedule[-1] == 0.0
    assert np.array_equal(controller.fallback(), before[1])


@BOTH
def test_schedule_runs_out_and_is_forgotten(name):
    controller = make(name, horizon=0.05)
    controller.solve(np.array([0.3, 0.0, 0.0, 0.0]))
    assert controller.fallback() != 0.0
    for _ in range(5):
        controller.advance()
    assert np.array_equal(controller.fallback(), [0.0])
    controller.solve(np.array([0.3, 0.0, 0.0, 0.0]))
    controller.reset()
    assert np.array_equal(controller.fallback(), [0.0])


@BOTH
@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e200])
def test_unusable_state_gives_last_valid_schedule(name, bad):
    controller = make(name)
    assert np.array_equal(controller.solve(np.array([0.0, 0.0, bad, 0.0])).control, [0.0])
    good = controller.solve(np.array([0.3, 0.0, 0.0, 0.0]))
    assert good.usable
    second = controller.schedule[1]
    controller.advance()
    lost = controller.solve(np.array([0.0, 0.0, bad, 0.0]))
    assert not lost.usable
    assert not lost.converged
    assert np.array_equal(lost.control, second)


@pytest.mark.parametrize(("gamma", "limit"), [(-0.3, 20.0), (-0.05, 20.0), (-0.3, 1.0)])
def test_sac_is_the_papers_schedule(oracle, gamma, limit):
    """One iteration, the full step: (Lambda + R)^-1 (Lambda u_1 + h^T rho alpha_d), saturated, from u_1 = 0."""
    x, steps = np.array([0.5, 0.2, 0.1, 0.0]), 30
    controller = make("sac", horizon=steps * 0.01, iterations=1, gamma=gamma, tries=1, limits=(limit,))
    solution = controller.solve(x)
    bumps = 1e-30j * np.eye(steps)
    cost = oracle.cost(np.outer(x, np.ones(steps)).astype(complex), list(bumps), 0.01, effort=False)
    h_rho = cost.imag / 1e-30 / 0.01
    wanted = h_rho * gamma * cost.real / (h_rho**2 + oracle.r)
    clipped = np.clip(wanted, -limit, limit)
    assert solution.cost < 0.999 * cost.real[0]
    np.testing.assert_allclose(controller.schedule[:, 0], clipped, rtol=1e-9, atol=1e-12)


def test_sac_refuses():
    for options in ({"gamma": 1.0}, {"gamma": math.nan}, {"tries": 0}):
        with pytest.raises(ParameterError, match="sac"):
            make("sac", **options)


anything = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=100)
@given(st.tuples(anything, anything, anything, anything), st.sampled_from(controllers.names()))
def test_never_a_control_that_is_not_finite(x, name):
    controller = make(name, horizon=0.2)
    for _ in range(2):
        solution = controller.solve(np.array(x))
        assert np.all(np.abs(solution.control) <= 20.0)


@BOTH
def test_upright_at_rest_needs_nothing(name):
    solution = make(name).solve(np.zeros(4))
    assert solution.converged
    assert solution.cost == 0.0
    assert np.array_equal(solution.control, [0.0])


@BOTH
def test_mirror(name, states):
    for x in states(20, 22).T:
        assert np.array_equal(make(name).solve(x).control, -make(name).solve(-x).control)


@BOTH
def test_no_weight_on_control(name):
    cost = quadratic(TASK, control_weights=(0.0,))
    solution = controllers.make(name, TASK, cost).solve(np.array([0.2, 0.0, 0.0, 0.0]))
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
