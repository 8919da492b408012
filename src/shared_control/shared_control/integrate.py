"""One step of a task, and its exact discrete derivative: RK4, for a hybrid task from event to event.

Which of :mod:`shared_control.rk4` and :mod:`shared_control.hybrid` a kernel gets is settled where it is compiled, by
the type of the task's parameters: a smooth task pays nothing for the others' events.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shared_control import hybrid, rk4
from shared_control.dispatch import is_hybrid, jit, replaced_by
from shared_control.tasks.task import Array, Task
from shared_control.tuples import Vector, take, unit

__all__ = ["Stepper", "step", "step_linearised", "step_pullback", "store_size", "stride"]


def _method(p: Any) -> Any:
    return hybrid if is_hybrid(p) else rk4


def stride(p: Any, x: Vector) -> int:
    """How much of the store a step takes."""
    size: int = _method(p).stride(p, x)
    return size


def step(p: Any, x: Vector, u: Vector, h: float) -> Vector:
    """The state after a step of h [s] under a control that is held."""
    new: Vector = _method(p).step(p, x, u, h)
    return new


def step_linearised(p: Any, x: Vector, u: Vector, h: float, store: Array, at: int) -> Vector:
    """As :func:`step`; what :func:`step_pullback` needs goes to ``store[at:]``."""
    new: Vector = _method(p).step_linearised(p, x, u, h, store, at)
    return new


def step_pullback(p: Any, store: Array, at: int, u: Vector, w: Vector, h: float) -> tuple[Vector, Vector]:
    """(w^T dx_end/dx, w^T dx_end/du) of the step under u whose store begins at ``at``."""
    back: tuple[Vector, Vector] = _method(p).step_pullback(p, store, at, u, w, h)
    return back


replaced_by(stride)(lambda p, x: _method(p).stride.py_func)
replaced_by(step)(lambda p, x, u, h: _method(p).step.py_func)
replaced_by(step_linearised)(lambda p, x, u, h, store, at: _method(p).step_linearised.py_func)
replaced_by(step_pullback)(lambda p, store, at, u, w, h: _method(p).step_pullback.py_func)


@jit
def _step_array(p: Any, like_x: Vector, like_u: Vector, x: Array, u: Array, h: float) -> None:
    new = step(p, take(like_x, x, 0), take(like_u, u, 0), h)
    for i in range(len(new)):
        x[i] = new[i]


@jit
def _jacobian_array(p: Any, like_x: Vector, like_u: Vector, x: Array, u: Array, h: float, a: Array, b: Array) -> None:
    control = take(like_u, u, 0)
    store = np.empty(stride(p, like_x))
    step_linearised(p, take(like_x, x, 0), control, h, store, 0)
    for i in range(len(like_x)):
        row, column = step_pullback(p, store, 0, control, unit(like_x, i), h)
        for j in range(len(like_x)):
            a[i, j] = row[j]
        for j in range(len(like_u)):
            b[i, j] = column[j]


def store_size(task: Task, steps: int) -> int:
    """Length of the store of a trajectory."""
    method = _method(task.parameters)
    return steps * int(method.stride.py_func(task.parameters, task.target))


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
