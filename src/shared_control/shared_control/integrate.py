"""One step of the classical Runge-Kutta method (RK4), and its exact discrete derivative.

    k_1 = f(x, u),  k_2 = f(x + h/2 k_1, u),  k_3 = f(x + h/2 k_2, u),  k_4 = f(x + h k_3, u)
    Phi(x, u) = x + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4)

with the control held over the step. The derivative is that of the step itself (discretise, then differentiate), taken
backwards through the four stages: for a row vector w it gives w^T dPhi/dx and w^T dPhi/du exactly, to rounding. A
kernel that calls these is compiled for the task at hand (:mod:`shared_control.dispatch`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shared_control.dispatch import flow, jit, linearise, pullback
from shared_control.tasks.task import Array, Task
from shared_control.tuples import Vector, axpy, take, unit

__all__ = ["Stepper", "partials_size", "step", "step_linearised", "step_pullback"]


@jit
def step(p: Any, x: Vector, u: Vector, h: float) -> Vector:
    """Phi(x, u)."""
    k1 = flow(p, x, u)
    k2 = flow(p, axpy(0.5 * h, k1, x), u)
    k3 = flow(p, axpy(0.5 * h, k2, x), u)
    k4 = flow(p, axpy(h, k3, x), u)
    return axpy(h / 6.0, axpy(2.0, k2, axpy(2.0, k3, axpy(1.0, k1, k4))), x)


@jit
def step_linearised(p: Any, x: Vector, u: Vector, h: float, store: Array, at: int) -> Vector:
    """Phi(x, u); the partial derivatives at the four stages go to ``store[at:]``, one after the other."""
    k1, d1 = linearise(p, x, u)
    k2, d2 = linearise(p, axpy(0.5 * h, k1, x), u)
    k3, d3 = linearise(p, axpy(0.5 * h, k2, x), u)
    k4, d4 = linearise(p, axpy(h, k3, x), u)
    size = len(d1)
    for i in range(size):
        store[at + i] = d1[i]
        store[at + size + i] = d2[i]
        store[at + 2 * size + i] = d3[i]
        store[at + 3 * size + i] = d4[i]
    return axpy(h / 6.0, axpy(2.0, k2, axpy(2.0, k3, axpy(1.0, k1, k4))), x)


@jit
def step_pullback(p: Any, d1: Vector, d2: Vector, d3: Vector, d4: Vector, w: Vector, h: float) -> tuple[Vector, Vector]:
    """(w^T dPhi/dx, w^T dPhi/du), from the partial derivatives at the four stages."""
    none = axpy(-1.0, w, w)
    x4, u4 = pullback(p, d4, axpy(h / 6.0, w, none))
    x3, u3 = pullback(p, d3, axpy(h, x4, axpy(h / 3.0, w, none)))
    x2, u2 = pullback(p, d2, axpy(0.5 * h, x3, axpy(h / 3.0, w, none)))
    x1, u1 = pullback(p, d1, axpy(0.5 * h, x2, axpy(h / 6.0, w, none)))
    wx = axpy(1.0, x1, axpy(1.0, x2, axpy(1.0, x3, axpy(1.0, x4, w))))
    return wx, axpy(1.0, u1, axpy(1.0, u2, axpy(1.0, u3, u4)))


@jit
def _step_array(p: Any, like_x: Vector, like_u: Vector, x: Array, u: Array, h: float) -> None:
    new = step(p, take(like_x, x, 0), take(like_u, u, 0), h)
    for i in range(len(new)):
        x[i] = new[i]


@jit
def _jacobian_array(p: Any, like_x: Vector, like_u: Vector, x: Array, u: Array, h: float, a: Array, b: Array) -> None:
    control = take(like_u, u, 0)
    _, like_d = linearise(p, like_x, like_u)
    size = len(like_d)
    store = np.empty(4 * size)
    step_linearised(p, take(like_x, x, 0), control, h, store, 0)
    for i in range(len(like_x)):
        row, column = step_pullback(
            p,
            take(like_d, store, 0),
            take(like_d, store, size),
            take(like_d, store, 2 * size),
            take(like_d, store, 3 * size),
            unit(like_x, i),
            h,
        )
        for j in range(len(like_x)):
            a[i, j] = row[j]
        for j in range(len(like_u)):
            b[i, j] = column[j]


def partials_size(task: Task) -> int:
    """Number of partial derivatives that the task's ``linearise`` gives."""
    _, d = linearise(task.parameters, task.target, (0.0,) * task.m)
    return len(d)


class Stepper:
    """Advances a task's state by one sample, with all memory allocated beforehand."""

    def __init__(self, task: Task, sample_time: float) -> None:
        self._p = task.parameters
        self._like_x = (0.0,) * task.n
        self._like_u = (0.0,) * task.m
        self._h = float(sample_time)
        self._u = np.zeros(task.m)
        self._n, self._m = task.n, task.m

    def advance(self, x: Array, u: Array) -> None:
        """x <- Phi(x, u), in place; ``x`` is a contiguous array (n,), ``u`` (m,)."""
        self._u[:] = u
        _step_array(self._p, self._like_x, self._like_u, x, self._u, self._h)

    def jacobians(self, x: Array, u: Array) -> tuple[Array, Array]:
        """(dPhi/dx, dPhi/du), (n, n) and (n, m)."""
        a, b = np.empty((self._n, self._n)), np.empty((self._n, self._m))
        state, control = np.array(x, dtype=float), np.array(u, dtype=float)
        _jacobian_array(self._p, self._like_x, self._like_u, state, control, self._h, a, b)
        return a, b
