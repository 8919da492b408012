"""The mode insertion gradient (MIG), integrated over the horizon: the criterion.

    dJ/dlambda(t) = rho(t)^T [ f(x, u_2) - f(x, u_1) ],     criterion = int_0^T dJ/dlambda dt

with u_1 = 0 and u_2 the user's control for t <= t_s and u_1 after, so that the integrand has support on the first
only; or, as the paper proposes for future work, after t_s what a controller would do (``then``: u_2,1, u_2,2, ...).
On the samples of the loop x follows RK4 and rho is the exact adjoint of the RK4 steps and of the cost's quadrature
(:mod:`shared_control.cost`), so that

    criterion = sum_k rho_k+1^T dPhi/du(x_k, s u_2,k) u_2,k  =  d/ds J_x(x_0; s u_2),    u_2,0 = u_user

at s = 0 along the nominal trajectory (``adjoint_along="nominal"``, the paper's text) and at s = 1 along the user's
(``"user"``, the paper's Algorithm 1, line 3, and the laboratory's code). J_x is the state's part of J, with the factor
1/2: as in the paper's adjoint, which holds no control cost. (At s = 0 that of the control has no slope, so there J_x
and J agree.) Along the nominal trajectory the criterion is linear in u_2: for the user's control a half-space test,
for one input a sign test.

Where the wrapped error of an angle is +-pi at a node, J has a kink there (hanging exactly at rest every node is one).
The slope is then taken one-sided, in the direction of the user's push: with d theta_k the first-order motion of that
node under u_2, the node contributes -q pi |d theta_k|, whichever way the push goes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from shared_control.controllers.rollout_kernels import rollout
from shared_control.cost import QuadraticCost, errors
from shared_control.dispatch import bound, jit, jit_inlined, running_gradient, terminal_gradient
from shared_control.integrate import step_linearised, step_pullback, store_size, stride
from shared_control.parameters import ParameterError
from shared_control.tasks.task import Array, Task
from shared_control.tuples import Vector, axpy, take, times, unit, zeros

__all__ = ["ALONG", "CostOfNothing", "Criterion", "mig_integral", "samples"]

#: The two readings of the criterion.
ALONG = ("nominal", "user")

#: How near to +-pi an error counts as on the kink [rad]: above rounding, below any motion that matters.
KINK = 1e-9


@jit_inlined
def _forward(
    p: Any, c: Any, mode: int, x0: Vector, us: Array, length: int, h: float, steps: int, xs: Array, ds: Array
) -> bool:
    """Trajectory under the first ``length`` controls of ``us`` and zero after, into ``xs``, ``ds``; whether a node lies
    on a kink.
    """
    like_u = c.control_weights
    x = x0
    size = stride(p, x)
    kink = False
    for k in range(steps + 1):
        e = errors(x, c.target, c.angles)
        for i in range(len(x)):
            xs[k, i] = x[i]
            kink = kink or (c.angles[i] and abs(e[i]) >= math.pi - KINK)
        if k < steps:
            u = take(like_u, us[k], 0) if k < length else zeros(like_u)
            x, mode = step_linearised(p, mode, x, u, h, ds, k * size)
    return kink


@jit
def _slope(
    p: Any, c: Any, mode: int, x: Array, us: Array, length: int, along_user: bool, h: float, xs: Array, ds: Array
) -> float:
    """The criterion of u_2, the first ``length`` rows of ``us`` (N, m) and zero after."""
    steps = us.shape[0]
    x0 = take(c.target, x, 0)
    like_u = c.control_weights
    applied = length if along_user else 0
    if _forward(p, c, mode, x0, us, applied, h, steps, xs, ds):
        return _one_sided(p, c, x0, us, length, applied, h, xs, ds)
    size = stride(p, x0)
    none = zeros(like_u)
    x_end = take(x0, xs[steps], 0)
    rho = axpy(0.5 * h, running_gradient(c, x_end), terminal_gradient(c, x_end))
    # Where u_2 is zero the adjoint goes on alone: two loops, because the second costs more.
    for k in range(steps - 1, length - 1, -1):
        rho, _ = step_pullback(p, ds, k * size, none, rho, h)
        rho = axpy(h, running_gradient(c, take(x0, xs[k], 0)), rho)
    total = 0.0
    for k in range(length - 1, -1, -1):
        u = take(like_u, us[k], 0)
        rho, slope = step_pullback(p, ds, k * size, u if along_user else none, rho, h)
        for i in range(len(u)):
            total += slope[i] * u[i]
        rho = axpy(h, running_gradient(c, take(x0, xs[k], 0)), rho)
    return total


@jit
def _slopes(
    p: Any,
    c: Any,
    modes: Array,
    states: Array,
    controls: Array,
    us: Array,
    along_user: bool,
    h: float,
    xs: Array,
    ds: Array,
    values: Array,
) -> None:
    """The criterion of each row, into ``values``."""
    for k in range(len(values)):
        for j in range(us.shape[1]):
            us[0, j] = controls[k, j]
        values[k] = _slope(p, c, modes[k], states[k], us, 1, along_user, h, xs, ds)


@jit
def _one_sided(
    p: Any, c: Any, x0: Vector, us: Array, length: int, applied: int, h: float, xs: Array, ds: Array
) -> float:
    """The criterion by first-order motion of the nodes, with the slope at a kink taken on the side of the motion.

    Rare (an exact rest), hence written for clarity: each row of each step's Jacobian by one pullback.
    """
    n, size, steps = len(x0), stride(p, x0), us.shape[0]
    like_u = c.control_weights
    motion = np.zeros(n)
    moved = np.zeros(n)
    total = 0.0
    for k in range(steps):
        u = take(like_u, us[k], 0) if k < applied else zeros(like_u)
        for i in range(n):
            row, column = step_pullback(p, ds, k * size, u, unit(x0, i), h)
            moved[i] = 0.0
            for j in range(n):
                moved[i] += row[j] * motion[j]
            if k < length:
                for j in range(len(u)):
                    moved[i] += column[j] * us[k, j]
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
        self._x, self._us = np.zeros(task.n), np.zeros((self._steps, task.m))
        self._xs = np.zeros((self._steps + 1, task.n))
        self._ds = np.zeros(store_size(task, self._steps))
        self._slope, self._slopes = bound(_slope), bound(_slopes)

    def __call__(self, x: Array, u_user: Array, task_mode: int | None = None, then: Array | None = None) -> float:
        """Criterion [unit of the cost] of a user's control (m,) at a state (n,); not finite if the numbers overflow.

        ``task_mode`` of a hybrid task; None: that of the state alone (:meth:`Task.mode`). ``then`` (any length, m):
        what u_2 is from the second sample on, as far as it goes and the horizon does; None: zero.
        """
        # Copies: the kernel is compiled for its own contiguous arrays, whatever kind the caller has.
        self._x[:] = x
        self._us[0] = u_user
        length = 1
        if then is not None:
            length = min(1 + len(then), self._steps)
            self._us[1:length] = then[: length - 1]
        mode = self._task.mode(self._x) if task_mode is None else task_mode
        return self._slope(
            *(self._p, self._c, mode, self._x, self._us, length, self._along_user, self._h, self._xs, self._ds)
        )

    def many(self, states: Array, controls: Array, task_modes: Array | None = None) -> Array:
        """Criterion of each of K states (K, n) with its control (K, m), or with one for all (m,): (K,), in one call.

        The same numbers as one after the other; for maps over states. ``task_modes`` (K,) of a hybrid task; None: those
        of the states alone.

        Raises
        ------
        ParameterError: arrays that do not fit the task or each other.
        """
        states = np.ascontiguousarray(states, dtype=float)
        if states.ndim != 2 or states.shape[1] != self._task.n:
            raise ParameterError(f"states: {states.shape} is not allowed; {self._task.name} needs (K, {self._task.n})")
        count = len(states)
        modes = [self._task.mode(x) for x in states] if task_modes is None else task_modes
        try:
            controls = np.ascontiguousarray(np.broadcast_to(controls, (count, self._task.m)), dtype=float)
            modes = np.ascontiguousarray(np.broadcast_to(modes, (count,)), dtype=np.int64)
        except ValueError:
            raise ParameterError(
                f"controls: {np.shape(controls)} and modes: {np.shape(modes)} are not allowed; {count} states need "
                f"({count}, {self._task.m}) or ({self._task.m},), and ({count},)"
            ) from None
        values = np.zeros(count)
        self._slopes(
            *(self._p, self._c, modes, states, controls, self._us, self._along_user, self._h, self._xs, self._ds),
            values,
        )
        return values


class CostOfNothing:
    """J(x; u = 0) over the horizon, with all memory allocated beforehand: what is there to be lowered."""

    def __init__(self, task: Task, cost: QuadraticCost, *, horizon: float, dt: float) -> None:
        steps = samples(horizon, dt)
        self._task, self._cost, self._h = task, cost, float(dt)
        self._nothing, self._xs = np.zeros((steps, task.m)), np.zeros((steps + 1, task.n + 1))
        self._rollout, self._no_store = bound(rollout), np.zeros(0)

    def __call__(self, x: Array, task_mode: int | None = None) -> float:
        """J [unit of the cost] at a state (n,); ``task_mode`` as for :class:`Criterion`."""
        mode = self._task.mode(x) if task_mode is None else task_mode
        start = tuple(float(value) for value in x)
        return float(
            self._rollout(
                *(self._task.parameters, self._cost, mode, start, self._nothing, self._h, math.inf),
                *(self._xs, self._no_store),
            )
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
    then: Array | None = None,
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
    then: u_2 from the second sample on (any length, m); None: zero, as in the paper.
    """
    criterion = Criterion(task, cost, horizon=horizon, dt=dt, adjoint_along=adjoint_along)
    return criterion(np.asarray(x, dtype=float), np.atleast_1d(np.asarray(u_user, dtype=float)), task_mode, then)
