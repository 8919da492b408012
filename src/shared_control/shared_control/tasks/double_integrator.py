"""A cart to be brought to the origin: the smallest task there is. ``docs/new-task.md`` walks through this file.

    x'' = u

State ``[x, x_dot]``, control ``u`` an acceleration.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from shared_control.scene import constant, state
from shared_control.tasks.task import Array, Bound, EndEffectorMotion, Robot, Task


class DoubleIntegratorParameters(NamedTuple):
    """Physical parameters."""

    gain: float = 1.0  # acceleration for each unit of control


def flow(p: DoubleIntegratorParameters, x: tuple[float, ...], u: tuple[float, ...]) -> tuple[float, ...]:
    """f(x, u)."""
    return (x[1], p.gain * u[0])


def linearise(
    p: DoubleIntegratorParameters, x: tuple[float, ...], u: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """f(x, u), and d = (dx''/du)."""
    return (x[1], p.gain * u[0]), (p.gain,)


def partials(p: DoubleIntegratorParameters) -> tuple[float, ...]:
    """Zeros in place of d."""
    return (0.0,)


def pullback(
    p: DoubleIntegratorParameters, d: tuple[float, ...], w: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """(w^T df/dx, w^T df/du)."""
    return (0.0, w[0]), (d[0] * w[1],)


class DoubleIntegrator(Task):
    """Bring the cart to the origin and keep it there."""

    name = "double_integrator"
    state_names = ("x", "x_dot")
    state_units = ("m", "m/s")
    control_names = ("acceleration",)
    control_units = ("m/s^2",)
    angles = (False, False)
    state_weights = (10.0, 1.0)
    control_weights = (0.1,)
    terminal_weights = (0.0, 0.0)
    target = (0.0, 0.0)
    control_limits = (5.0,)
    noise_sd = (5.0,)
    success_dwell = 2.0
    parameter_type = DoubleIntegratorParameters
    parameter_bounds: ClassVar[dict[str, Bound]] = {
        "gain": Bound("1", "acceleration for each unit of control", 0.0, True),
    }

    @property
    def initial_state(self) -> Array:
        """At rest, one metre away."""
        return np.array([1.0, 0.0])

    def success_region(self, x: Array) -> bool:
        """|x| <= 0.1 m and |x_dot| <= 0.1 m/s."""
        return bool(abs(x[0]) <= 0.1 and abs(x[1]) <= 0.1)

    def failure(self, x: Array) -> bool:
        """There is no end to the track."""
        return False

    def scene(self, target: Sequence[float]) -> dict[str, Any]:
        """The cart at (x, 0), and where it must come to."""
        return {
            "points": {"cart": [state(0), constant(0.0)]},
            "shapes": [
                {"shape": "ground", "height": 0.0},
                {"shape": "mark", "x": target[0], "height": 0.0, "role": "target"},
                {"shape": "cart", "at": "cart", "width": 0.2, "height": 0.1},
            ],
            "view": {"follow": state(0), "slack": 1.5, "height": 2.0, "bottom": -0.8},
            "hand": {"at": "cart", "spring": {"position": 0, "velocity": 1}},
            "plot": 0,
        }

    def control_from_motion(self, motion: EndEffectorMotion, robot: Robot, force: Array | None = None) -> Array:
        """u = x'' of the end effector, mean over the sample."""
        return np.array([motion.acceleration[0]])

    def control_from_wrench(self, force: Array, robot: Robot) -> Array:
        """u = f_x / m."""
        return np.array([force[0] / robot.mass])

    def wrench_from_control(self, u: Array, robot: Robot) -> Array:
        """f = (m u, 0, 0)."""
        return np.array([robot.mass * u[0], 0.0, 0.0])
