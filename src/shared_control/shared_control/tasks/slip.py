"""Balance of a spring-loaded inverted pendulum (SLIP): a mass on a springy leg whose foot does not slip.

    stance   x_m'' = F (x_m - x_t),  z_m'' = F z_m - g,  x_t' = 0,    F = (k (l_0 - l_s) + u_s) / (m l_s)
    flight   x_m'' = 0,              z_m'' = -g,         x_t' = x_m' + u_t
    fallen   nothing moves

with l_s = sqrt((x_m - x_t)^2 + z_m^2). State ``[x_m, x_m_dot, z_m, z_m_dot, x_t]``, control ``[u_s, u_t]``: thrust of
the leg, which acts in stance, and velocity of the toe relative to the mass, which acts in flight.

Touchdown is where the leg is no longer than at rest while the mass sinks, lift-off where it is no shorter while the
mass rises, as in the laboratory's code. Each mode holds while its guard is positive,

    flight  g = max(l_s - l_0, z_m'),        stance  g = max(l_0 - l_s, -z_m'),

zero where the paper's guard is meant to be, phi = z_m (1 - l_0/l_s) (it prints x_m for the first z_m, and would then
depend on where the origin is), without phi's other zero at z_m = 0; the reset is the identity. The two modes overlap: a
foot that swings forward under a rising mass does not touch, and one that the mass leaves behind while it sinks stays.
The mode is therefore part of what a trial hands on from sample to sample. Where only a state is given, the leg stands
if it is shorter than at rest. (Were that the rule everywhere, noise at the toe would drag the foot along the ground
after each lift-off, and trials of noise with assistance would end in a fall.) A mass at ``fall_height`` or below has
fallen and stays where it is.

The paper says k = l_0 = m = 1. With g = 9.81 m/s^2 no such leg carries its mass: the spring's largest force, k l_0 =
1 N, is below the weight. The default is the k = 100 N/m of the laboratory's public code; ``stiffness=1`` is the paper's
literal text, which falls whatever the user does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from shared_control.parameters import ParameterError
from shared_control.scene import constant, state
from shared_control.tasks.task import Array, Bound, EndEffectorMotion, Robot, Task

FLIGHT, STANCE, FALLEN = 0, 1, 2
#: A leg is never computed shorter than this part of its rest length, where its direction is lost.
SHORTEST = 1e-3


class SlipParameters(NamedTuple):
    """Physical parameters."""

    mass: float = 1.0  # [kg] m
    stiffness: float = 100.0  # [N/m] k
    rest_length: float = 1.0  # [m] l_0
    gravity: float = 9.81  # [m/s^2] g
    fall_height: float = 0.0  # [m] at or below which the mass has fallen


class SlipInMode(NamedTuple):
    """The parameters, and the mode in which flow and guard are meant."""

    physics: SlipParameters
    mode: int


def mode(p: SlipParameters, before: int, x: tuple[float, ...]) -> int:
    """Mode in force at a state that was reached in mode ``before`` (negative: unknown)."""
    if x[2] <= p.fall_height:
        return FALLEN
    if before in (FLIGHT, STANCE):
        return before
    return STANCE if math.sqrt((x[0] - x[4]) ** 2 + x[2] ** 2) < p.rest_length else FLIGHT


def in_mode(p: SlipParameters, mode: int) -> SlipInMode:
    """The parameters in a mode."""
    return SlipInMode(p, mode)


def next_mode(q: SlipInMode) -> int:
    """Touchdown and lift-off."""
    return STANCE if q.mode == FLIGHT else FLIGHT


def guard(q: SlipInMode, x: tuple[float, ...]) -> float:
    """max(l_s - l_0, z_m') in flight, max(l_0 - l_s, -z_m') in stance."""
    if q.mode == FALLEN:
        return 1.0
    above = math.sqrt((x[0] - x[4]) ** 2 + x[2] ** 2) - q.physics.rest_length
    return max(above, x[3]) if q.mode == FLIGHT else max(-above, -x[3])


def guard_gradient(q: SlipInMode, x: tuple[float, ...]) -> tuple[float, ...]:
    """Gradient of :func:`guard`: the direction of the leg, or of the mass's motion, whichever decides."""
    if q.mode == FALLEN:
        return (0.0, 0.0, 0.0, 0.0, 0.0)
    along = x[0] - x[4]
    leg = math.sqrt(along**2 + x[2] ** 2)
    sign = 1.0 if q.mode == FLIGHT else -1.0
    if sign * x[3] >= sign * (leg - q.physics.rest_length):
        return (0.0, 0.0, 0.0, sign, 0.0)
    scale = sign * max(leg, SHORTEST * q.physics.rest_length)
    return (along / scale, 0.0, x[2] / scale, 0.0, -along / scale)


def flow(q: SlipInMode, x: tuple[float, ...], u: tuple[float, ...]) -> tuple[float, ...]:
    """f(x, u)."""
    p = q.physics
    if q.mode == FALLEN:
        return (0.0, 0.0, 0.0, 0.0, 0.0)
    if q.mode == FLIGHT:
        return (x[1], 0.0, x[3], -p.gravity, x[1] + u[1])
    along = x[0] - x[4]
    leg = max(math.sqrt(along**2 + x[2] ** 2), SHORTEST * p.rest_length)
    push = (p.stiffness * (p.rest_length - leg) + u[0]) / (p.mass * leg)
    return (x[1], push * along, x[3], push * x[2] - p.gravity, 0.0)


def linearise(q: SlipInMode, x: tuple[float, ...], u: tuple[float, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """f(x, u), and d = (dx''/dx, dx''/dz = dz''/dx, dz''/dz, dx''/du_s, dz''/du_s), zero but in stance."""
    p = q.physics
    if q.mode == FALLEN:
        return (0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0)
    if q.mode == FLIGHT:
        return (x[1], 0.0, x[3], -p.gravity, x[1] + u[1]), (0.0, 0.0, 0.0, 0.0, 0.0)
    along = x[0] - x[4]
    leg = max(math.sqrt(along**2 + x[2] ** 2), SHORTEST * p.rest_length)
    push = (p.stiffness * (p.rest_length - leg) + u[0]) / (p.mass * leg)
    f = (x[1], push * along, x[3], push * x[2] - p.gravity, 0.0)
    # d push / d leg, over leg
    softer = -(p.stiffness * p.rest_length + u[0]) / (p.mass * leg * leg * leg)
    return f, (
        push + softer * along * along,
        softer * along * x[2],
        push + softer * x[2] * x[2],
        along / (p.mass * leg),
        x[2] / (p.mass * leg),
    )


def partials(q: SlipInMode) -> tuple[float, ...]:
    """Zeros in place of d."""
    return (0.0, 0.0, 0.0, 0.0, 0.0)


def pullback(q: SlipInMode, d: tuple[float, ...], w: tuple[float, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """(w^T df/dx, w^T df/du)."""
    if q.mode == FALLEN:
        return (0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0)
    if q.mode == FLIGHT:
        return (0.0, w[0] + w[4], 0.0, w[2], 0.0), (0.0, w[4])
    to_x = d[0] * w[1] + d[1] * w[3]
    return (to_x, w[0], d[1] * w[1] + d[2] * w[3], w[2], -to_x), (d[3] * w[1] + d[4] * w[3], 0.0)


class Slip(Task):
    """The paper's second task: keep the mass up, whatever the user does with thrust and toe."""

    name = "slip"
    state_names = ("x_m", "x_m_dot", "z_m", "z_m_dot", "x_t")
    state_units = ("m", "m/s", "m", "m/s", "m")
    control_names = ("thrust", "toe_velocity")
    control_units = ("N", "m/s")
    angles = (False, False, False, False, False)
    #: Height only: the filter knows nothing of the speed that the user wants.
    state_weights = (0.0, 0.0, 50.0, 0.0, 0.0)
    control_weights = (0.01, 0.05)
    terminal_weights = (0.0, 0.0, 0.0, 0.0, 0.0)
    target = (0.0, 0.0, 1.3, 0.0, 0.0)
    control_limits = (20.0, 5.0)
    noise_sd = (20.0, 10.0)
    #: Upright for as long as the paper's trials last.
    success_dwell = 30.0
    parameter_type = SlipParameters
    parameter_bounds: ClassVar[dict[str, Bound]] = {
        "mass": Bound("kg", "mass", 0.0, True),
        "stiffness": Bound("N/m", "spring constant of the leg", 0.0, False),
        "rest_length": Bound("m", "length of the leg at rest", 0.0, True),
        "gravity": Bound("m/s^2", "acceleration of gravity", 0.0, False),
        "fall_height": Bound("m", "height at or below which the mass has fallen", 0.0, False),
    }

    @property
    def initial_state(self) -> Array:
        """In flight above its foot at 0.8 m/s."""
        return np.array([0.0, 0.8, 1.2 * self.parameters.rest_length, 0.0, 0.0])

    def success_region(self, x: Array) -> bool:
        """Not fallen."""
        return not self.failure(x)

    def failure(self, x: Array) -> bool:
        """The mass is at ``fall_height`` or below."""
        return bool(x[2] <= self.parameters.fall_height)

    def mode(self, x: Array) -> int:
        """FLIGHT, STANCE or FALLEN, of a state whose history is not known."""
        return mode(self.parameters, -1, tuple(x))

    def scene(self, target: Sequence[float]) -> dict[str, Any]:
        """The mass at (x_m, z_m), the leg towards the foot's place (x_t, 0), never longer than at rest."""
        rest, fall = self.parameters.rest_length, self.parameters.fall_height
        return {
            "points": {"mass": [state(0), state(2)], "foot": [state(4), constant(0.0)]},
            "shapes": [
                {"shape": "band", "bottom": fall, "top": 4.0 * rest, "role": "success"},
                {"shape": "ground", "height": 0.0},
                {"shape": "level", "height": target[2], "role": "target"},
                {"shape": "spring", "from": "mass", "to": "foot", "rest": rest, "width": 0.12 * rest},
                {"shape": "disc", "at": "mass", "radius": 0.14 * rest},
            ],
            "view": {"follow": state(0), "slack": 0.0, "height": 2.4 * rest, "bottom": -0.35 * rest},
            "hand": {"at": "mass"},
            "plot": 2,
        }

    def check_robot(self, robot: Robot) -> None:
        """The toe follows a velocity, which a robot without damping does not tie to a force.

        Raises
        ------
        ParameterError: no damping.
        """
        if not robot.damping > 0.0:
            raise ParameterError(
                f"robot_damping: {robot.damping!r} is not allowed; slip takes the toe's velocity as f_x / b, b above 0"
            )

    def control_from_motion(self, motion: EndEffectorMotion, robot: Robot, force: Array | None = None) -> Array:
        """u_s = f_z as admitted, u_t = velocity of the end effector along x at the end of the sample.

        With m << b t_s that velocity is f_x / b: for the shipped scenarios to the last bit.
        """
        return np.array([0.0 if force is None else force[2], motion.velocity[0]])

    def control_from_wrench(self, force: Array, robot: Robot) -> Array:
        """u_s = f_z, u_t = f_x / b."""
        return np.array([force[2], force[0] / robot.damping])

    def wrench_from_control(self, u: Array, robot: Robot) -> Array:
        """f = (b u_t, 0, u_s)."""
        return np.array([robot.damping * u[1], 0.0, u[0]])
