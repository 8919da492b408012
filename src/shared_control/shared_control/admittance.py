"""The admittance-controlled robot: a force becomes the motion of an end effector.

On each axis, with the measured force f, the reference velocity v_r and the velocity v of the end effector,

    M(s)    m v_r' + b v_r = f + f_H + f_g + f_s + f_w + m_a v'      (admittance model, pseudo-force m_a v')
    C(s)    v'' + 2 zeta w v' + w^2 v = w^2 v_r                      (velocity loop of the drive; v = v_r if w = 0)
    H(s)    f_H = -(K_h p + B_h v + M_h v')                          (involuntary impedance of the hand)
    f_s     -(K_s p + D_s v) on an axis that is held to the cart's path
    f_g     -(1 - support) weight of the arm, along z
    f_w     -(K_w d + D_w v) while it pushes back: d beyond a limit of the workspace

With C = 1 and H = 0 the apparent mass is m - m_a. The linear part is discretised exactly for forces that are held
(``scipy.signal.cont2discrete``) at 1 kHz; what is not linear (walls, limits of force and velocity) acts on those
samples. With nothing but M it is, in closed form over the whole sample h, with z = b h/m, phi = (1 - e^-z)/z,
psi = (z - 1 + e^-z)/z^2 and a_0 = (f - b v)/m,

    mean acceleration = phi a_0,    v <- v + h phi a_0,    p <- p + h v + h^2 psi a_0,

for b = 0 with a mean acceleration of f/m to the last bit. Source: the paper, Fig. 1 and 'Experimental Platform'.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared_control.parameters import ParameterError, parameter
from shared_control.tasks.task import SAMPLE_TIME, Array, Robot

__all__ = ["Admittance", "AdmittanceConfig", "Motion", "poles"]

#: Rate inside the robot [1/s].
INNER_RATE = 1000.0
#: A pole counts as unstable beyond this [1/s]: above rounding, far below any motion.
UNSTABLE = 1e-6
Z = 2


class Motion(NamedTuple):
    """Motion over one sample, each (3,): x along the cart's path, z up."""

    position: Array  # [m] at the end of the sample
    velocity: Array  # [m/s] at the end of the sample
    acceleration: Array  # [m/s^2] mean over the sample
    reference_velocity: Array  # [m/s] of the admittance model, at the end of the sample


@dataclasses.dataclass(frozen=True)
class AdmittanceConfig:
    """Parameters of the robot besides its apparent mass and damping, which are the loop's."""

    free_axes: tuple[bool, ...] = parameter(
        (True, False, False), "Which of x, y, z move; the others are held to the cart's path.", length=3
    )
    drive_frequency: float = parameter(
        0.0, "Natural frequency w/2pi of the drives' velocity loop; 0: ideal, C = 1.", unit="Hz", ge=0.0, le=200.0
    )
    drive_damping: float = parameter(0.7, "Damping ratio zeta of the velocity loop.", ge=0.01, le=10.0)
    feedback_mass: float = parameter(
        0.0, "m_a: acceleration times this is fed back as a force, which takes it off the apparent mass.", unit="kg",
        ge=0.0, le=1000.0,
    )  # fmt: skip
    hand_stiffness: float = parameter(0.0, "K_h of the hand's impedance.", unit="N/m", ge=0.0, le=1e5)
    hand_damping: float = parameter(0.0, "B_h of the hand's impedance.", unit="N s/m", ge=0.0, le=1e4)
    hand_mass: float = parameter(0.0, "M_h of the hand's impedance.", unit="kg", ge=0.0, le=100.0)
    spring_stiffness: float = parameter(
        0.0, "K_s of the springs on the held axes; 0: so stiff that they do not move.", unit="N/m", ge=0.0, le=1e5
    )
    spring_damping: float = parameter(0.0, "D_s of those springs.", unit="N s/m", ge=0.0, le=1e4)
    arm_weight: float = parameter(0.0, "Weight that the arm rests on the robot, along z.", unit="N", ge=0.0, le=500.0)
    support: float = parameter(1.0, "Share of that weight that the robot carries.", ge=0.0, le=1.0)
    design_limits: tuple[float, ...] = parameter(
        (), "Half-width of the workspace along x, y, z by the robot's design; empty: none.", unit="m", ge=0.0
    )
    investigator_limits: tuple[float, ...] = parameter(
        (), "As design_limits, set by the investigator; the narrower holds.", unit="m", ge=0.0
    )
    wall_stiffness: float = parameter(5000.0, "K_w at a limit.", unit="N/m", ge=0.0, le=1e5)
    wall_damping: float = parameter(50.0, "D_w at a limit.", unit="N s/m", ge=0.0, le=1e4)
    velocity_limit: float = parameter(0.0, "Largest speed on an axis; 0: none.", unit="m/s", ge=0.0)
    force_limit: float = parameter(0.0, "Largest force on an axis that counts; 0: none.", unit="N", ge=0.0)
    passive_up_to: float = parameter(
        0.0,
        "Frequency up to which the robot must not feed energy to the hand; 0: not asked. A drive that lags behind an "
        "undamped mass does so at any frequency.",
        unit="Hz",
        ge=0.0,
        le=500.0,
    )


def _system(config: AdmittanceConfig, robot: Robot, stiffness: float, damping: float) -> tuple[Array, Array]:
    """x' = A x + B f of one axis with a spring and a damper; x = [p, v] or, with a drive, [p, v_r, v, v']."""
    m, b = robot
    gained = config.feedback_mass - config.hand_mass
    k, d = config.hand_stiffness + stiffness, config.hand_damping + damping
    if config.drive_frequency == 0.0:
        mass = m - gained
        return np.array([[0.0, 1.0], [-k / mass, -(b + d) / mass]]), np.array([[0.0], [1.0 / mass]])
    w = 2.0 * math.pi * config.drive_frequency
    a = np.array(
        [
            [0.0, 0.0, 1.0, 0.0],
            [-k / m, -b / m, -d / m, gained / m],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, w * w, -w * w, -2.0 * config.drive_damping * w],
        ]
    )
    return a, np.array([[0.0], [1.0 / m], [0.0], [0.0]])


def poles(
    config: AdmittanceConfig, robot: Robot, stiffness: float = 0.0, damping: float = 0.0
) -> NDArray[np.complex128]:
    """Poles [1/s] of one axis in the hand, with a spring and a damper of the haptic model besides; complex."""
    return _eigenvalues(_system(config, robot, stiffness, damping)[0])


def _eigenvalues(a: Array) -> NDArray[np.complex128]:
    return np.asarray(np.linalg.eigvals(a), dtype=np.complex128)


def _listed(values: NDArray[np.complex128]) -> str:
    return ", ".join(f"{value.real:.4g}{value.imag:+.4g}j" for value in np.sort_complex(values))


def check(config: AdmittanceConfig, robot: Robot) -> None:
    """Whether the robot is stable in the hand, on its springs and at its walls, and passive as far as is asked.

    Raises
    ------
    ParameterError: it is not; the message says why, with the poles.
    """
    for name in ("design_limits", "investigator_limits"):
        if len(getattr(config, name)) not in (0, 3):
            raise ParameterError(
                f"{name}: {list(getattr(config, name))} is not allowed; it must hold x, y, z or nothing"
            )
    mass = robot.mass + config.hand_mass - config.feedback_mass
    if robot.mass - config.feedback_mass <= 0.0:
        raise ParameterError(
            f"feedback_mass: {config.feedback_mass!r} is not allowed; it leaves an apparent mass of "
            f"{robot.mass - config.feedback_mass:g} kg (pole at {-robot.damping / mass if mass else math.inf:.4g})"
        )
    places = {"in the hand": (0.0, 0.0)}
    if not all(config.free_axes) and config.spring_stiffness > 0.0:
        places["on the springs"] = (config.spring_stiffness, config.spring_damping)
    for place, (stiffness, damping) in places.items():
        found = poles(config, robot, stiffness, damping)
        if found.real.max() > UNSTABLE:
            raise ParameterError(f"admittance: unstable {place}; poles at {_listed(found)} 1/s")
    if config.design_limits or config.investigator_limits:
        inner = _Inner(config, robot, 1.0 / INNER_RATE, 0.0, 0.0)
        position, velocity = np.eye(len(inner.a))[0], np.eye(len(inner.a))[inner.v]
        closed = inner.a - np.outer(inner.b, config.wall_stiffness * position + config.wall_damping * velocity)
        found = _eigenvalues(closed)
        if np.abs(found).max() > 1.0 + UNSTABLE / INNER_RATE:
            raise ParameterError(
                f"admittance: unstable at a wall; poles at {_listed(found)} (sampled at {INNER_RATE:g} Hz)"
            )
    if config.passive_up_to > 0.0:
        _check_passive(config, robot)


def _check_passive(config: AdmittanceConfig, robot: Robot) -> None:
    """Re Y(j w) >= 0 for the robot alone, Y = v/f, on a fine grid of frequencies."""
    alone = dataclasses.replace(config, hand_stiffness=0.0, hand_damping=0.0, hand_mass=0.0)
    a, b = _system(alone, robot, 0.0, 0.0)
    v = len(a) // 2
    for frequency in np.geomspace(1e-3 * config.passive_up_to, config.passive_up_to, 400):
        y = np.linalg.solve(2j * math.pi * frequency * np.eye(len(a)) - a, b)[v, 0]
        if y.real < -1e-12 * abs(y):
            raise ParameterError(
                f"admittance: not passive at {frequency:.3g} Hz, below passive_up_to = {config.passive_up_to:g} Hz; "
                f"poles at {_listed(_eigenvalues(a))} 1/s"
            )


class _Inner:
    """One axis, discretised exactly for a force that is held."""

    def __init__(self, config: AdmittanceConfig, robot: Robot, step: float, stiffness: float, damping: float) -> None:
        # Imported here: the ideal robot needs no scipy.
        from scipy.signal import cont2discrete

        a, b = _system(config, robot, stiffness, damping)
        n = len(a)
        discrete = cont2discrete((a, b, np.eye(n), np.zeros((n, 1))), step, method="zoh")
        self.a: Array = discrete[0]
        self.b: Array = discrete[1][:, 0]
        #: Where velocity and reference velocity are.
        self.v, self.r = n // 2, 1


class Admittance:
    """Three axes of the robot, sampled.

    Raises
    ------
    ParameterError: unstable or not passive, see :func:`check`.
    """

    def __init__(
        self, config: AdmittanceConfig | None = None, robot: Robot | None = None, *, sample_time: float = SAMPLE_TIME
    ) -> None:
        self.config = AdmittanceConfig() if config is None else config
        self._h = float(sample_time)
        c = self.config
        springs = c.spring_stiffness > 0.0
        self._moving = [axis for axis in range(3) if c.free_axes[axis] or springs]
        self._ideal = not (
            springs or c.drive_frequency or c.feedback_mass or c.hand_stiffness or c.hand_damping or c.hand_mass
            or c.arm_weight or c.design_limits or c.investigator_limits or c.velocity_limit or c.force_limit
        )  # fmt: skip
        self._steps = max(1, round(self._h * INNER_RATE))
        self._n = 2 if c.drive_frequency == 0.0 else 4
        self._walls = [
            min((limits[axis] for limits in (c.design_limits, c.investigator_limits) if limits), default=math.inf)
            for axis in range(3)
        ]
        self.reset()
        self.change(robot or Robot())

    def change(self, robot: Robot) -> None:
        """Another M(s) from now on, bumplessly: position and velocities stay as they are.

        Raises
        ------
        ParameterError: as for the whole; nothing has changed then.
        """
        check(self.config, robot)
        self.robot = robot
        z = robot.damping * self._h / robot.mass
        # Below this the series is exact to rounding and the quotients are not.
        small = z < 1e-4
        self._phi = 1.0 - z / 2.0 + z * z / 6.0 if small else -math.expm1(-z) / z
        self._psi = 0.5 - z / 6.0 + z * z / 24.0 if small else (z + math.expm1(-z)) / (z * z)
        if not self._ideal:
            c = self.config
            self._inner = [
                _Inner(
                    c, robot, self._h / self._steps, *((0.0, 0.0) if free else (c.spring_stiffness, c.spring_damping))
                )
                for free in c.free_axes
            ]

    def step(self, force: Array) -> Motion:
        """Advance by one sample under a force (3,) [N]; a component that is not finite counts as zero."""
        before = self._x[:, self._n // 2].copy()
        acceleration = np.zeros(3)
        for axis in self._moving:
            f = float(force[axis])
            if not math.isfinite(f):
                f = 0.0
            if self._ideal:
                v = float(self._x[axis, 1])
                a = (f - self.robot.damping * v) / self.robot.mass
                acceleration[axis] = self._phi * a
                self._x[axis, 0] += self._h * v + self._h * self._h * self._psi * a
                self._x[axis, 1] = v + self._h * acceleration[axis]
            else:
                self._advance(axis, f)
        velocity = self._x[:, self._n // 2].copy()
        if not self._ideal:
            acceleration = (velocity - before) / self._h
        return Motion(self._x[:, 0].copy(), velocity, acceleration, self._x[:, 1].copy())

    def reset(self) -> None:
        """At rest at the origin."""
        self._x = np.zeros((3, self._n))

    def _advance(self, axis: int, force: float) -> None:
        c, inner, wall = self.config, self._inner[axis], self._walls[axis]
        if c.force_limit > 0.0:
            force = min(max(force, -c.force_limit), c.force_limit)
        if axis == Z:
            force -= (1.0 - c.support) * c.arm_weight
        x = self._x[axis]
        for _ in range(self._steps):
            push = 0.0
            if abs(x[0]) > wall:
                side = math.copysign(1.0, x[0])
                push = -side * max(0.0, c.wall_stiffness * (abs(x[0]) - wall) + c.wall_damping * side * x[inner.v])
            x = inner.a @ x + inner.b * (force + push)
            if c.velocity_limit > 0.0:
                for i in {inner.r, inner.v}:
                    x[i] = min(max(x[i], -c.velocity_limit), c.velocity_limit)
        self._x[axis] = x
