"""A controller that keeps a schedule over a receding horizon: what :class:`shared_control.controllers.Controller` asks
for, around a search that each method brings.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from shared_control.controllers import Solution
from shared_control.cost import QuadraticCost
from shared_control.mig import samples
from shared_control.parameters import ParameterError
from shared_control.tasks.task import SAMPLE_TIME, Array, Task

__all__ = ["Receding"]


class Receding(ABC):
    """Warm start: the last schedule, shifted by the ticks that have passed and continued by zero.

    Or zero throughout, where that is cheaper. A schedule is *usable* once it is finite and no dearer than where the
    search began, *converged* if the tolerance was met as well.
    """

    def __init__(
        self,
        task: Task,
        cost: QuadraticCost,
        *,
        dt: float = SAMPLE_TIME,
        horizon: float = 1.5,
        limits: Sequence[float] = (),
        iterations: int = 3,
        tolerance: float = 1e-3,
    ) -> None:
        bounds = tuple(float(limit) for limit in (limits if len(limits) else task.control_limits))
        if len(bounds) != task.m or not all(math.isfinite(limit) and limit > 0.0 for limit in bounds):
            raise ParameterError(
                f"control_limits: {list(bounds)} is not allowed; {task.name} needs {task.m}, each finite and positive"
            )
        if iterations < 1 or not tolerance >= 0.0:
            raise ParameterError(
                f"controller: {iterations} iterations to {tolerance:g} are not allowed; at least 1, to at least 0"
            )
        steps, n, m = samples(horizon, dt), task.n, task.m
        self._task, self._p, self._c, self._h = task, task.parameters, cost, float(dt)
        self._iterations, self._tolerance = int(iterations), float(tolerance)
        self._steps = self._age = steps
        self._limits = np.array(bounds)
        self._costless = min(cost.control_weights) <= 0.0
        # Of a trajectory's columns the last is the mode that a hybrid task is in.
        self._x = np.zeros(n + 1)
        self._us, self._us_new = np.zeros((steps, m)), np.zeros((steps, m))
        self._xs, self._xs_new = np.zeros((steps + 1, n + 1)), np.zeros((steps + 1, n + 1))
        self._schedule = np.zeros((steps, m))

    @abstractmethod
    def _search(self) -> tuple[float, int, bool]:
        """Improve ``_us`` from ``_x``: cost, iterations, converged."""

    @property
    def schedule(self) -> Array:
        """The last valid schedule from the present tick on, continued by zero, (N, m)."""
        shifted = np.zeros_like(self._schedule)
        shifted[: self._steps - self._age] = self._schedule[self._age :]
        return shifted

    def aim(self, target: Sequence[float]) -> None:
        """Put another desired state (n,) in place of the objective's, for the solutions to come."""
        self._c = self._c._replace(target=tuple(float(value) for value in target))

    def solve(self, x: Array, task_mode: int | None = None) -> Solution:
        """Search from the state (n,) and the mode of a hybrid task (None: that of the state alone)."""
        left = self._steps - self._age
        self._us[:left] = self._schedule[self._age :]
        self._us[left:] = 0.0
        self._x[:-1] = x
        self._x[-1] = self._task.mode(x) if task_mode is None else task_mode
        cost, iterations, converged = self._search()
        # A finite cost can only come of finite controls where each enters it.
        if not math.isfinite(cost) or (self._costless and not math.isfinite(self._us.sum())):
            return Solution(self.fallback(), False, False, iterations, cost)
        self._schedule[:] = self._us
        self._age = 0
        return Solution(self._us[0].copy(), True, converged, iterations, cost)

    def fallback(self) -> Array:
        """Control of the last valid schedule for the present tick, zero after its end."""
        if self._age < self._steps:
            return np.array(self._schedule[self._age])
        return np.zeros_like(self._limits)

    def advance(self) -> None:
        """A tick has passed: the schedule is one sample older."""
        self._age = min(self._age + 1, self._steps)

    def reset(self) -> None:
        """Forget every schedule."""
        self._schedule[:] = 0.0
        self._age = self._steps
