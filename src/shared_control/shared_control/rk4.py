"""One step of the classical Runge-Kutta method (RK4), and its exact discrete derivative.

    k_1 = f(x, u),  k_2 = f(x + h/2 k_1, u),  k_3 = f(x + h/2 k_2, u),  k_4 = f(x + h k_3, u)
    Phi(x, u, h) = x + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4)

with the control held over the step. The derivative is that of the step itself (discretise, then differentiate), taken
backwards through the four stages: for a row vector w it gives w^T dPhi/dx, w^T dPhi/du and w^T dPhi/dh exactly, to
rounding.
"""

from __future__ import annotations

from typing import Any

from shared_control.dispatch import flow, jit, jit_inlined, linearise, partials, pullback
from shared_control.tasks.task import Array
from shared_control.tuples import Vector, axpy, dot, take, zeros

__all__ = ["step", "step_linearised", "step_pullback", "step_pullback_duration", "stride"]


@jit
def stride(p: Any, x: Vector) -> int:
    """How much of the store a step takes."""
    return 4 * len(partials(p))


@jit
def step(p: Any, x: Vector, u: Vector, h: float) -> Vector:
    """Phi(x, u)."""
    k1 = flow(p, x, u)
    k2 = flow(p, axpy(0.5 * h, k1, x), u)
    k3 = flow(p, axpy(0.5 * h, k2, x), u)
    k4 = flow(p, axpy(h, k3, x), u)
    return axpy(h / 6.0, axpy(2.0, k2, axpy(2.0, k3, axpy(1.0, k1, k4))), x)


@jit_inlined
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


@jit_inlined
def _stages(
    p: Any, store: Array, at: int, w: Vector, h: float
) -> tuple[Vector, Vector, Vector, Vector, Vector]:  # fmt: skip
    """w taken back to the argument of each stage, and to the control."""
    like, none = partials(p), zeros(w)
    size = len(like)
    x4, u4 = pullback(p, take(like, store, at + 3 * size), axpy(h / 6.0, w, none))
    x3, u3 = pullback(p, take(like, store, at + 2 * size), axpy(h, x4, axpy(h / 3.0, w, none)))
    x2, u2 = pullback(p, take(like, store, at + size), axpy(0.5 * h, x3, axpy(h / 3.0, w, none)))
    x1, u1 = pullback(p, take(like, store, at), axpy(0.5 * h, x2, axpy(h / 6.0, w, none)))
    return x1, x2, x3, x4, axpy(1.0, u1, axpy(1.0, u2, axpy(1.0, u3, u4)))


@jit_inlined
def step_pullback(p: Any, store: Array, at: int, u: Vector, w: Vector, h: float) -> tuple[Vector, Vector]:
    """(w^T dPhi/dx, w^T dPhi/du), from what :func:`step_linearised` stored."""
    x1, x2, x3, x4, wu = _stages(p, store, at, w, h)
    return axpy(1.0, x1, axpy(1.0, x2, axpy(1.0, x3, axpy(1.0, x4, w)))), wu


@jit
def step_pullback_duration(
    p: Any, store: Array, at: int, x: Vector, u: Vector, w: Vector, h: float
) -> tuple[Vector, Vector, float]:
    """(w^T dPhi/dx, w^T dPhi/du, w^T dPhi/dh) of the step from x."""
    x1, x2, x3, x4, wu = _stages(p, store, at, w, h)
    k1 = flow(p, x, u)
    k2 = flow(p, axpy(0.5 * h, k1, x), u)
    k3 = flow(p, axpy(0.5 * h, k2, x), u)
    k4 = flow(p, axpy(h, k3, x), u)
    wh = dot(w, axpy(2.0, k2, axpy(2.0, k3, axpy(1.0, k1, k4)))) / 6.0
    wh += 0.5 * dot(x2, k1) + 0.5 * dot(x3, k2) + dot(x4, k3)
    return axpy(1.0, x1, axpy(1.0, x2, axpy(1.0, x3, axpy(1.0, x4, w)))), wu, wh
