"""What a task is: everything that filter, controllers, users, nodes and analysis know of it.

A task is one module. It holds a NamedTuple of its parameters and, as plain Python functions on tuples, its mathematics:

``flow(p, x, u)``
    ``dx/dt = f(x, u)``, a tuple of n.
``linearise(p, x, u)``
    ``(f(x, u), d)``: the flow, and a tuple ``d`` of the partial derivatives there that are not constant.
``partials(p)``
    Zeros, as many as ``d`` has elements.
``pullback(p, d, w)``
    ``(w^T df/dx, w^T df/du)``: tuples of n and of m, from the ``d`` of :func:`linearise`.

A hybrid task has a second NamedTuple in the same module, its parameters in a mode ``q``. The functions above take ``q``
in place of ``p``, and there are more of them (:mod:`shared_control.hybrid` says what is made of them):

``mode(p, before, x)``, ``in_mode(p, mode)``, ``next_mode(q)``
    The mode in force at a state that was reached in a mode (an integer; negative: unknown); the parameters in a mode;
    the mode that follows an event.
``guard(q, x)``, ``guard_gradient(q, x)``
    A number that is positive while the mode holds, and its gradient.

These functions are found through the type of the NamedTuple (see :mod:`shared_control.dispatch`), compiled into every
kernel that needs them, and remain callable as they are. They may use :mod:`math`, arithmetic and branches, nothing
else. Beside them stands a subclass of :class:`Task`, the description for everyone else.
"""

from __future__ import annotations

import difflib
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from shared_control.parameters import ParameterError
from shared_control.scene import bars

Array = NDArray[np.float64]

#: Default sampling time of the loop [s].
SAMPLE_TIME = 0.01


class Robot(NamedTuple):
    """The admittance model M(s) = 1/(mass s + damping) that stands between wrench and motion."""

    # 2 kg: light enough for a hand, and a power of two, so that force and acceleration convert without rounding.
    mass: float = 2.0  # [kg] apparent mass
    damping: float = 0.0  # [N s/m]


class EndEffectorMotion(Protocol):
    """Motion of the end effector over one sample, SI, x along the cart's path."""

    @property
    def velocity(self) -> Array: ...

    @property
    def acceleration(self) -> Array: ...


class Bound(NamedTuple):
    """Unit, description and least value of a physical parameter."""

    unit: str
    description: str
    least: float
    open: bool  # whether the least value itself is excluded


class Task(ABC):
    """Description of a task. Subclasses set the class variables and the maps between wrench, motion and control."""

    name: ClassVar[str]
    state_names: ClassVar[tuple[str, ...]]
    state_units: ClassVar[tuple[str, ...]]
    control_names: ClassVar[tuple[str, ...]]
    control_units: ClassVar[tuple[str, ...]]
    #: Which states are angles: compared modulo a full turn.
    angles: ClassVar[tuple[bool, ...]]
    #: Defaults of the objective (see shared_control.cost), of the controller's limits and of the noise user.
    state_weights: ClassVar[tuple[float, ...]]
    control_weights: ClassVar[tuple[float, ...]]
    terminal_weights: ClassVar[tuple[float, ...]]
    target: ClassVar[tuple[float, ...]]
    control_limits: ClassVar[tuple[float, ...]]
    noise_sd: ClassVar[tuple[float, ...]]
    #: How long the state must stay in the success region [s].
    success_dwell: ClassVar[float]
    #: The NamedTuple of physical parameters and, by name, what is known of each.
    parameter_type: ClassVar[Any]
    parameter_bounds: ClassVar[dict[str, Bound]]

    def __init__(self, **parameters: float) -> None:
        known = self.parameter_bounds
        for key, value in parameters.items():
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {near[0]}?" if near else "known: " + ", ".join(known)
                raise ParameterError(f"{self.name}: unknown task parameter {key} = {value!r}; {hint}")
            bound = known[key]
            below = value <= bound.least if bound.open else value < bound.least
            if not math.isfinite(value) or below:
                relation = "greater than" if bound.open else "at least"
                raise ParameterError(
                    f"{self.name}: task parameter {key} = {value!r} is not allowed; "
                    f"it must be finite and {relation} {bound.least:g} [{bound.unit}]"
                )
        self.parameters = self.parameter_type(**{key: float(value) for key, value in parameters.items()})

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.state_names)

    @property
    def m(self) -> int:
        """Number of controls."""
        return len(self.control_names)

    @property
    @abstractmethod
    def initial_state(self) -> Array:
        """State at the start of a trial, (n,)."""

    @abstractmethod
    def success_region(self, x: Array) -> bool:
        """Whether the state lies where it must stay for ``success_dwell`` to succeed."""

    @abstractmethod
    def failure(self, x: Array) -> bool:
        """Whether the trial has failed beyond return."""

    def mode(self, x: Array) -> int:
        """Hybrid mode of a state whose history is not known, 0 where the task has only one.

        Wherever a state is taken, ``task_mode`` may say what is known better.
        """
        return 0

    def scene(self, target: Sequence[float]) -> dict[str, Any]:
        """What to draw, with the wanted state (n,), as :mod:`shared_control.scene` says; by itself, bars."""
        return bars(target)

    def check_robot(self, robot: Robot) -> None:  # noqa: B027 - most tasks can use any
        """Whether the task's maps work with this robot; any, unless a task says otherwise.

        Raises
        ------
        ParameterError: they do not.
        """

    @abstractmethod
    def control_from_motion(self, motion: EndEffectorMotion, robot: Robot, force: Array | None = None) -> Array:
        """Control (m,) that the task takes from the end effector's motion over one sample.

        ``force`` is the admitted force (3,) [N], for tasks that feel the force itself.
        """

    @abstractmethod
    def control_from_wrench(self, force: Array, robot: Robot) -> Array:
        """Control (m,) that a force (3,) [N] amounts to through the ideal robot."""

    @abstractmethod
    def wrench_from_control(self, u: Array, robot: Robot) -> Array:
        """Force (3,) [N] that amounts to a control (m,) through the ideal robot."""
