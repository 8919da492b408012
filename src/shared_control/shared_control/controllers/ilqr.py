"""Box-constrained iterative linear-quadratic regulator (iLQR): the robust default.

    min over u_0 .. u_N-1 of J (shared_control.cost), subject to x_k+1 = Phi(x_k, u_k), |u_k| <= limit

Each iteration rolls the schedule out, differentiates the steps exactly, solves the box-constrained quadratic model
backwards (Gauss-Newton curvature of the cost, a Levenberg term after a failed step) and searches along the result with
feedback. In real time a few iterations a tick are enough. Sources: Tassa, Mansard, Todorov, "Control-limited
differential dynamic programming", ICRA 2014; Diehl, Bock, Schloeder, "A real-time iteration scheme", SIAM J. Control
Optim. 2005.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shared_control.controllers.ilqr_kernels import search
from shared_control.controllers.receding import Receding
from shared_control.cost import QuadraticCost
from shared_control.dispatch import bound
from shared_control.integrate import store_size
from shared_control.tasks.task import Task

__all__ = ["Ilqr"]


class Ilqr(Receding):
    """See the module."""

    def __init__(self, task: Task, cost: QuadraticCost, **options: Any) -> None:
        super().__init__(task, cost, **options)
        self._store, self._store_new = np.zeros((2, store_size(task, self._steps)))
        self._ks, self._gains = np.zeros((self._steps, task.m)), np.zeros((self._steps, task.m, task.n))
        self._kernel = bound(search)

    def _search(self) -> tuple[float, int, bool]:
        found: tuple[float, int, bool] = self._kernel(
            self._p, self._c, self._x, self._us, self._limits, self._h, self._iterations, self._tolerance,
            self._xs, self._us_new, self._xs_new, self._store, self._store_new,
            self._ks, self._gains,
        )  # fmt: skip
        return found
