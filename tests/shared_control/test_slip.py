"""SLIP: flow, events and their derivatives against an oracle of its own; energy, symmetries, falling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from shared_control import controllers, hybrid, rk4, tasks
from shared_control.cost import quadratic
from shared_control.integrate import Stepper
from shared_control.mig import ALONG, Criterion
from shared_control.parameters import ParameterError
from shared_control.tasks.slip import in_mode

TASK = tasks.get("slip")
COST = quadratic(TASK)
K, G = 100.0, 9.81
DT = 0.01


def leg(x):
    return math.hypot(x[0] - x[4], x[2])


def guard(x, standing):
    """Positive while the mode holds: touchdown sinking and no longer than at rest, lift-off rising and no shorter."""
    above = leg(x) - 1.0
    return max(-above, -x[3]) if standing else max(above, x[3])


def rates(x, u, standing):
    if not standing:
        return np.array([x[1], 0.0, x[3], -G, x[1] + u[1]])
    force = (K * (1.0 - leg(x)) + u[0]) / leg(x)
    return np.array([x[1], force * (x[0] - x[4]), x[3], force * x[2] - G, 0.0])


def exact(x, u, duration, switch_at=None):
    """(state, times of events) by DOP853; events located, or the mode switched at a given time."""
    x, t, standing, events = np.array(x, dtype=float), 0.0, leg(x) < 1.0, []
    while duration - t > 1e-13:

        def crossing(_, y, standing=standing):
            return guard(y, standing)

        crossing.terminal, crossing.direction = switch_at is None, -1.0
        until = duration if switch_at is None or events else switch_at
        span = solve_ivp(
            lambda _, y, standing=standing: rates(y, u, standing), (t, until), x, method="DOP853",
            rtol=3e-14, atol=1e-14, events=crossing,
        )  # fmt: skip
        x, t = span.y[:, -1], span.t[-1]
        if duration - t > 1e-13:
            standing = not standing
            events.append(t)
    return x, events


def advance(x, u, steps, dt=DT, task=TASK, mode=None):
    """Nodes and modes of a trajectory under a control that is held."""
    stepper, x = Stepper(task, dt), np.array(x, dtype=float)
    nodes, modes = [x.copy()], [task.mode(x) if mode is None else mode]
    for _ in range(steps):
        modes.append(stepper.advance(x, np.array(u, dtype=float), modes[-1]))
        nodes.append(x.copy())
    return np.array(nodes), modes


TOUCHDOWN = (0.1, 0.7, 0.995, -1.2, 0.23), (3.0, -0.8)
LIFT_OFF = (0.1, 0.9, 0.985, 1.6, 0.03), (3.0, -0.8)


@pytest.mark.parametrize(("x", "u"), [TOUCHDOWN, LIFT_OFF, ((0.0, 0.3, 1.2, 0.0, -0.02), (5.0, 0.1))])
def test_flow_and_events_against_dop853(x, u):
    """A touchdown; a lift-off; a fall, a bounce and the flight after it."""
    steps = 70 if x[2] > 1.1 else 4
    end, events = exact(x, u, steps * DT)
    assert len(events) == (2 if steps > 4 else 1)
    np.testing.assert_allclose(advance(x, u, steps)[0][-1], end, rtol=0.0, atol=5e-6)
    np.testing.assert_allclose(advance(x, u, 4 * steps, DT / 4)[0][-1], end, rtol=0.0, atol=5e-8)


def test_a_hop_shorter_than_a_sample():
    """It leaves the ground at rest length and is back on it before the sample ends; the event is known in closed form.

    While it stands again the leg gives way: without that it would have sunk by what free flight gives.
    """
    rise = 0.04
    hop = np.array([0.0, 0.0, 1.0, rise, 0.0])
    nodes, modes = advance(hop, (0.0, 0.0), 1, mode=0)
    landed = 2.0 * rise / G
    assert landed < DT
    assert modes == [0, 1]
    rest = DT - landed
    # Of the oscillation k/m = 100 about its balance, from the leg's length at rest with -rise on.
    omega, sag = math.sqrt(K), G / K
    z = 1.0 - sag + sag * math.cos(omega * rest) - rise / omega * math.sin(omega * rest)
    v = -sag * omega * math.sin(omega * rest) - rise * math.cos(omega * rest)
    np.testing.assert_allclose(nodes[-1], [0.0, 0.0, z, v, 0.0], rtol=0.0, atol=1e-9)
    assert advance([0.0, 0.0, 1.0, 0.06, 0.0], (0.0, 0.0), 1, mode=0)[1] == [0, 0], "a longer hop is still in flight"


def differences(function, x, u, width):
    """Five-point differences with respect to each state and each control."""
    whole = np.concatenate([x, u])
    columns = []
    for i in range(7):
        ends = {}
        for s in (-2, -1, 1, 2):
            bumped = whole.copy()
            bumped[i] += s * width
            ends[s] = function(bumped[:5], bumped[5:])
        columns.append((8 * (ends[1] - ends[-1]) - (ends[2] - ends[-2])) / (12 * width))
    return np.array(columns).T


@pytest.mark.parametrize(("x", "u"), [TOUCHDOWN, LIFT_OFF])
def test_jacobians_across_an_event(x, u):
    """Against differences of the exact flow with located events, and far from those with the event's time held."""
    _, (event,) = exact(x, u, DT)
    found = np.hstack(Stepper(TASK, DT).jacobians(np.array(x), np.array(u)))
    slope = differences(lambda x, u: exact(x, u, DT)[0], x, u, 1e-4)
    # What is left is the error of RK4 at 10 ms.
    np.testing.assert_allclose(found, slope, rtol=0.0, atol=2e-5)
    # What the derivative would be without the saltation matrix.
    held = differences(lambda x, u: exact(x, u, DT, switch_at=event)[0], x, u, 1e-4)
    assert np.abs(found - held).max() > 0.01


class Plain:
    """The discrete task once more, in plain Python: RK4 and bisection."""

    @staticmethod
    def rk4(x, u, h, standing):
        a = rates(x, u, standing)
        b = rates(x + h / 2 * a, u, standing)
        c = rates(x + h / 2 * b, u, standing)
        d = rates(x + h * c, u, standing)
        return x + h / 6 * (a + 2 * b + 2 * c + d)

    def step(self, x, standing, u, h):
        """State and mode after a step, and the number of events in it."""
        whole = self.rk4(x, u, h, standing)
        if guard(whole, standing) > 0.0:
            return whole, standing, 0
        low, high = 0.0, h
        while high - low > 1e-16 and low < 0.5 * (low + high) < high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if guard(self.rk4(x, u, middle, standing), standing) > 0.0 else (low, middle)
        return self.rk4(self.rk4(x, u, high, standing), u, h - high, not standing), not standing, 1

    def cost(self, x, first, steps):
        """State's part of J, the number of events, and whether the trajectory is one that can be differenced."""
        total, events, regular, last, standing = 0.0, 0, True, -10, leg(x) < 1.0
        for k in range(steps + 1):
            share = 0.5 if k in (0, steps) else 1.0
            total += share * DT * 0.5 * 50.0 * (x[2] - 1.3) ** 2
            if k < steps:
                x, standing, happened = self.step(x, standing, first if k == 0 else np.zeros(2), DT)
                events += happened
                if happened:
                    # Plain locates one event in a sample.
                    regular = regular and k - last > 2
                    last = k
        return total, events, regular and x[2] > 0.05


@pytest.mark.parametrize("along", ALONG)
def test_criterion_against_differences_across_events(along):
    plain, rng, steps = Plain(), np.random.default_rng(5), 60
    criterion = Criterion(TASK, COST, horizon=steps * DT, dt=DT, adjoint_along=along)
    compared = 0
    for _ in range(60):
        x = np.array([0.0, rng.uniform(-1, 1), rng.uniform(0.8, 1.3), rng.uniform(-1.5, 1.5), rng.uniform(-0.2, 0.2)])
        u = rng.normal(0.0, 1.0, 2) * (20.0, 5.0)
        centre, width = (0.0 if along == "nominal" else 1.0), 1e-4
        values = {s: plain.cost(x, (centre + s * width) * u, steps) for s in (-2, -1, 0, 1, 2)}
        events = {value[1] for value in values.values()}
        if events == {0} or len(events) > 1 or not all(value[2] for value in values.values()):
            continue
        slope = (8 * (values[1][0] - values[-1][0]) - (values[2][0] - values[-2][0])) / (12 * width)
        scale = max(abs(slope), 1e-3)
        assert criterion(x, u) == pytest.approx(slope, abs=1e-5 * scale)
        compared += 1
    assert compared >= 20


def test_energy():
    """Kept to rounding in flight, to the order of RK4 in stance."""

    def energy(x):
        spring = 0.5 * K * max(1.0 - leg(x), 0.0) ** 2
        return 0.5 * (x[1] ** 2 + x[3] ** 2) + G * x[2] + spring

    flight, _ = advance((0.0, 0.5, 3.0, 2.0, 0.0), (0.0, 0.0), 50)
    assert [energy(x) for x in flight] == pytest.approx(50 * [energy(flight[0])] + [energy(flight[0])], rel=1e-14)
    drift = []
    for parts in (1, 2):
        bounce, modes = advance((0.0, 0.3, 1.2, 0.0, -0.02), (0.0, 0.0), 70 * parts, DT / parts)
        assert set(modes) == {0, 1}
        drift.append(max(abs(energy(x) - energy(bounce[0])) for x in bounce))
    assert drift[0] < 1e-5
    assert 8.0 < drift[0] / drift[1] < 40.0


def test_one_switch_in_a_bounce():
    """Down, up, and nothing between: no chattering, no missed event."""
    _, modes = advance((0.0, 0.3, 1.2, 0.0, -0.02), (0.0, 0.0), 70)
    assert np.count_nonzero(np.diff(modes)) == 2


FLIGHT, STANCE = 0, 1


def test_a_foot_that_swings_under_a_rising_mass_does_not_touch():
    """The leg becomes shorter than at rest, and touches at the apex, where the mass begins to sink."""
    nodes, modes = advance((0.0, 0.0, 0.95, 0.5, -0.4), (0.0, 5.0), 8)
    assert leg(nodes[0]) > 1.0 > leg(nodes[4])
    rising = nodes[:, 3] > 0.0
    assert [mode == FLIGHT for mode in modes] == list(rising)
    # In free fall until then, and carried by the spring after.
    np.testing.assert_allclose(nodes[rising, 3], 0.5 - G * DT * np.arange(rising.sum()), atol=1e-12)
    assert nodes[-1, 3] > 0.5 - G * DT * 8


def test_a_foot_that_a_sinking_mass_leaves_behind_stays():
    """The leg becomes longer than at rest, and lifts off once the mass rises."""
    nodes, modes = advance((0.4, 2.5, 0.9, -0.1, 0.0), (0.0, 0.0), 3)
    assert leg(nodes[0]) < 1.0 < leg(nodes[-1])
    assert np.all(nodes[:, 3] < 0.0)
    assert set(modes) == {STANCE}
    assert np.all(nodes[:, 4] == 0.0)
    assert advance((0.4, 2.0, 0.95, 0.3, 0.0), (0.0, 0.0), 1, mode=STANCE)[1] == [STANCE, FLIGHT]


def test_the_mode_is_part_of_what_is_judged():
    """Under a rising mass a short leg pushes, or swings: the criterion and the controller's answer depend on which."""
    x, u = np.array([0.0, 0.5, 0.9, 1.0, 0.05]), np.array([5.0, 1.0])
    criterion = Criterion(TASK, COST, horizon=0.6, dt=DT)
    assert criterion(x, u) == criterion(x, u, STANCE)
    assert criterion(x, u) != criterion(x, u, FLIGHT)
    solve = controllers.make("ilqr", TASK, COST, horizon=0.6).solve
    assert not np.array_equal(solve(x, STANCE).control, solve(x, FLIGHT).control)


def test_short_contact_is_not_missed():
    """Contact that begins and ends within one sample changes the state, as the exact flow says."""
    x, u = (0.0, 0.0, 1.0 + 2e-5, -0.04, 0.0), (20.0, 0.0)
    end, events = exact(x, u, DT)
    assert len(events) == 2
    np.testing.assert_allclose(advance(x, u, 1)[0][-1], end, rtol=0.0, atol=5e-7)
    assert abs(end[3] - (x[3] - G * DT)) > 1e-3


@pytest.mark.parametrize(
    ("along", "swing", "z", "rate", "touches"),
    [
        (-0.05, 10.0, 0.99999, -1e-3, True),  # the foot swings through under the mass: long, short, long within a step
        (-0.05, 10.0, 1.01, -1e-3, False),  # it swings through and stays long enough
        (0.3, 1.0, math.sqrt(1.0 - 0.3**2), -0.3, True),  # from touching it grows longer first
        (0.0, 0.0, 1.0, -1.0, False),  # touches at the begin, and that is no event on the way
    ],
)
def test_touchdown_is_found_where_the_polynomial_is_zero(along, swing, z, rate, touches):
    """In flight (along + swing t)^2 + (z + rate t - g t^2 / 2)^2 - l_0^2 is zero at touchdown, and RK4 is exact."""
    q, x, u = in_mode(TASK.parameters, FLIGHT), (along, 0.0, z, rate, 0.0), (0.0, -swing)
    found = hybrid._event(q, x, u, DT, rk4.step(q, x, u, DT))
    if not touches:
        assert found == -1.0
        return
    leg = np.polynomial.Polynomial([along, swing]) ** 2 + np.polynomial.Polynomial([z, rate, -0.5 * G]) ** 2 - 1.0
    roots = leg.roots()
    real = sorted(root.real for root in roots if abs(root.imag) < 1e-12 and 1e-6 < root.real < DT)
    assert found == pytest.approx(real[0], rel=1e-9)


def test_mirror_and_shift():
    x, u = np.array(TOUCHDOWN[0]), np.array(TOUCHDOWN[1])
    straight, _ = advance(x, u, 60)
    sign = np.array([-1.0, -1.0, 1.0, 1.0, -1.0])
    assert np.array_equal(advance(sign * x, (u[0], -u[1]), 60)[0], sign * straight)
    shift = np.array([5.0, 0.0, 0.0, 0.0, 5.0])
    np.testing.assert_allclose(advance(x + shift, u, 60)[0], straight + shift, atol=1e-9)


def test_the_papers_literal_values_fall():
    """k = 1 N/m cannot carry 1 kg."""
    task = tasks.get("slip", stiffness=1.0)
    for speed in (0.0, 0.8):
        nodes, modes = advance((0.0, speed, 1.2, 0.0, 0.0), (0.0, 0.0), 100, task=task)
        assert task.failure(nodes[-1])
        assert modes[-1] == task.mode(nodes[-1]) == 2
        assert np.array_equal(nodes[-1], nodes[-2])


anything = st.floats(-50.0, 50.0)


@settings(max_examples=100)
@given(st.tuples(anything, anything, st.floats(-1.0, 5.0), anything, anything), st.tuples(anything, anything))
def test_never_a_number_that_is_not_finite(x, u):
    assert np.all(np.isfinite(advance(x, u, 30)[0]))
    criterion = Criterion(TASK, COST, horizon=0.3, dt=DT, adjoint_along="user")
    assert math.isfinite(criterion(np.array(x), np.array(u)))
    solution = controllers.make("ilqr", TASK, COST, horizon=0.3).solve(np.array(x))
    assert np.all(np.abs(solution.control) <= TASK.control_limits)


def test_maps():
    robot = tasks.Robot(0.01, 40.0)
    u = np.array([7.0, -3.0])
    force = TASK.wrench_from_control(u, robot)
    assert np.array_equal(TASK.control_from_wrench(force, robot), u)
    from shared_control.admittance import Admittance

    motion = Admittance(robot=robot).step(force)
    assert TASK.control_from_motion(motion, robot, force) == pytest.approx(u, rel=1e-15)
    with pytest.raises(ParameterError, match="robot_damping"):
        TASK.check_robot(tasks.Robot())
