"""Box-constrained iterative linear-quadratic regulator (iLQR): the robust default.

    min over u_0 .. u_N-1 of J (shared_control.cost), subject to x_k+1 = Phi(x_k, u_k), |u_k| <= limit

Each iteration rolls the schedule out, differentiates the RK4 steps exactly, solves the box-constrained quadratic model
backwards (Gauss-Newton curvature of the cost, a Levenberg term after a failed step) and searches along the result with
feedback. Warm start: the last schedule, shifted by the ticks that have passed and continued by zero, or zero throughout
where that is cheaper. In real time a few iterations a tick are enough: a schedule is *usable* once it is finite and no
dearer than where the search began, *converged* if the tolerance was met as well. Sources: Tassa, Mansard, Todorov,
"Control-limited differential dynamic programming", ICRA 2014; Diehl, Bock, Schloeder, "A real-time iteration scheme",
SIAM J. Control Optim. 2005.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from shared_control.controllers import Solution
from shared_control.controllers.ilqr_kernels import search
from shared_control.cost import QuadraticCost
from shared_control.integrate import store_size
from shared_control.mig import samples
from shared_control.parameters import ParameterError
from shared_control.tasks.task import SAMPLE_TIME, Array, Task

__all__ = ["Ilqr"]


class Ilqr:
    """See the module."""

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
                f"ilqr: {iterations} iterations to {tolerance:g} are not allowed; at least 1, to at least 0"
            )
        steps, n, m = samples(horizon, dt), task.n, task.m
        self._p, self._c, self._h = task.parameters, cost, float(dt)
        self._iterations, self._tolerance = int(iterations), float(tolerance)
        self._steps = steps
        self._limits = np.array(bounds)
        self._x = np.zeros(n)
        self._us = np.zeros((steps, m))
        self._schedule = np.zeros((steps, m))
        self._age = steps
        self._xs, self._xs_new = np.zeros((steps + 1, n)), np.zeros((steps + 1, n))
        self._us_new = np.zeros((steps, m))
        self._ds = np.zeros(store_size(task, 1))
        self._ks, self._gains = np.zeros((steps, m)), np.zeros((steps, m, n))

    @property
    def schedule(self) -> Array:
        """The last valid schedule from the present tick on, continued by zero, (N, m)."""
        shifted = np.zeros_like(self._schedule)
        shifted[: self._steps - self._age] = self._schedule[self._age :]
        return shifted

    def solve(self, x: Array) -> Solution:
        """Search from the state (n,)."""
        left = self._steps - self._age
        self._us[:left] = self._schedule[self._age :]
        self._us[left:] = 0.0
        self._x[:] = x
        cost, iterations, converged = search(
            self._p, self._c, self._x, self._us, self._limits, self._h, self._iterations, self._tolerance,
            self._xs, self._us_new, self._xs_new, self._ds, self._ks, self._gains,
        )  # fmt: skip
        # A finite cost can only come of finite controls, since each enters it (or, with R = 0, through the state).
        if not math.isfinite(cost) or not math.isfinite(self._us.sum()):
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
