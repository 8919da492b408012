"""Kernels that every controller with a schedule shares."""

from __future__ import annotations

import math
from typing import Any

from shared_control.dispatch import effort, jit, running, terminal
from shared_control.integrate import step, step_linearised, stride
from shared_control.tasks.task import Array
from shared_control.tuples import Vector, take

__all__ = ["begin", "copy", "rollout"]


@jit
def rollout(
    p: Any, c: Any, mode: int, x0: Vector, us: Array, h: float, ceiling: float, xs: Array, store: Array
) -> float:
    """J of a schedule (N, m) from x0; infinite as soon as it is above the ceiling: it only grows from step to step.

    The trajectory goes to xs (N+1, n+1): states, and in the last column modes; what the steps' derivatives need goes to
    the store, if it has any length.
    """
    like_u = c.control_weights
    n, size = len(x0), stride(p, x0)
    steps = us.shape[0]
    linearised = len(store) > 0
    x = x0
    total = 0.0
    for k in range(steps):
        for i in range(n):
            xs[k, i] = x[i]
        xs[k, n] = mode
        u = take(like_u, us[k], 0)
        total += h * ((0.5 if k == 0 else 1.0) * running(c, x) + effort(c, u))
        if total > ceiling:
            return math.inf
        if linearised:
            x, mode = step_linearised(p, mode, x, u, h, store, k * size)
        else:
            x, mode = step(p, mode, x, u, h)
    for i in range(n):
        xs[steps, i] = x[i]
    xs[steps, n] = mode
    return total + 0.5 * h * running(c, x) + terminal(c, x)


@jit
def copy(source: Array, to: Array) -> None:
    # Written out: the compiler spends longer on one slice assignment than on all that is here.
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            to[i, j] = source[i, j]


@jit
def begin(
    p: Any, c: Any, mode: int, start: Vector, us: Array, h: float, xs: Array, us_new: Array, xs_new: Array, store: Array
) -> tuple[float, bool]:
    """J of a schedule, which becomes zero throughout where that is cheaper, and whether it was kept.

    The trajectory goes to xs, and with a schedule that was kept what its derivatives need to the store, if it has any
    length. The schedule may have come from another state.
    """
    best = rollout(p, c, mode, start, us, h, math.inf, xs, store)
    for k in range(us.shape[0]):
        for j in range(us.shape[1]):
            us_new[k, j] = 0.0
    idle = rollout(p, c, mode, start, us_new, h, best, xs_new, store[:0])
    if not best <= idle and math.isfinite(idle):
        copy(us_new, us)
        copy(xs_new, xs)
        return idle, False
    return best, True
