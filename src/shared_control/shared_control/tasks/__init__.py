"""Registry of the tasks: one line for each, one file behind it."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Sequence

from shared_control.parameters import ParameterError
from shared_control.tasks.task import Robot, Task

__all__ = ["Robot", "Task", "get", "get_from_text", "names", "parse"]

#: Name of the task: its module and its class. Imported when asked for: no task costs a process that runs another.
_REGISTRY: dict[str, tuple[str, str]] = {
    "cart_pendulum": ("shared_control.tasks.cart_pendulum", "CartPendulum"),
    "double_integrator": ("shared_control.tasks.double_integrator", "DoubleIntegrator"),
    "slip": ("shared_control.tasks.slip", "Slip"),
}


def names() -> tuple[str, ...]:
    """Names of the registered tasks."""
    return tuple(_REGISTRY)


def get(name: str, **parameters: float) -> Task:
    """The task of this name; ``parameters`` override its physical ones.

    Raises
    ------
    ParameterError: no such task, no such parameter, or a value out of its range.
    """
    if name not in _REGISTRY:
        near = difflib.get_close_matches(name, _REGISTRY, n=1)
        hint = f"did you mean {near[0]}?" if near else "known: " + ", ".join(_REGISTRY)
        raise ParameterError(f"task: {name!r} is not known; {hint}")
    module, cls = _REGISTRY[name]
    task: Task = getattr(importlib.import_module(module), cls)(**parameters)
    return task


def parse(parameters: Sequence[str]) -> dict[str, float]:
    """Parameters from ``name=value`` texts.

    Raises
    ------
    ParameterError: a text that is not ``name=number``.
    """
    values = {}
    for text in parameters:
        key, equals, number = text.partition("=")
        try:
            values[key.strip()] = float(number)
        except ValueError:
            equals = ""
        if not equals:
            raise ParameterError(f"task_parameters: {text!r} is not allowed; it must be name=number, as in length=2.0")
    return values


def get_from_text(name: str, parameters: Sequence[str]) -> Task:
    """As :func:`get`, with parameters as ``name=value`` texts.

    Raises
    ------
    ParameterError: as :func:`get` and :func:`parse`.
    """
    return get(name, **parse(parameters))
