"""The objective, for the criterion and for the controllers.

    J = 1/2 int ( |x - x_d|_Q^2 + |u|_R^2 ) dt + 1/2 |x(T) - x_d|_P^2

with diagonal Q, R, P and the errors of angles wrapped to (-pi, pi], in the value and in the gradient. On the samples of
the loop the state's part is summed by the trapezoid rule (nodes 0 and N count half), the control's part is exact, since
a control is held over its sample. Source: the paper, 'The Evaluation Criterion'; the wrap as in the laboratory's code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from shared_control.parameters import ParameterError
from shared_control.tasks.task import Task
from shared_control.tuples import Vector, dot, times

__all__ = [
    "QuadraticCost",
    "effort",
    "errors",
    "quadratic",
    "running",
    "running_gradient",
    "terminal",
    "terminal_gradient",
    "wrap",
]

TURN = 2.0 * math.pi


class QuadraticCost(NamedTuple):
    """Weights and target of the quadratic objective."""

    state_weights: Vector  # diagonal of Q, (n,)
    control_weights: Vector  # diagonal of R, (m,)
    terminal_weights: Vector  # diagonal of P, (n,)
    target: Vector  # x_d, (n,)
    angles: tuple[bool, ...]  # which states are angles, (n,)


def wrap(angle: float) -> float:
    """The angle in (-pi, pi] that is equal to this one modulo a full turn."""
    if -math.pi < angle <= math.pi:
        return angle
    # Through the magnitude, so that wrap(-a) = -wrap(a) to the last bit (but at the ends).
    rest = abs(angle) % TURN
    if rest > math.pi:
        rest -= TURN
    if angle > 0.0 or rest == math.pi:
        return rest
    return -rest


def errors(x: Vector, target: Vector, angles: tuple[bool, ...]) -> Vector:
    """x - x_d, angles wrapped."""
    return tuple(wrap(x[i] - target[i]) if angles[i] else x[i] - target[i] for i in range(len(x)))


def running(c: QuadraticCost, x: Vector) -> float:
    """1/2 |x - x_d|_Q^2, the state's part of the integrand."""
    e = errors(x, c.target, c.angles)
    return 0.5 * dot(times(c.state_weights, e), e)


def running_gradient(c: QuadraticCost, x: Vector) -> Vector:
    """Q (x - x_d)."""
    return times(c.state_weights, errors(x, c.target, c.angles))


def effort(c: QuadraticCost, u: Vector) -> float:
    """1/2 |u|_R^2, the control's part of the integrand."""
    return 0.5 * dot(times(c.control_weights, u), u)


def terminal(c: QuadraticCost, x: Vector) -> float:
    """1/2 |x - x_d|_P^2."""
    e = errors(x, c.target, c.angles)
    return 0.5 * dot(times(c.terminal_weights, e), e)


def terminal_gradient(c: QuadraticCost, x: Vector) -> Vector:
    """P (x - x_d)."""
    return times(c.terminal_weights, errors(x, c.target, c.angles))


def quadratic(
    task: Task,
    state_weights: Sequence[float] = (),
    control_weights: Sequence[float] = (),
    terminal_weights: Sequence[float] = (),
    target: Sequence[float] = (),
) -> QuadraticCost:
    """The objective for a task; what is left empty is the task's own default.

    Raises
    ------
    ParameterError: a wrong number of elements, a negative or non-finite weight, or a non-finite target.
    """

    def vector(name: str, given: Sequence[float], default: Vector, least: float) -> Vector:
        values = tuple(float(value) for value in (given if len(given) else default))
        if len(values) != len(default) or not all(math.isfinite(value) and value >= least for value in values):
            bound = " and not negative" if least == 0.0 else ""
            raise ParameterError(
                f"{name}: {list(values)} is not allowed; {task.name} needs {len(default)} elements, finite{bound}"
            )
        return values

    return QuadraticCost(
        vector("state_weights", state_weights, task.state_weights, 0.0),
        vector("control_weights", control_weights, task.control_weights, 0.0),
        vector("terminal_weights", terminal_weights, task.terminal_weights, 0.0),
        vector("target", target, task.target, -math.inf),
        task.angles,
    )
