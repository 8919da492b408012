"""SLIP once more in plain Python, with complex steps through located events: the kernels to rounding.

A complex perturbation passes through the event because its time is a number like any other: the bracket gives its real
part, one Newton step of the complex guard its perturbation.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from shared_control import controllers, tasks
from shared_control.cost import quadratic
from shared_control.integrate import Stepper
from shared_control.mig import ALONG, Criterion

TASK = tasks.get("slip")
COST = quadratic(TASK)
K, G, L0 = 100.0, 9.81, 1.0
Q_Z, Z_D, R = 50.0, 1.3, (0.01, 0.05)
DT, STEPS = 0.01, 60
TINY = 1e-30


def rates(x, u, standing):
    if not standing:
        return np.array([x[1], 0.0 * x[1], x[3], 0.0 * x[3] - G, x[1] + u[1]])
    leg = np.sqrt((x[0] - x[4]) ** 2 + x[2] ** 2)
    push = (K * (L0 - leg) + u[0]) / leg
    return np.array([x[1], push * (x[0] - x[4]), x[3], push * x[2] - G, 0.0 * x[4]])


def rk4(x, u, h, standing):
    a = rates(x, u, standing)
    b = rates(x + h / 2 * a, u, standing)
    c = rates(x + h / 2 * b, u, standing)
    d = rates(x + h * c, u, standing)
    return x + h / 6 * (a + 2 * b + 2 * c + d)


def guard(x, standing):
    """The larger of two, as in the paper's code: touchdown sinking, lift-off rising."""
    above = np.sqrt((x[0] - x[4]) ** 2 + x[2] ** 2) - L0
    one, other = (-above, -x[3]) if standing else (above, x[3])
    return one if one.real > other.real else other


def step(x, standing, u):
    """State, mode and number of events after a sample; at most one event."""
    whole = rk4(x, u, DT, standing)
    if guard(whole, standing).real > 0.0:
        return whole, standing, 0
    low, high = 0.0, DT
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if guard(rk4(x, u, middle, standing), standing).real > 0.0 else (low, middle)
    # d guard / dt, of the step as it is discretised: by a complex step of its own, from the real parts.
    real, imag = x.real + 0j, u.real + 0j
    slope = guard(rk4(real, imag, high + 1j * TINY, standing), standing).imag / TINY
    t = high - 1j * guard(rk4(x, u, high, standing), standing).imag / slope
    return rk4(rk4(x, u, t, standing), u, DT - t, not standing), not standing, 1


def trajectory(x, controls):
    """Nodes (N+1, 5), modes, the samples with an event; None where this twin does not hold (two events in a sample)."""
    x = np.asarray(x, dtype=complex)
    standing = bool(np.hypot(x[0].real - x[4].real, x[2].real) < L0)
    nodes, modes, events = [x], [standing], []
    for k, u in enumerate(controls):
        x, standing, happened = step(x, standing, np.asarray(u, dtype=complex))
        nodes.append(x)
        modes.append(standing)
        if happened:
            events.append(k)
    if min(node[2].real for node in nodes) < 0.1 or any(b - a < 3 for a, b in itertools.pairwise(events)):
        return None
    return np.array(nodes), modes, events


def state_cost(nodes):
    share = np.full(len(nodes), DT)
    share[0] = share[-1] = 0.5 * DT
    return np.sum(share * 0.5 * Q_Z * (nodes[:, 2] - Z_D) ** 2)


def cases(count, seed):
    """States and pushes whose trajectories this twin can follow, each with one event at least."""
    random, found = np.random.default_rng(seed), []
    while len(found) < count:
        x = np.array([0.0, *random.uniform((-1, 0.8, -1.5, -0.2), (1, 1.3, 1.5, 0.2))])
        u = random.normal(0.0, 1.0, 2) * (20.0, 5.0)
        lines = [trajectory(x, [s * u] + [np.zeros(2)] * (STEPS - 1)) for s in (0.0, 1.0)]
        if all(line is not None and line[2] for line in lines):
            found.append((x, u))
    return found


def test_nodes_and_modes():
    for x, u in cases(12, 1):
        nodes, modes, _ = trajectory(x, [u] + [np.zeros(2)] * (STEPS - 1))
        stepper, y, mode = Stepper(TASK, DT), x.copy(), TASK.mode(x)
        for k in range(STEPS):
            mode = stepper.advance(y, u if k == 0 else np.zeros(2), mode)
            assert mode == modes[k + 1]
            # Where a bracket stops moves an event by its last bits, and all that follows.
            np.testing.assert_allclose(y, nodes[k + 1].real, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("along", ALONG)
def test_criterion_across_events(along):
    """d/ds of the state's cost, at the null action and at the user's."""
    criterion = Criterion(TASK, COST, horizon=STEPS * DT, dt=DT, adjoint_along=along)
    centre = 0.0 if along == "nominal" else 1.0
    for x, u in cases(40, 2):
        nodes, _, _ = trajectory(x, [(centre + 1j * TINY) * u] + [np.zeros(2)] * (STEPS - 1))
        slope = state_cost(nodes).imag / TINY
        assert criterion(x, u) == pytest.approx(slope, rel=1e-9, abs=1e-9)


def test_mirrored_the_criterion_is_the_same():
    """Left and right are alike: to the last bit for both readings."""
    mirror = np.array([-1.0, -1.0, 1.0, 1.0, -1.0])
    for along in ALONG:
        criterion = Criterion(TASK, COST, horizon=STEPS * DT, dt=DT, adjoint_along=along)
        for x, u in cases(10, 5):
            assert criterion(mirror * x, np.array([u[0], -u[1]])) == criterion(x, u)


def test_without_the_saltation_the_criterion_is_another():
    """The slope with each event held at its time, which is what an adjoint without the jump would give."""
    criterion, off = Criterion(TASK, COST, horizon=STEPS * DT, dt=DT), []
    for x, u in cases(25, 3):
        real, _, events = trajectory(x, [np.zeros(2)] * STEPS)
        line, standing = np.asarray(x, dtype=complex), bool(np.hypot(x[0] - x[4], x[2]) < L0)
        nodes = [line]
        for k in range(STEPS):
            push = (1j * TINY) * u if k == 0 else np.zeros(2, complex)
            if k in events:
                low, high = 0.0, DT
                for _ in range(80):
                    middle = 0.5 * (low + high)
                    above = guard(rk4(real[k].real + 0j, 0j * u, middle, standing), standing).real > 0.0
                    low, high = (middle, high) if above else (low, middle)
                line = rk4(rk4(line, push, high, standing), push, DT - high, not standing)
                standing = not standing
            else:
                line = rk4(line, push, DT, standing)
            nodes.append(line)
        held = state_cost(np.array(nodes)).imag / TINY
        off.append(abs(held - criterion(x, u)) > 0.01 * abs(criterion(x, u)))
    assert np.mean(off) > 0.5


@pytest.mark.parametrize(("gamma", "limits"), [(-0.5, (20.0, 5.0)), (-5.0, (2.0, 0.3))])
def test_sac_is_the_papers_schedule(gamma, limits):
    """(Lambda + R)^-1 (Lambda u_1 + h^T rho alpha_d) with two inputs, solved as it stands, saturated, from u_1 = 0."""
    compared = 0
    for x, _ in cases(3, 4):
        null = [np.zeros(2)] * STEPS
        nodes, *_ = trajectory(x, null)
        descent = gamma * state_cost(nodes.real)
        wanted = np.zeros((STEPS, 2))
        for k in range(STEPS):
            h_rho = np.zeros(2)
            for j in range(2):
                bumped = [u.astype(complex) for u in null]
                bumped[k][j] = 1j * TINY
                h_rho[j] = state_cost(trajectory(x, bumped)[0]).imag / TINY / DT
            lambda_ = np.outer(h_rho, h_rho)
            wanted[k] = np.clip(np.linalg.solve(lambda_ + np.diag(R), h_rho * descent), -np.array(limits), limits)
        controller = controllers.make(
            "sac", TASK, COST, horizon=STEPS * DT, iterations=1, tries=1, gamma=gamma, limits=limits
        )
        if not np.any(controller.solve(x).control):
            continue  # the full step gains nothing here
        np.testing.assert_allclose(controller.schedule, wanted, rtol=1e-7, atol=1e-9)
        compared += 1
    assert compared >= 1


def test_sac_keeps_the_mass_up():
    """From the trial's start, with nobody pushing, where doing nothing falls."""
    heights = []
    for controller in (None, controllers.make("sac", TASK, COST, horizon=0.9, iterations=8)):
        stepper, x, mode = Stepper(TASK, DT), TASK.initial_state, 0
        for _ in range(600):
            u = np.zeros(2)
            if controller is not None:
                controller.advance()
                u = controller.solve(x, mode).control
            mode = stepper.advance(x, u, mode)
        heights.append(x[2])
    assert heights[0] <= 0.0
    assert heights[1] > 0.4


def test_ilqr_is_stationary_across_events():
    """No control of the schedule that it ends at, within the limits, lowers J to first order: by complex steps through
    the events of the plan itself. As large as it may be: the slope of the effort at a ten-thousandth of the limits.
    """
    compared, steps, limits, r = 0, 30, np.array([20.0, 5.0]), np.array(R)
    for x, _ in cases(12, 6):
        controller = controllers.make(
            "ilqr", TASK, COST, horizon=steps * DT, iterations=300, tolerance=1e-13, limits=tuple(limits)
        )
        solution, plan = controller.solve(x), controller.schedule
        line = trajectory(x, plan)
        if line is None or not line[2]:
            continue  # a plan without an event, or with two in a sample
        legs = np.hypot(line[0][:, 0].real - line[0][:, 4].real, line[0][:, 2].real)
        if np.any(np.abs(legs - L0) < 1e-6):
            continue  # an event between two samples, where a control begins to count and J has a corner
        assert solution.converged
        assert solution.cost == pytest.approx(state_cost(line[0].real) + 0.5 * DT * np.sum(r * plan**2), rel=1e-7)
        slope = DT * r * plan
        for k, j in np.ndindex(steps, 2):
            bumped = plan.astype(complex)
            bumped[k, j] += 1j * TINY
            slope[k, j] += state_cost(trajectory(x, bumped)[0]).imag / TINY
        pinned = (np.abs(plan) >= limits) & (slope * plan < 0.0)
        assert np.all(pinned | (np.abs(slope) < 1e-4 * DT * r * limits))
        compared += 1
    assert compared >= 3
