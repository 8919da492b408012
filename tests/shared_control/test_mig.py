"""The criterion against differences and complex steps of a cost that is computed by other code, and its identities."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from shared_control import tasks
from shared_control.cost import quadratic
from shared_control.mig import ALONG, CostOfNothing, Criterion, mig_integral, samples
from shared_control.parameters import ParameterError

TASK = tasks.get("cart_pendulum")
COST = quadratic(TASK)
DT = 0.01
STEPS = 80


def criteria(along, horizon=STEPS * DT, cost=COST, task=TASK):
    return Criterion(task, cost, horizon=horizon, dt=DT, adjoint_along=along)


def first_sample(u):
    return [u] + [0 * u] * (STEPS - 1)


@pytest.mark.parametrize("along", ALONG)
def test_against_central_differences(oracle, states, along):
    """At least 1,000 random states, five-point differences, where no node crosses the wrap."""
    x = states(1300, 7)
    u = np.random.default_rng(8).normal(0.0, 20.0, x.shape[1])
    centre, width = (0.0 if along == "nominal" else 1.0), 1e-3
    values, turns = {}, [oracle.turns(oracle.simulate(x, first_sample(centre * u), DT))]
    for s in (-2, -1, 1, 2):
        controls = first_sample((centre + s * width) * u)
        values[s] = oracle.cost(x, controls, DT, effort=False)
        turns.append(oracle.turns(oracle.simulate(x, controls, DT)))
    slope = (8 * (values[1] - values[-1]) - (values[2] - values[-2])) / (12 * width)
    usable = np.all([np.all(t == turns[0], axis=0) for t in turns], axis=0)
    assert usable.sum() >= 1000
    criterion = criteria(along)
    found = np.array([criterion(x[:, i], u[i : i + 1]) for i in range(x.shape[1])])
    np.testing.assert_allclose(found[usable], slope[usable], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("along", ALONG)
def test_against_complex_steps(oracle, states, along):
    """The twin in plain numpy: the same derivative, exact to rounding."""
    x = states(300, 9)
    u = np.random.default_rng(10).normal(0.0, 20.0, x.shape[1])
    centre = 0.0 if along == "nominal" else 1.0
    j = oracle.cost(x.astype(complex), first_sample(centre * u + 1e-30j * u), DT, effort=False)
    criterion = criteria(along)
    found = [criterion(x[:, i], u[i : i + 1]) for i in range(x.shape[1])]
    np.testing.assert_allclose(found, j.imag / 1e-30, rtol=1e-12, atol=1e-12 * np.abs(j.real).max())


@pytest.mark.parametrize("along", ALONG)
@pytest.mark.parametrize("samples_after", [1, 30, STEPS - 1, STEPS + 20])
def test_with_what_follows_against_complex_steps(oracle, states, along, samples_after):
    """u_2 goes on after the user's sample, for a part of the horizon, all of it, or longer than it."""
    x, random = states(40, 13), np.random.default_rng(14)
    schedules = random.normal(0.0, 10.0, (1 + samples_after, 40))
    centre = 0.0 if along == "nominal" else 1.0
    applied = np.zeros((STEPS, 40))
    applied[: 1 + samples_after] = schedules[:STEPS]
    j = oracle.cost(x.astype(complex), list((centre + 1e-30j) * applied), DT, effort=False)
    criterion = criteria(along)
    found = [criterion(x[:, i], schedules[0, i : i + 1], then=schedules[1:, i : i + 1]) for i in range(40)]
    np.testing.assert_allclose(found, j.imag / 1e-30, rtol=1e-12, atol=1e-12 * np.abs(j.real).max())
    alone = criterion(x[:, 0], schedules[0, :1])
    assert alone != found[0]
    assert criterion(x[:, 0], schedules[0, :1], then=np.zeros((STEPS, 1))) == pytest.approx(alone, rel=1e-12)


def test_with_terminal_cost_and_target(oracle, states):
    oracle.p = (50.0, 2.0, 3.0, 4.0)
    cost = quadratic(TASK, terminal_weights=oracle.p, target=(2.0 * math.pi, 0.0, 0.0, 0.0))
    x = states(50, 11)
    j = oracle.cost(x.astype(complex), first_sample(1e-30j * np.ones(50)), DT)
    criterion = criteria("nominal", cost=cost)
    found = [criterion(x[:, i], np.ones(1)) for i in range(50)]
    np.testing.assert_allclose(found, j.imag / 1e-30, rtol=1e-11, atol=1e-12 * np.abs(j.real).max())


def test_control_weight_has_no_slope_at_the_nominal(oracle, states):
    x = states(1, 12)[:, 0].astype(complex)
    slopes = [oracle.cost(x, first_sample(1e-30j), DT, effort=effort).imag for effort in (True, False)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-12)


def test_near_the_continuous_integral(oracle, states):
    """Against the cost integrated with the flow by DOP853: what is left is the quadrature's h^2."""

    def cost(x, u):
        y = np.append(x, 0.0)
        for control, span in ((u, DT), (0.0, (STEPS - 1) * DT)):

            def rates(_, y, control=control):
                wrapped = math.remainder(y[0], 2 * math.pi)
                running = 0.5 * (oracle.q[0] * wrapped**2 + oracle.q[2] * y[2] ** 2 + oracle.q[3] * y[3] ** 2)
                return np.append(oracle.flow(y[:4], control), running)

            y = solve_ivp(rates, (0.0, span), y, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        return y[4]

    criterion, scale = criteria("nominal"), 1e-3
    for x in states(6, 13).T * 0.1:
        slope = (cost(x, 5.0 * scale) - cost(x, -5.0 * scale)) / (2 * scale)
        assert criterion(x, np.array([5.0])) == pytest.approx(slope, rel=2e-3, abs=1e-3)


def test_half_space(states):
    """Along the nominal trajectory the criterion is linear in the control."""
    criterion = criteria("nominal")
    for x in states(100, 14).T:
        unit = criterion(x, np.ones(1))
        for u in (-30.0, -1.0, 0.0, 1e-3, 7.0):
            assert criterion(x, np.array([u])) == pytest.approx(u * unit, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("theta", [math.pi, -math.pi, 3.0 * math.pi])
@pytest.mark.parametrize("u", [1e-6, 0.1, 20.0])
def test_kink_at_rest(oracle, theta, u):
    """Hanging exactly at rest both pushes lower the cost, and the criterion is the one-sided slope of each."""
    criterion = criteria("nominal")
    x = np.array([theta, 0.0, 0.0, 0.0])
    right, left = criterion(x, np.array([u])), criterion(x, np.array([-u]))
    assert right == left < 0.0
    s, wide = np.longdouble(1e-6) / u, x.astype(np.longdouble)
    push = [oracle.cost(wide, first_sample(s * k * u), DT) for k in (0, 1, 2)]
    slope = float((-3 * push[0] + 4 * push[1] - push[2]) / (2 * s))
    assert right == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("tail", [(0.3, -0.5), (-1.0, 2.0)])
@pytest.mark.parametrize("samples_after", [0, 30, STEPS - 1])
@pytest.mark.parametrize("weights", [(0.0, 0.0, 0.0, 0.0), (50.0, 2.0, 3.0, 4.0)])
def test_kink_while_the_cart_moves(oracle, tail, samples_after, weights):
    """The other errors have slopes that push and counterpush do not share; each is that of J on its own side."""
    oracle.q, oracle.p = (200.0, 3.0, 20.0, 1.0), weights
    cost = quadratic(TASK, state_weights=oracle.q, terminal_weights=weights)
    criterion = criteria("nominal", cost=cost)
    x = np.array([math.pi, 0.0, *tail])
    schedule = np.random.default_rng(21).normal(0.0, 10.0, 1 + samples_after)
    s, wide = np.longdouble(1e-6), x.astype(np.longdouble)
    for side in (1.0, -1.0):
        u_2 = list(side * schedule) + [0.0] * (STEPS - 1 - samples_after)
        j = [oracle.cost(wide, [s * k * u for u in u_2], DT, effort=False) for k in (0, 1, 2)]
        slope = float((-3 * j[0] + 4 * j[1] - j[2]) / (2 * s))
        found = criterion(x, np.array(u_2[:1]), then=np.array(u_2[1 : 1 + samples_after])[:, None])
        assert found == pytest.approx(slope, rel=1e-5)


def test_along_the_user_a_kink_at_the_begin_is_left_at_once(oracle):
    """The first node has no part in the slope; the others are away from the kink, and J is smooth there."""
    x, u = np.array([math.pi, 0.0, 0.3, -0.5]), 20.0
    j = oracle.cost(x.astype(complex), first_sample(u + 1e-30j * u), DT, effort=False)
    assert criteria("user")(x, np.array([u])) == pytest.approx(j.imag / 1e-30, rel=1e-9)


def test_the_cost_of_nothing(oracle, states):
    nothing = CostOfNothing(TASK, COST, horizon=STEPS * DT, dt=DT)
    for x in states(20, 18).T:
        assert nothing(x) == pytest.approx(oracle.cost(x, first_sample(0.0), DT), rel=1e-12)
        assert nothing(x) == nothing(x, 0)


def test_mirror(states):
    """(x, u) -> (-x, -u) changes nothing, to the last bit."""
    for along in ALONG:
        criterion = criteria(along)
        for x in states(100, 15).T:
            assert criterion(x, np.array([3.0])) == criterion(-x, np.array([-3.0]))


def test_whole_turns_do_not_matter(states):
    criterion = criteria("nominal")
    for x in states(50, 16).T:
        turned = x + np.array([4.0 * math.pi, 0.0, 0.0, 0.0])
        assert criterion(turned, np.ones(1)) == pytest.approx(criterion(x, np.ones(1)), rel=1e-9, abs=1e-9)


def test_public_entry(states):
    x = states(1, 17)[:, 0]
    for along in ALONG:
        value = mig_integral(TASK, COST, list(x), [4.0], horizon=STEPS * DT, dt=DT, adjoint_along=along)
        assert value == criteria(along)(x, np.array([4.0]))
    assert mig_integral(TASK, COST, x, 4.0, horizon=STEPS * DT, dt=DT) == criteria("nominal")(x, np.array([4.0]))


finite = st.floats(-1e3, 1e3)


@settings(max_examples=150)
@given(st.tuples(finite, finite, finite, finite), finite, st.sampled_from(ALONG))
def test_finite_in_finite_out(x, u, along):
    assert math.isfinite(criteria(along)(np.array(x), np.array([u])))


def test_one_sample_is_the_shortest_horizon():
    assert samples(0.01, 0.01) == 1
    assert samples(1.5, 0.01) == 150
    for horizon, dt in ((0.0, 0.01), (math.nan, 0.01), (math.inf, 0.01), (1.0, 0.0)):
        with pytest.raises(ParameterError, match="horizon"):
            samples(horizon, dt)
    with pytest.raises(ParameterError, match="adjoint_along"):
        mig_integral(TASK, COST, np.zeros(4), 1.0, horizon=1.0, dt=0.01, adjoint_along="optimal")


@pytest.mark.parametrize("name", ["cart_pendulum", "slip"])
@pytest.mark.parametrize("along", ALONG)
def test_many_states_in_one_call_are_the_same_numbers(name, along):
    task = tasks.get(name)
    random = np.random.default_rng(11)
    states = random.normal(task.initial_state, 0.3, (40, task.n))
    controls = random.normal(0.0, 3.0, (40, task.m))
    criterion = criteria(along, cost=quadratic(task), task=task)
    apart = [criterion(x, u) for x, u in zip(states, controls, strict=True)]
    assert criterion.many(states, controls).tolist() == apart
    # One control for all, arrays of another layout, and modes that are given.
    modes = [task.mode(x) for x in states]
    assert criterion.many(np.asfortranarray(states), controls[0], modes).tolist() == [
        criterion(x, controls[0]) for x in states
    ]


def test_many_states_must_fit_the_task():
    criterion = criteria("nominal")
    with pytest.raises(ParameterError, match=r"states: \(3, 2\) is not allowed; cart_pendulum needs \(K, 4\)"):
        criterion.many(np.zeros((3, 2)), np.zeros(1))
    with pytest.raises(ParameterError, match=r"controls: \(2, 1\)"):
        criterion.many(np.zeros((3, 4)), np.zeros((2, 1)))
    assert criterion.many(np.zeros((0, 4)), np.zeros(1)).shape == (0,)
