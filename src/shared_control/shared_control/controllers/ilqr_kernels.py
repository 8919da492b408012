"""Kernels of the box-constrained iterative linear-quadratic regulator; see :mod:`shared_control.controllers.ilqr`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from shared_control.controllers.rollout_kernels import begin, copy
from shared_control.dispatch import effort, jit, running, running_gradient, terminal, terminal_gradient
from shared_control.integrate import step_linearised, step_pullback, stride
from shared_control.tasks.task import Array
from shared_control.tuples import axpy, take, unit

__all__ = ["search"]

#: Levenberg term: where it begins after a failed step, by how much it grows, where the search gives up.
DAMPING_FIRST = 1e-3
DAMPING_GROWTH = 10.0
DAMPING_LAST = 1e6
#: Least curvature of the control's quadratic model, for weights R = 0.
CURVATURE_LEAST = 1e-9
#: Step lengths 1, 1/2, 1/4, ...
HALVINGS = 6
#: A step counts if it gains at least this share of what the quadratic model promised.
GAIN_LEAST = 1e-4
#: Most sweeps of the coordinate search for the boxed control, and the share of the box at which it has settled.
#: For a single input one sweep is exact.
SWEEPS = 200
SETTLED = 1e-12


@jit
def _rollout_feedback(
    p: Any, c: Any, us: Array, xs: Array, ks: Array, gains: Array, alpha: float, limits: Array, h: float,
    ceiling: float, us_new: Array, xs_new: Array, store: Array,
) -> float:  # fmt: skip
    """J of clip(u + alpha k + K (x_new - x)), infinite if it is above the ceiling; schedule, trajectory and what its
    derivatives need go to us_new, xs_new and the store.
    """
    like_u = c.control_weights
    n, m, size = len(c.target), len(like_u), stride(p, c.target)
    steps = us.shape[0]
    x, mode = take(c.target, xs[0], 0), int(xs[0, n])
    total = 0.0
    for k in range(steps):
        for i in range(n):
            xs_new[k, i] = x[i]
        xs_new[k, n] = mode
        for j in range(m):
            u_j = us[k, j] + alpha * ks[k, j]
            for i in range(n):
                u_j += gains[k, j, i] * (x[i] - xs[k, i])
            us_new[k, j] = min(max(u_j, -limits[j]), limits[j])
        u = take(like_u, us_new[k], 0)
        total += h * ((0.5 if k == 0 else 1.0) * running(c, x) + effort(c, u))
        if total > ceiling:
            return math.inf
        x, mode = step_linearised(p, mode, x, u, h, store, k * size)
    for i in range(n):
        xs_new[steps, i] = x[i]
    xs_new[steps, n] = mode
    return total + 0.5 * h * running(c, x) + terminal(c, x)


@jit
def _box_step(quu: Array, qu: Array, low: Array, high: Array, du: Array, free: Any) -> None:
    """du = argmin 1/2 du^T Quu du + qu^T du within [low, high], by cyclic coordinate search; which of it is free."""
    m = len(du)
    for j in range(m):
        du[j] = min(max(0.0, low[j]), high[j])
    for _ in range(SWEEPS):
        moved = 0.0
        for j in range(m):
            slope = qu[j]
            for i in range(m):
                slope += quu[j, i] * du[i]
            new = min(max(du[j] - slope / quu[j, j], low[j]), high[j])
            moved = max(moved, abs(new - du[j]) / (high[j] - low[j]))
            du[j] = new
        if m == 1 or moved <= SETTLED:
            break
    for j in range(m):
        slope = qu[j]
        for i in range(m):
            slope += quu[j, i] * du[i]
        free[j] = not ((du[j] <= low[j] and slope > 0.0) or (du[j] >= high[j] and slope < 0.0))


@jit
def _solve_free(quu: Array, free: Any, factor: Array, rhs: Array) -> None:
    """rhs <- -Quu_ff^-1 rhs on the free inputs, zero on the clamped ones; by Gauss-Jordan, Quu is positive definite."""
    m = len(free)
    for i in range(m):
        for j in range(m):
            both = free[i] and free[j]
            factor[i, j] = quu[i, j] if both else (1.0 if i == j else 0.0)
    columns = rhs.shape[1]
    for i in range(m):
        if not free[i]:
            for q in range(columns):
                rhs[i, q] = 0.0
    for i in range(m):
        pivot = 1.0 / factor[i, i]
        for j in range(m):
            if j != i:
                ratio = factor[j, i] * pivot
                for q in range(m):
                    factor[j, q] -= ratio * factor[i, q]
                for q in range(columns):
                    rhs[j, q] -= ratio * rhs[i, q]
    for i in range(m):
        for q in range(columns):
            rhs[i, q] = -rhs[i, q] / factor[i, i]


@jit
def _backward(
    p: Any, c: Any, us: Array, xs: Array, limits: Array, damping: float, h: float,
    store: Array, stored: bool, ks: Array, gains: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Riccati sweep along a trajectory: ks, gains; the model's linear and quadratic gain and the largest change asked
    for. What the derivatives need is in the store already, or is put there.
    """
    like_x, like_u = c.target, c.control_weights
    n, m, size = len(like_x), len(like_u), stride(p, c.target)
    steps = us.shape[0]
    a, b = np.empty((n, n)), np.empty((n, m))
    vx, vxx = np.empty(n), np.zeros((n, n))
    va, vb = np.empty((n, n)), np.empty((n, m))
    qu, quu, qux = np.empty(m), np.empty((m, m)), np.empty((m, n))
    damped, factor = np.empty((m, m)), np.empty((m, m))
    low, high, du, free = np.empty(m), np.empty(m), np.empty(m), np.empty(m, np.bool_)
    x_end = take(like_x, xs[steps], 0)
    end = axpy(0.5 * h, running_gradient(c, x_end), terminal_gradient(c, x_end))
    for i in range(n):
        vx[i] = end[i]
        vxx[i, i] = 0.5 * h * c.state_weights[i] + c.terminal_weights[i]
    linear, quadratic, largest = 0.0, 0.0, 0.0
    for k in range(steps - 1, -1, -1):
        u = take(like_u, us[k], 0)
        if not stored:
            step_linearised(p, int(xs[k, n]), take(like_x, xs[k], 0), u, h, store, k * size)
        for i in range(n):
            row, column = step_pullback(p, store, k * size, u, unit(like_x, i), h)
            for j in range(n):
                a[i, j] = row[j]
            for j in range(m):
                b[i, j] = column[j]
        for i in range(n):
            for j in range(n):
                total = 0.0
                for q in range(n):
                    total += vxx[i, q] * a[q, j]
                va[i, j] = total
            for j in range(m):
                total = 0.0
                for q in range(n):
                    total += vxx[i, q] * b[q, j]
                vb[i, j] = total
        for j in range(m):
            total = h * c.control_weights[j] * us[k, j]
            for q in range(n):
                total += b[q, j] * vx[q]
            qu[j] = total
            for i in range(m):
                total = h * c.control_weights[j] if i == j else 0.0
                for q in range(n):
                    total += b[q, j] * vb[q, i]
                quu[j, i] = total
                damped[j, i] = total + (damping + CURVATURE_LEAST if i == j else 0.0)
            for i in range(n):
                total = 0.0
                for q in range(n):
                    total += b[q, j] * va[q, i]
                qux[j, i] = total
            low[j], high[j] = -limits[j] - us[k, j], limits[j] - us[k, j]
        _box_step(damped, qu, low, high, du, free)
        for j in range(m):
            ks[k, j] = du[j]
            largest = max(largest, abs(du[j]) / limits[j])
            for i in range(n):
                gains[k, j, i] = qux[j, i]
        _solve_free(damped, free, factor, gains[k])
        # Vx = Qx + K^T (Quu k + Qu) + Qux^T k,  Vxx = Qxx + K^T Quu K + K^T Qux + Qux^T K
        gradient = running_gradient(c, take(like_x, xs[k], 0))
        for j in range(m):
            linear += du[j] * qu[j]
            slope = 0.0
            for i in range(m):
                slope += quu[j, i] * du[i]
            quadratic += 0.5 * du[j] * slope
            factor[j, 0] = slope + qu[j]
        for i in range(n):
            low_order = h * gradient[i]
            for q in range(n):
                low_order += a[q, i] * vx[q]
            for j in range(m):
                low_order += gains[k, j, i] * factor[j, 0] + qux[j, i] * du[j]
            vb[i, 0] = low_order
        for i in range(n):
            vx[i] = vb[i, 0]
            for j in range(i + 1):
                total = h * c.state_weights[i] if i == j else 0.0
                for q in range(n):
                    total += a[q, i] * va[q, j]
                for q in range(m):
                    curved = 0.0
                    for r in range(m):
                        curved += quu[q, r] * gains[k, r, j]
                    total += gains[k, q, i] * (curved + qux[q, j]) + qux[q, i] * gains[k, q, j]
                vxx[i, j] = total
        for i in range(n):
            for j in range(i + 1, n):
                vxx[i, j] = vxx[j, i]
    return linear, quadratic, largest


@jit
def search(
    p: Any, c: Any, x0: Array, us: Array, limits: Array, h: float, iterations: int, tolerance: float,
    xs: Array, us_new: Array, xs_new: Array, store: Array, store_new: Array, ks: Array, gains: Array,
) -> tuple[float, int, bool]:  # fmt: skip
    """Improve the schedule us in place; (J, iterations used, converged). J is not finite if nothing was found."""
    start = take(c.target, x0, 0)
    best, stored = begin(p, c, int(x0[len(start)]), start, us, h, xs, us_new, xs_new, store)
    if not math.isfinite(best):
        return best, 0, False
    damping = 0.0
    for iteration in range(iterations):
        linear, quadratic, largest = _backward(p, c, us, xs, limits, damping, h, store, stored, ks, gains)
        if not (math.isfinite(linear) and math.isfinite(quadratic)):
            return best, iteration, False
        if largest < tolerance:
            return best, iteration, True
        stored, improved = True, False
        alpha = 1.0
        for _ in range(HALVINGS):
            promised = -(alpha * linear + alpha * alpha * quadratic)
            cost = _rollout_feedback(p, c, us, xs, ks, gains, alpha, limits, h, best, us_new, xs_new, store_new)
            if math.isfinite(cost) and best - cost > GAIN_LEAST * max(promised, 0.0):
                improved = True
                break
            alpha *= 0.5
        if improved:
            gain = best - cost
            best = cost
            copy(us_new, us)
            copy(xs_new, xs)
            store, store_new = store_new, store
            damping = 0.0 if damping <= DAMPING_FIRST else damping / DAMPING_GROWTH
            if gain <= tolerance * abs(best):
                return best, iteration + 1, True
        else:
            damping = max(DAMPING_FIRST, damping * DAMPING_GROWTH)
            if damping > DAMPING_LAST:
                return best, iteration + 1, False
    return best, iterations, False
