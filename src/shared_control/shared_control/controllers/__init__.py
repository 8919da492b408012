"""Controllers that replace a rejected action: one protocol, a registry, one file each."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from shared_control.cost import QuadraticCost
from shared_control.parameters import ParameterError
from shared_control.tasks.task import SAMPLE_TIME, Array, Task

__all__ = ["Controller", "Solution", "make", "names"]


class Solution(NamedTuple):
    """What a controller found at one state."""

    control: Array  # (m,) for the coming sample; finite and within the limits, always
    usable: bool  # whether the schedule is finite and no dearer than where the search began
    converged: bool  # whether the search also met its tolerance (a real-time one may stop before)
    iterations: int  # iterations of the search
    cost: float  # J of the schedule


class Controller(Protocol):
    """A model predictive controller over a horizon of samples.

    It keeps its last valid schedule. :meth:`advance` is called once a tick, whether the controller was asked or not, so
    that the schedule ages with the trial.
    """

    @property
    def schedule(self) -> Array:
        """The last valid schedule from the present tick on, continued by zero, (N, m)."""

    def solve(self, x: Array, task_mode: int | None = None) -> Solution:
        """Search for a schedule from the state (n,) and a hybrid task's mode (None: the state's own).

        Where none is usable the control is :meth:`fallback`'s.
        """

    def aim(self, target: Sequence[float]) -> None:
        """Put another desired state (n,) in place of the objective's."""

    def fallback(self) -> Array:
        """Control (m,) of the last valid schedule for the present tick; zero where there is none or it has run out."""

    def advance(self) -> None:
        """A tick has passed."""

    def reset(self) -> None:
        """Forget every schedule."""


_REGISTRY: dict[str, tuple[str, str]] = {
    "ilqr": ("shared_control.controllers.ilqr", "Ilqr"),
    "sac": ("shared_control.controllers.sac", "Sac"),
}


def names() -> tuple[str, ...]:
    """Names of the registered controllers."""
    return tuple(_REGISTRY)


def make(name: str, task: Task, cost: QuadraticCost, *, dt: float = SAMPLE_TIME, **options: Any) -> Controller:
    """The controller of this name, for a task and an objective, at a sampling time ``dt`` [s].

    Raises
    ------
    ParameterError: no such controller, or an option that it refuses.
    """
    if name not in _REGISTRY:
        near = difflib.get_close_matches(name, _REGISTRY, n=1)
        hint = f"did you mean {near[0]}?" if near else "known: " + ", ".join(_REGISTRY)
        raise ParameterError(f"controller: {name!r} is not known; {hint}")
    module, cls = _REGISTRY[name]
    controller: Controller = getattr(importlib.import_module(module), cls)(task, cost, dt=dt, **options)
    return controller
