"""Cart-pendulum inversion.

    theta''  = (g/h) sin(theta) - B/(m h^2) theta' - (u/h) cos(theta)
    x_c''    = u

State ``[theta, theta_dot, x_c, x_c_dot]``, control ``u`` the acceleration of the cart. The one sign convention of the
whole rig: theta = 0 upright, and a positive acceleration of the cart makes an upright pendulum fall towards negative
theta (so theta counts positive towards positive x_c, where the bob is at ``(x_c + h sin(theta), h cos(theta))``).

Source: the paper's Methods; parameter values from the laboratory's public code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from shared_control.cost import wrap
from shared_control.scene import constant, state
from shared_control.tasks.task import Array, Bound, EndEffectorMotion, Robot, Task


class CartPendulumParameters(NamedTuple):
    """Physical parameters."""

    mass: float = 0.1  # [kg] m, of the bob
    damping: float = 0.1  # [N m s/rad] B, of the pivot
    gravity: float = 9.81  # [m/s^2] g
    length: float = 2.0  # [m] h
    track: float = 0.0  # [m] half-length of the track, 0 for an endless one


def flow(p: CartPendulumParameters, x: tuple[float, ...], u: tuple[float, ...]) -> tuple[float, ...]:
    """f(x, u)."""
    friction = p.damping / (p.mass * p.length * p.length)
    pull, push = p.gravity / p.length, u[0] / p.length
    return (x[1], pull * math.sin(x[0]) - push * math.cos(x[0]) - friction * x[1], x[3], u[0])


def linearise(
    p: CartPendulumParameters, x: tuple[float, ...], u: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """f(x, u), and d = (d theta''/d theta, d theta''/du)."""
    s = math.sin(x[0])
    c = math.cos(x[0])
    friction = p.damping / (p.mass * p.length * p.length)
    # Divided before the sine is known: a chain of nodes waits for each of its operations.
    pull, push, lever = p.gravity / p.length, u[0] / p.length, 1.0 / p.length
    f = (x[1], pull * s - push * c - friction * x[1], x[3], u[0])
    return f, (pull * c + push * s, -c * lever)


def partials(p: CartPendulumParameters) -> tuple[float, ...]:
    """Zeros in place of d."""
    return (0.0, 0.0)


def pullback(
    p: CartPendulumParameters, d: tuple[float, ...], w: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """(w^T df/dx, w^T df/du)."""
    friction = p.damping / (p.mass * p.length * p.length)
    return (d[0] * w[1], w[0] - friction * w[1], 0.0, w[2]), (d[1] * w[1] + w[3],)


class CartPendulum(Task):
    """The paper's task: swing the pendulum up and keep it there, with the acceleration of the cart."""

    name = "cart_pendulum"
    state_names = ("theta", "theta_dot", "x_c", "x_c_dot")
    state_units = ("rad", "rad/s", "m", "m/s")
    control_names = ("cart_acceleration",)
    control_units = ("m/s^2",)
    angles = (True, False, False, False)
    state_weights = (200.0, 0.0, 20.0, 1.0)
    control_weights = (0.3,)
    terminal_weights = (0.0, 0.0, 0.0, 0.0)
    target = (0.0, 0.0, 0.0, 0.0)
    control_limits = (20.0,)
    noise_sd = (20.0,)
    success_dwell = 2.0
    #: The success region of the paper: |theta| [rad] and |theta_dot| [rad/s].
    success_angle = 0.4
    success_rate = 0.75
    parameter_type = CartPendulumParameters
    parameter_bounds: ClassVar[dict[str, Bound]] = {
        "mass": Bound("kg", "mass of the bob", 0.0, True),
        "damping": Bound("N m s/rad", "viscous friction of the pivot", 0.0, False),
        "gravity": Bound("m/s^2", "acceleration of gravity", 0.0, False),
        "length": Bound("m", "length of the pendulum", 0.0, True),
        "track": Bound("m", "half-length of the track, 0 for an endless one", 0.0, False),
    }

    @property
    def initial_state(self) -> Array:
        """Hanging at rest, theta = pi."""
        return np.array([math.pi, 0.0, 0.0, 0.0])

    def success_region(self, x: Array) -> bool:
        """|theta| <= 0.4 rad, wrapped, and |theta_dot| <= 0.75 rad/s."""
        return abs(wrap(float(x[0]))) <= self.success_angle and abs(float(x[1])) <= self.success_rate

    def failure(self, x: Array) -> bool:
        """The cart has left its track, where it has an end."""
        track: float = self.parameters.track
        return track > 0.0 and abs(float(x[2])) > track

    def scene(self, target: Sequence[float]) -> dict[str, Any]:
        """The bob at (x_c + h sin(theta), h cos(theta)), the cart at (x_c, 0)."""
        length, track = self.parameters.length, self.parameters.track
        success = {"at": "cart", "radius": 1.12 * length, "middle": target[0], "half": self.success_angle}
        stops = [{"shape": "stop", "x": x, "height": 0.0} for x in (-track, track) if track > 0.0]
        return {
            "points": {
                "cart": [state(2), constant(0.0)],
                "bob": [state(2) + state(0, length, "sin"), state(0, length, "cos")],
            },
            "shapes": [
                {"shape": "sector", **success, "role": "success"},
                {"shape": "ground", "height": 0.0},
                *stops,
                {"shape": "mark", "x": target[2], "height": 0.0, "role": "target"},
                {"shape": "cart", "at": "cart", "width": 0.28 * length, "height": 0.14 * length},
                {"shape": "rod", "from": "cart", "to": "bob", "width": 0.035 * length},
                {"shape": "disc", "at": "bob", "radius": 0.1 * length},
            ],
            "view": {"follow": state(2), "slack": 1.2 * length, "height": 3.0 * length, "bottom": -1.45 * length},
            "hand": {"at": "cart", "spring": {"position": 2, "velocity": 3}},
            "plot": 0,
        }

    def control_from_motion(
        self,
        motion: EndEffectorMotion,
        robot: Robot,
        force: Array | None = None,
    ) -> Array:
        """u = x'' of the end effector, mean over the sample."""
        return np.array([motion.acceleration[0]])

    def control_from_wrench(self, force: Array, robot: Robot) -> Array:
        """u = f_x / m."""
        return np.array([force[0] / robot.mass])

    def wrench_from_control(self, u: Array, robot: Robot) -> Array:
        """f = (m u, 0, 0)."""
        return np.array([robot.mass * u[0], 0.0, 0.0])
