"""Kernels of sequential action control in its schedule form; see :mod:`shared_control.controllers.sac`."""

from __future__ import annotations

import math
from typing import Any

from shared_control.controllers.rollout_kernels import begin, copy, rollout
from shared_control.dispatch import jit, running_gradient, terminal_gradient
from shared_control.integrate import step_linearised, step_pullback
from shared_control.tasks.task import Array
from shared_control.tuples import axpy, take

__all__ = ["search"]

#: Step lengths 1, 0.55, 0.55^2, ...: the laboratory's.
SHRINK = 0.55
#: Least weight of a control, for R = 0.
WEIGHT_LEAST = 1e-9


@jit
def _schedule(
    p: Any, c: Any, us: Array, xs: Array, limits: Array, h: float, descent: float, store: Array, to: Array
) -> bool:
    """u* along a trajectory, saturated, into ``to``; whether it is finite.

    With a = h^T rho, Lambda = a a^T has rank one, and by Sherman and Morrison
    (Lambda + R)^-1 (Lambda u_1 + a alpha_d) = R^-1 a (a^T u_1 + alpha_d) / (1 + a^T R^-1 a).
    """
    like_x, like_u = c.target, c.control_weights
    m = len(like_u)
    steps = us.shape[0]
    x_end = take(like_x, xs[steps], 0)
    rho = axpy(0.5 * h, running_gradient(c, x_end), terminal_gradient(c, x_end))
    for k in range(steps - 1, -1, -1):
        x, u = take(like_x, xs[k], 0), take(like_u, us[k], 0)
        step_linearised(p, int(xs[k, len(x)]), x, u, h, store, 0)
        rho, slope = step_pullback(p, store, 0, u, rho, h)
        along, weight = descent, 1.0
        for j in range(m):
            a = slope[j] / h
            along += a * us[k, j]
            weight += a * a / max(c.control_weights[j], WEIGHT_LEAST)
        for j in range(m):
            best = slope[j] / h / max(c.control_weights[j], WEIGHT_LEAST) * along / weight
            if not math.isfinite(best):
                return False
            to[k, j] = min(max(best, -limits[j]), limits[j])
        rho = axpy(h, running_gradient(c, x), rho)
    return True


@jit
def search(
    p: Any, c: Any, x0: Array, us: Array, limits: Array, h: float, iterations: int, tolerance: float, gamma: float,
    tries: int, xs: Array, us_new: Array, xs_new: Array, store: Array, wanted: Array,
) -> tuple[float, int, bool]:  # fmt: skip
    """Improve the schedule us in place; (J, iterations used, converged). J is not finite if nothing was found."""
    steps, m = us.shape
    start = take(c.target, x0, 0)
    mode = int(x0[len(start)])
    best, _ = begin(p, c, mode, start, us, h, xs, us_new, xs_new, store[:0])
    if not math.isfinite(best):
        return best, 0, False
    for iteration in range(iterations):
        if not _schedule(p, c, us, xs, limits, h, gamma * best, store, wanted):
            return best, iteration, False
        share, gain = 1.0, 0.0
        for _ in range(tries):
            for k in range(steps):
                for j in range(m):
                    us_new[k, j] = us[k, j] + share * (wanted[k, j] - us[k, j])
            cost = rollout(p, c, mode, start, us_new, h, best, xs_new, store[:0])
            if cost < best:
                gain = best - cost
                best = cost
                copy(us_new, us)
                copy(xs_new, xs)
                break
            share *= SHRINK
        if gain <= tolerance * abs(best):
            return best, iteration + 1, True
    return best, iterations, False
