"""The flow against scipy's DOP853, the step's order and energy, its Jacobians against complex steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from shared_control import tasks
from shared_control.integrate import Stepper

TASK = tasks.get("cart_pendulum")


def advance(task, dt, x, controls):
    stepper, x = Stepper(task, dt), np.array(x, dtype=float)
    for u in controls:
        stepper.advance(x, np.array([u]))
    return x


@pytest.mark.parametrize("x", [(3.1, 0.0, 0.0, 0.0), (0.3, -1.0, 0.5, 2.0), (-2.0, 5.0, -1.0, 0.0)])
def test_flow_against_dop853(oracle, x):
    controls = [5.0 * math.sin(0.3 * k) for k in range(50)]
    exact = np.array(x)
    for u in controls:
        exact = solve_ivp(
            lambda _, y, u=u: oracle.flow(y, u), (0.0, 0.01), exact, method="DOP853", rtol=1e-13, atol=1e-13
        ).y[:, -1]
    np.testing.assert_allclose(advance(TASK, 0.01, x, controls), exact, rtol=0.0, atol=2e-7)


def test_order_is_four(oracle):
    x = np.array([2.0, 1.0, 0.0, 0.0])
    exact = solve_ivp(lambda _, y: oracle.flow(y, 3.0), (0.0, 1.0), x, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    coarse, fine = (np.abs(advance(TASK, 1.0 / n, x, [3.0] * n) - exact).max() for n in (20, 40))
    assert 13.0 < coarse / fine < 20.0


def test_energy_without_damping():
    task = tasks.get("cart_pendulum", damping=0.0)
    p = task.parameters

    def energy(x):
        return 0.5 * p.mass * p.length**2 * x[1] ** 2 + p.mass * p.gravity * p.length * math.cos(x[0])

    x = np.array([2.5, 1.0, 0.0, 0.0])
    assert energy(advance(task, 0.01, x, [0.0] * 1000)) == pytest.approx(energy(x), abs=1e-6)


def test_cart_is_exact():
    x = advance(TASK, 0.01, (3.0, 0.0, 1.0, 2.0), [4.0] * 100)
    assert x[2:] == pytest.approx([1.0 + 2.0 + 2.0, 6.0], abs=1e-12)


def test_jacobians_against_complex_steps(oracle, states):
    stepper = Stepper(TASK, 0.01)
    for x in states(50, 1).T:
        u = float(4.0 * x[0])
        a, b = stepper.jacobians(x, np.array([u]))
        for j in range(4):
            bumped = x.astype(complex)
            bumped[j] += 1e-30j
            np.testing.assert_allclose(a[:, j], oracle.step(bumped, u, 0.01).imag / 1e-30, rtol=0, atol=1e-14)
        slope = oracle.step(x.astype(complex), u + 1e-30j, 0.01).imag / 1e-30
        np.testing.assert_allclose(b[:, 0], slope, rtol=0, atol=1e-15)


def test_task_functions_without_compiler():
    """The task's own functions are plain Python, and the partial derivatives belong to the flow."""
    from shared_control.tasks.cart_pendulum import flow, linearise, pullback

    p, x, u = TASK.parameters, (0.7, -1.2, 0.3, 0.4), (2.5,)
    value, d = linearise(p, x, u)
    assert value == flow(p, x, u)
    for i in range(4):
        row, column = pullback(p, d, tuple(float(i == j) for j in range(4)))
        for j in range(4):
            up, down = (tuple(x[k] + s * (k == j) for k in range(4)) for s in (1e-6, -1e-6))
            assert row[j] == pytest.approx((flow(p, up, u)[i] - flow(p, down, u)[i]) / 2e-6, abs=1e-8)
        slope = (flow(p, x, (u[0] + 1e-6,))[i] - flow(p, x, (u[0] - 1e-6,))[i]) / 2e-6
        assert column[0] == pytest.approx(slope, abs=1e-8)


def test_sign_convention():
    """A cart that accelerates to positive x leaves an upright pendulum behind: theta turns negative."""
    assert advance(TASK, 0.01, (0.0, 0.0, 0.0, 0.0), [10.0])[0] < 0.0
