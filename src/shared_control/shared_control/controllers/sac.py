"""Sequential action control (SAC) in the schedule form that the paper uses.

    u*(t) = (Lambda + R^T)^-1 (Lambda u_1 + h^T rho alpha_d),   Lambda = h^T rho rho^T h,   alpha_d = gamma J

with h = df/du, along the nominal control u_1 and its adjoint rho: the control that minimises the squared distance of
the mode insertion gradient to the wanted descent alpha_d, and its own effort. The whole schedule is saturated and taken
in part, u_1 + s (u* - u_1) with s = 1, 0.55, 0.55^2, ..., the first that lowers J. The result is the next iteration's
nominal control. Unlike iLQR it follows no curvature: it inverts the pendulum, but does not mind where the cart ends.
Sources: the paper, Algorithm 1 and its note; Ansari, Murphey, "Sequential action control", IEEE T-RO 2016.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from shared_control.controllers.receding import Receding
from shared_control.controllers.sac_kernels import search
from shared_control.cost import QuadraticCost
from shared_control.dispatch import bound
from shared_control.integrate import store_size
from shared_control.parameters import ParameterError
from shared_control.tasks.task import Task

__all__ = ["Sac"]


class Sac(Receding):
    """See the module. ``gamma`` < 0 is the rate of descent, ``tries`` the step lengths that are tried."""

    def __init__(
        self, task: Task, cost: QuadraticCost, *, gamma: float = -15.0, tries: int = 7, **options: Any
    ) -> None:
        super().__init__(task, cost, **options)
        if not (math.isfinite(gamma) and gamma < 0.0) or tries < 1:
            raise ParameterError(
                f"sac: gamma {gamma!r}, {tries!r} tries; gamma must be finite and below 0, tries at least 1"
            )
        self._gamma, self._tries = float(gamma), int(tries)
        self._store = np.zeros(store_size(task, 1))
        self._wanted = np.zeros_like(self._us)
        self._kernel = bound(search)

    def _search(self) -> tuple[float, int, bool]:
        found: tuple[float, int, bool] = self._kernel(
            self._p, self._c, self._x, self._us, self._limits, self._h, self._iterations, self._tolerance,
            self._gamma, self._tries, self._xs, self._us_new, self._xs_new, self._store, self._wanted,
        )  # fmt: skip
        return found
