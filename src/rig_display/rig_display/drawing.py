"""What to draw of a task, as data for the page: points made of states, shapes at points, the view.

    coordinate = sum of gain * g(state),   g one of 1, value, sin, cos

A task that has no description here is shown as one bar for each state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from shared_control.tasks.cart_pendulum import CartPendulum
from shared_control.tasks.slip import Slip
from shared_control.tasks.task import Task

__all__ = ["scene"]

Coordinate = list[list[Any]]


def _constant(value: float) -> Coordinate:
    return [[value, -1, "one"]]


def _state(index: int, gain: float = 1.0, of: str = "value") -> Coordinate:
    return [[gain, index, of]]


def _cart_pendulum(task: CartPendulum, target: Sequence[float]) -> dict[str, Any]:
    """The bob at (x_c + h sin(theta), h cos(theta)), the cart at (x_c, 0)."""
    length, track = task.parameters.length, task.parameters.track
    shapes: list[dict[str, Any]] = [
        {
            "shape": "sector",
            "at": "cart",
            "radius": 1.12 * length,
            "middle": target[0],
            "half": task.success_angle,
            "role": "success",
        },
        {"shape": "ground", "height": 0.0},
        {"shape": "mark", "x": target[2], "height": 0.0, "role": "target"},
        {"shape": "cart", "at": "cart", "width": 0.28 * length, "height": 0.14 * length},
        {"shape": "rod", "from": "cart", "to": "bob", "width": 0.035 * length},
        {"shape": "disc", "at": "bob", "radius": 0.1 * length},
    ]
    if track > 0.0:
        shapes[2:2] = [{"shape": "stop", "x": x, "height": 0.0} for x in (-track, track)]
    return {
        "points": {
            "cart": [_state(2), _constant(0.0)],
            "bob": [_state(2) + _state(0, length, "sin"), _state(0, length, "cos")],
        },
        "shapes": shapes,
        "view": {"follow": _state(2), "slack": 1.2 * length, "height": 3.0 * length, "bottom": -1.45 * length},
        "hand": {"at": "cart", "spring": {"position": 2, "velocity": 3}},
        "plot": 0,
    }


def _slip(task: Slip, target: Sequence[float]) -> dict[str, Any]:
    """The mass at (x_m, z_m), the leg towards the foot's place (x_t, 0), never longer than at rest."""
    rest, fall = task.parameters.rest_length, task.parameters.fall_height
    return {
        "points": {
            "mass": [_state(0), _state(2)],
            "foot": [_state(4), _constant(0.0)],
        },
        "shapes": [
            {"shape": "band", "bottom": fall, "top": 4.0 * rest, "role": "success"},
            {"shape": "ground", "height": 0.0},
            {"shape": "level", "height": target[2], "role": "target"},
            {"shape": "spring", "from": "mass", "to": "foot", "rest": rest, "width": 0.12 * rest},
            {"shape": "disc", "at": "mass", "radius": 0.14 * rest},
        ],
        "view": {"follow": _state(0), "slack": 0.0, "height": 2.4 * rest, "bottom": -0.35 * rest},
        "hand": {"at": "mass"},
        "plot": 2,
    }


def _bars(task: Task, target: Sequence[float]) -> dict[str, Any]:
    """One bar for each state, with its name, unit and target."""
    return {"bars": True, "target": list(target), "plot": 0}


_SCENES: dict[str, Callable[[Any, Sequence[float]], dict[str, Any]]] = {
    CartPendulum.name: _cart_pendulum,
    Slip.name: _slip,
}


def scene(task: Task, target: Sequence[float] = ()) -> dict[str, Any]:
    """The description of a task's picture; `target` as the filter has it, empty: the task's."""
    return _SCENES.get(task.name, _bars)(task, tuple(target) or task.target)
