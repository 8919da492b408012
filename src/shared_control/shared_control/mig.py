"""The mode insertion gradient (MIG), integrated over the horizon: the criterion.

    dJ/dlambda(t) = rho(t)^T [ f(x, u_2) - f(x, u_1) ],     criterion = int_0^T dJ/dlambda dt

with u_1 = 0 and u_2 the user's control for t <= t_s and u_1 after, so that the integrand has support on the first
only. On the samples of the loop x follows RK4 and rho is the exact adjoint of the RK4 steps and of the cost's
quadrature (:mod:`shared_control.cost`), so that

    criterion = rho_1^T dPhi/du(x_0, s u_user) u_user  =  d/ds J_x(x_0; s u_user on the first sample)

at s = 0 along the nominal trajectory (``adjoint_along="nominal"``, the paper's text) and at s = 1 along the user's
(``"user"``, the paper's Algorithm 1, line 3, and the laboratory's code). J_x is the state's part of J, with the factor
1/2: as in the paper's adjoint, which holds no control cost. (At s = 0 that of the control has no slope, so there J_x
and J agree.) Along the nominal trajectory the criterion is linear in the user's control: a half-space test, for one
input a sign test.

Where the wrapped error of an angle is +-pi at a node, J has a kink there (hanging exactly at rest every node is one).
The slope is then taken one-sided, in the direction of the user's push: with d theta_k the first-order motion of that
node under the push, the node contributes -q pi |d theta_k|, whichever way the push goes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from shared_control.cost import QuadraticCost, errors
from shared_control.dispatch import jit, running_gradient, terminal_gradient
from shared_control.integrate import step_linearised, step_pullback, store_size, stride
from shared_control.parameters import ParameterError
from shared_control.tasks.task import Array, Task
from shared_control.tuples import Vector, axpy, take, times, unit, zeros

__all__ = ["ALONG", "Criterion", "mig_integral", "samples"]

#: The two readings of the criterion.
ALONG = ("nominal", "user")

#: How near to +-pi an error counts as on the kink [rad]: above rounding, below any motion that matters.
KINK = 1e-9


@jit
def _forward(p: Any, c: Any, mode: int, x0: Vector, first: Vector, h: float, steps: int, xs: Array, ds: Array) -> bool:
    """Trajectory under ``first`` for one sample and zero after, into ``xs``, ``ds``; whether a node lies on a kink."""
    x = x0
    u = first
    size = stride(p, x)
    kink = False
    for k in range(steps + 1):
        e = errors(x, c.target, c.angles)
        for i in range(len(x)):
            xs[k, i] = x[i]
            kink = kink or (c.angles[i] and abs(e[i]) >= math.pi - KINK)
        if k < steps:
            x, mode = step_linearised(p, mode, x, u, h, ds, k * size)
            u = zeros(first)
    return kink


@jit
def _slope(
    p: Any, c: Any, mode: int, x: Array, u: Array, along_user: bool, h: float, steps: int, xs: Array, ds: Array
) -> float:
    """The criterion."""
    x0 = take(c.target, x, 0)
    user = take(c.control_weights, u, 0)
    first = user if along_user else zeros(user)
    kink = _forward(p, c, mode, x0, first, h, steps, xs, ds)
    if kink:
        return _one_sided(p, c, x0, first, user, h, steps, xs, ds)
    size = stride(p, x0)
    none = zeros(user)
    x_end = take(x0, xs[steps], 0)
    rho = axpy(0.5 * h, running_gradient(c, x_end), terminal_gradient(c, x_end))
    for k in range(steps - 1, 0, -1):
        rho, _ = step_pullback(p, ds, k * size, none, rho, h)
        rho = axpy(h, running_gradient(c, take(x0, xs[k], 0)), rho)
    _, rho_u = step_pullback(p, ds, 0, first, rho, h)
    total = 0.0
    for i in range(len(user)):
        total += rho_u[i] * user[i]
    return total


@jit
def _one_sided(
    p: Any, c: Any, x0: Vector, first: Vector, user: Vector, h: float, steps: int, xs: Array, ds: Array
) -> float:
    """The criterion by first-order motion of the nodes, with the slope at a kink taken on the side of the motion.

    Rare (an exact rest), hence written for clarity: each row of each step's Jacobian by one pullback.
    """
    n, size = len(x0), stride(p, x0)
    u = first
    motion = np.zeros(n)
    moved = np.zeros(n)
    total = 0.0
    for k in range(steps):
        for i in range(n):
            row, column = step_pullback(p, ds, k * size, u, unit(x0, i), h)
            moved[i] = 0.0
            for j in range(n):
                moved[i] += row[j] * motion[j]
            if k == 0:
                for j in range(len(user)):
                    moved[i] += column[j] * user[j]
        u = zeros(first)
        for i in range(n):
            motion[i] = moved[i]
        node = take(x0, xs[k + 1], 0)
        e = errors(node, c.target, c.angles)
        share = h if k + 1 < steps else 0.5 * h
        weights = axpy(share, c.state_weights, c.terminal_weights if k + 1 == steps else zeros(x0))
        gradient = times(weights, e)
        for i in range(n):
            if c.angles[i] and abs(e[i]) >= math.pi - KINK:
                total -= weights[i] * math.pi * abs(motion[i])
            else:
                total += gradient[i] * motion[i]
    return total


def samples(horizon: float, dt: float) -> int:
    """Number of samples in a horizon, rounded to the nearest.

    Raises
    ------
    ParameterError: not at least one sample, or not finite.
    """
    if not (dt > 0.0 and math.isfinite(dt) and math.isfinite(horizon) and horizon >= 0.5 * dt):
        raise ParameterError(f"horizon: {horizon!r} is not allowed; it must be at least one sample of {dt!r} s")
    return max(1, round(horizon / dt))


class Criterion:
    """The criterion for one task, objective and horizon, with all memory allocated beforehand."""

    def __init__(
        self, task: Task, cost: QuadraticCost, *, horizon: float, dt: float, adjoint_along: str = "nominal"
    ) -> None:
        if adjoint_along not in ALONG:
            raise ParameterError(
                f"adjoint_along: {adjoint_along!r} is not allowed; it must be one of {', '.join(ALONG)}"
            )
        self._task, self._p, self._c = task, task.parameters, cost
        self._along_user = adjoint_along == "user"
        self._h = float(dt)
        self._steps = samples(horizon, dt)
        self._x, self._u = np.zeros(task.n), np.zeros(task.m)
        self._xs = np.zeros((self._steps + 1, task.n))
        self._ds = np.zeros(store_size(task, self._steps))

    def __call__(self, x: Array, u_user: Array, task_mode: int | None = None) -> float:
        """Criterion [unit of the cost] of a user's control (m,) at a state (n,); not finite if the numbers overflow.

        ``task_mode`` of a hybrid task; None: that of the state alone (:meth:`Task.mode`).
        """
        # Copies: the kernel is compiled for its own contiguous arrays, whatever kind the caller has.
        self._x[:] = x
        self._u[:] = u_user
        mode = self._task.mode(self._x) if task_mode is None else task_mode
        return _slope(
            self._p, self._c, mode, self._x, self._u, self._along_user, self._h, self._steps, self._xs, self._ds
        )


def mig_integral(
    task: Task,
    cost: QuadraticCost,
    x: Sequence[float] | Array,
    u_user: Sequence[float] | Array,
    *,
    horizon: float,
    dt: float,
    adjoint_along: str = "nominal",
    task_mode: int | None = None,
) -> float:
    """int dJ/dlambda dt over the horizon, for one sample ``dt`` of the user's control: see the module's equations.

    Parameters
    ----------
    x: state (n,).
    u_user: control (m,), applied over the first sample.
    horizon: T [s].
    dt: sampling time t_s [s], also the integrator's step.
    adjoint_along: "nominal" or "user".
    task_mode: mode of a hybrid task; None: that of the state alone (:meth:`Task.mode`).
    """
    criterion = Criterion(task, cost, horizon=horizon, dt=dt, adjoint_along=adjoint_along)
    return criterion(np.asarray(x, dtype=float), np.atleast_1d(np.asarray(u_user, dtype=float)), task_mode)
