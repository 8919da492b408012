"""One step of a task, and its exact discrete derivative: RK4, for a hybrid task from event to event.

Which of :mod:`shared_control.rk4` and :mod:`shared_control.hybrid` a kernel gets is settled where it is compiled, by
the type of the task's parameters: a smooth task pays nothing for the others' events.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shared_control import hybrid, rk4
from shared_control.dispatch import bound, is_hybrid, jit, plain, replaced_by
from shared_control.tasks.task import Array, Task
from shared_control.tuples import Vector, take, unit

__all__ = ["Stepper", "step", "step_linearised", "step_pullback", "store_size", "stride"]


def _method(p: Any) -> Any:
    return hybrid if is_hybrid(p) else rk4


def _smooth_step(p: Any, mode: int, x: Vector, u: Vector, h: float) -> tuple[Vector, int]:
    return rk4.step(p, x, u, h), mode


def _smooth_step_linearised(
    p: Any, mode: int, x: Vector, u: Vector, h: float, store: Array, at: int
) -> tuple[Vector, int]:
    return rk4.step_linearised(p, x, u, h, store, at), mode


def stride(p: Any, x: Vector) -> int:
    """How much of the store a step takes."""
    size: int = _method(p).stride(p, x)
    return size


def step(p: Any, mode: int, x: Vector, u: Vector, h: float) -> tuple[Vector, int]:
    """State and mode after a step of h [s] under a control that is held; a smooth task has one mode, 0."""
    method = hybrid.step if is_hybrid(p) else _smooth_step
    return method(p, mode, x, u, h)


def step_linearised(p: Any, mode: int, x: Vector, u: Vector, h: float, store: Array, at: int) -> tuple[Vector, int]:
    """As :func:`step`; what :func:`step_pullback` needs goes to ``store[at:]``."""
    method = hybrid.step_linearised if is_hybrid(p) else _smooth_step_linearised
    return method(p, mode, x, u, h, store, at)


def step_pullback(p: Any, store: Array, at: int, u: Vector, w: Vector, h: float) -> tuple[Vector, Vector]:
    """(w^T dx_end/dx, w^T dx_end/du) of the step under u whose store begins at ``at``."""
    back: tuple[Vector, Vector] = _method(p).step_pullback(p, store, at, u, w, h)
    return back


replaced_by(stride)(lambda p, x: plain(_method(p).stride))
replaced_by(step)(lambda p, mode, x, u, h: plain(hybrid.step) if is_hybrid(p) else _smooth_step)
replaced_by(step_linearised)(
    lambda p, mode, x, u, h, store, at: plain(hybrid.step_linearised) if is_hybrid(p) else _smooth_step_linearised
)
replaced_by(step_pullback)(lambda p, store, at, u, w, h: plain(_method(p).step_pullback))


@jit
def _step_array(p: Any, mode: int, like_x: Vector, like_u: Vector, x: Array, u: Array, h: float) -> int:
    new, mode = step(p, mode, take(like_x, x, 0), take(like_u, u, 0), h)
    for i in range(len(new)):
        x[i] = new[i]
    return mode


@jit
def _jacobian_array(
    p: Any, mode: int, like_x: Vector, like_u: Vector, x: Array, u: Array, h: float, a: Array, b: Array
) -> None:
    control = take(like_u, u, 0)
    store = np.empty(stride(p, like_x))
    step_linearised(p, mode, take(like_x, x, 0), control, h, store, 0)
    for i in range(len(like_x)):
        row, column = step_pullback(p, store, 0, control, unit(like_x, i), h)
        for j in range(len(like_x)):
            a[i, j] = row[j]
        for j in range(len(like_u)):
            b[i, j] = column[j]


def store_size(task: Task, steps: int) -> int:
    """Length of the store of a trajectory."""
    method = _method(task.parameters)
    return steps * int(plain(method.stride)(task.parameters, task.target))


class Stepper:
    """Advances a task's state by one sample, with all memory allocated beforehand."""

    def __init__(self, task: Task, sample_time: float) -> None:
        self._task, self._p = task, task.parameters
        self._like_x = (0.0,) * task.n
        self._like_u = (0.0,) * task.m
        self._h = float(sample_time)
        self._u = np.zeros(task.m)
        self._step = bound(_step_array)

    def advance(self, x: Array, u: Array, task_mode: int | None = None) -> int:
        """x <- Phi(x, u), in place; ``x`` is a contiguous array (n,), ``u`` (m,). Returns the task's mode after it.

        ``task_mode`` is the one before; None: that of the state alone (:meth:`Task.mode`).
        """
        self._u[:] = u
        mode = self._task.mode(x) if task_mode is None else task_mode
        new: int = self._step(self._p, mode, self._like_x, self._like_u, x, self._u, self._h)
        return new

    def jacobians(self, x: Array, u: Array, task_mode: int | None = None) -> tuple[Array, Array]:
        """(dPhi/dx, dPhi/du), (n, n) and (n, m)."""
        n, m = len(self._like_x), len(self._like_u)
        a, b = np.empty((n, n)), np.empty((n, m))
        state, control = np.array(x, dtype=float), np.array(u, dtype=float)
        mode = self._task.mode(state) if task_mode is None else task_mode
        _jacobian_array(self._p, mode, self._like_x, self._like_u, state, control, self._h, a, b)
        return a, b
