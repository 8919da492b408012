"""What to draw of a task, as data: points made of states, shapes at points, the view. Plane; x right, z up [m].

    coordinate = sum of gain * g(state),   g one of 1, value, sin, cos

A task describes its picture (:meth:`shared_control.tasks.task.Task.scene`); the page and the markers draw it. Shapes:

``cart`` (at, width, height), ``disc`` (at, radius), ``rod`` (from, to, width), ``spring`` (from, to, rest, width);
``ground`` (height), ``level`` (height), ``mark`` and ``stop`` (x, height), ``band`` (bottom, top), ``sector`` (at,
radius, middle and half an angle from the vertical [rad]). ``role`` says what one is for: ``success`` or ``target``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

__all__ = ["Coordinate", "bars", "constant", "evaluate", "state"]

#: Terms: gain, index of the state (negative: none), name of g.
Coordinate = list[list[Any]]

_OF = {"one": lambda value: 1.0, "value": float, "sin": math.sin, "cos": math.cos}


def constant(value: float) -> Coordinate:
    """A coordinate that no state moves."""
    return [[value, -1, "one"]]


def state(index: int, gain: float = 1.0, of: str = "value") -> Coordinate:
    """gain * g(state). Coordinates are added as lists are."""
    return [[gain, index, of]]


def evaluate(coordinate: Coordinate, x: Sequence[float]) -> float:
    """The coordinate at a state (n,) [m]."""
    return sum(float(gain * _OF[of](0.0 if index < 0 else x[index])) for gain, index, of in coordinate)


def bars(target: Sequence[float]) -> dict[str, Any]:
    """The picture of a task that describes none: one bar for each state, with its target."""
    return {"bars": True, "target": list(target), "plot": 0}
