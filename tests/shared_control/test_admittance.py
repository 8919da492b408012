"""The robot against scipy.signal, and the ideal setting to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import StateSpace, TransferFunction, cont2discrete, step

from shared_control.admittance import Admittance, AdmittanceConfig, check, poles
from shared_control.parameters import ParameterError
from shared_control.tasks import Robot

H = 0.01


@pytest.mark.parametrize(("mass", "damping"), [(2.0, 0.0), (2.0, 1e-3), (1.5, 8.0), (0.1, 500.0)])
def test_against_scipy(mass, damping):
    robot = Admittance(AdmittanceConfig(free_axes=(True, True, True)), Robot(mass, damping), sample_time=H)
    system = StateSpace([[0.0, 1.0], [0.0, -damping / mass]], [[0.0], [1.0 / mass]], np.eye(2), np.zeros((2, 1)))
    a, b, *_ = cont2discrete((system.A, system.B, system.C, system.D), H, method="zoh")
    exact = np.zeros((2, 3))
    for force in np.random.default_rng(1).normal(0.0, 30.0, (200, 3)):
        before = exact[1]
        exact = a @ exact + b @ force[None, :]
        motion = robot.step(force)
        np.testing.assert_allclose(motion.position, exact[0], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(motion.velocity, exact[1], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(motion.acceleration, (exact[1] - before) / H, rtol=1e-9, atol=1e-8)
        assert np.array_equal(motion.reference_velocity, motion.velocity)


def test_series_meets_quotients():
    """Either side of where the formula changes the motion is the same."""
    force, ends = np.array([5.0, 0.0, 0.0]), []
    for damping in (0.0199999, 0.0200001):
        robot = Admittance(robot=Robot(2.0, damping), sample_time=H)
        for _ in range(100):
            motion = robot.step(force)
        ends.append([motion.position[0], motion.velocity[0]])
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-6)


@given(st.floats(-1e6, 1e6), st.floats(0.01, 1000.0))
def test_ideal_is_exact(force, mass):
    robot = Admittance(robot=Robot(mass))
    for _ in range(3):
        assert robot.step(np.array([force, 1.0, 1.0])).acceleration[0] == force / mass


def test_held_axes_do_not_move():
    motion = Admittance().step(np.array([1.0, 2.0, 3.0]))
    assert motion.position[0] > 0.0
    for part in motion:
        assert np.array_equal(part[1:], [0.0, 0.0])


def test_reset_and_force_that_is_not_finite():
    robot = Admittance()
    first = robot.step(np.array([3.0, 0.0, 0.0]))
    robot.reset()
    again = robot.step(np.array([3.0, 0.0, 0.0]))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert robot.step(np.array([np.nan, 0.0, 0.0])).acceleration[0] == 0.0


force = st.floats(-1e9, 1e9)


@given(
    st.sampled_from(
        [
            {},
            {"drive_frequency": 10.0, "hand_stiffness": 50.0, "hand_damping": 5.0, "hand_mass": 0.5},
            {"free_axes": (True, True, True), "arm_weight": 30.0, "support": 0.5, "design_limits": (0.5, 0.5, 0.5)},
            {"spring_stiffness": 5000.0, "spring_damping": 50.0, "velocity_limit": 1.0, "force_limit": 100.0},
        ]
    ),
    st.lists(st.tuples(force, force, force), min_size=1, max_size=8),
)
def test_never_a_motion_that_is_not_finite(options, forces):
    robot = Admittance(AdmittanceConfig(**options), Robot(2.0, 5.0))
    for f in forces:
        assert np.all(np.isfinite(robot.step(np.array(f))))


def test_arrays_are_the_callers():
    robot = Admittance()
    kept = robot.step(np.array([3.0, 0.0, 0.0]))
    values = kept.velocity.copy()
    robot.step(np.array([3.0, 0.0, 0.0]))
    assert np.array_equal(kept.velocity, values)


def transfer(m, b, w, zeta, gained, k, d):
    """v/f by polynomials: v (m s + b)(s^2 + 2 zeta w s + w^2) s = w^2 s (f - (k/s + d - gained s) v)."""
    model, drive = np.poly1d([m, b]), np.poly1d([1.0, 2.0 * zeta * w, w * w])
    s = np.poly1d([1.0, 0.0])
    return TransferFunction([w * w, 0.0], (model * drive * s + w * w * np.poly1d([-gained, d, k])).coeffs)


SETTINGS = [
    ({"drive_frequency": 15.0, "drive_damping": 0.6}, 2.0, 5.0),
    ({"drive_frequency": 15.0, "feedback_mass": 0.5}, 2.0, 5.0),
    ({"drive_frequency": 30.0, "hand_stiffness": 40.0, "hand_damping": 8.0, "hand_mass": 0.3}, 2.0, 5.0),
]


@pytest.mark.parametrize(("options", "mass", "damping"), SETTINGS)
def test_drive_and_hand_against_scipys_step_response(options, mass, damping):
    config = AdmittanceConfig(**options)
    robot = Admittance(config, Robot(mass, damping))
    found = [robot.step(np.array([1.0, 0.0, 0.0])).velocity[0] for _ in range(100)]
    w = 2.0 * np.pi * config.drive_frequency
    gained = config.feedback_mass - config.hand_mass
    system = transfer(mass, damping, w, config.drive_damping, gained, config.hand_stiffness, config.hand_damping)
    _time, exact = step(system, T=np.linspace(0.0, 1.0, 101))
    np.testing.assert_allclose(found, exact[1:], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(
        np.sort_complex(poles(config, robot.robot)), np.sort_complex(np.roots(system.den)), atol=1e-6
    )


def test_frequency_response():
    """Amplitude and phase under a slow sine, against the transfer function."""
    config, mass, damping = AdmittanceConfig(drive_frequency=8.0), 2.0, 6.0
    robot, w = Admittance(config, Robot(mass, damping), sample_time=0.001), 2.0 * np.pi * 2.0
    time = 0.001 * np.arange(1, 6001)
    found = np.array([robot.step(np.array([np.sin(w * (t - 0.0005)), 0.0, 0.0])).velocity[0] for t in time])
    late = time > 3.0
    response = 2.0 * np.mean(found[late] * np.exp(-1j * w * time[late])) * 1j
    system = transfer(mass, damping, 2.0 * np.pi * 8.0, config.drive_damping, 0.0, 0.0, 0.0)
    expected = np.polyval(system.num, 1j * w) / np.polyval(system.den, 1j * w)
    assert response == pytest.approx(expected, rel=1e-3)


def test_feedback_takes_mass_away():
    """Ideal drive: the apparent mass is m - m_a."""
    motion = Admittance(AdmittanceConfig(feedback_mass=0.75), Robot(2.0)).step(np.array([5.0, 0.0, 0.0]))
    assert motion.acceleration[0] == pytest.approx(5.0 / 1.25, rel=1e-12)


def test_springs_hold_and_support_carries():
    config = AdmittanceConfig(
        spring_stiffness=2000.0, spring_damping=200.0, free_axes=(True, False, False), arm_weight=20.0, support=0.4
    )
    robot = Admittance(config, Robot(2.0, 5.0))
    for _ in range(500):
        motion = robot.step(np.array([0.0, 10.0, 0.0]))
    assert motion.position == pytest.approx([0.0, 10.0 / 2000.0, -0.6 * 20.0 / 2000.0], abs=1e-9)


def test_walls_and_limits():
    config = AdmittanceConfig(design_limits=(0.5, 1.0, 1.0), investigator_limits=(0.3, 1.0, 1.0), velocity_limit=0.4)
    robot = Admittance(config, Robot(2.0, 2.0))
    motions = [robot.step(np.array([20.0, 0.0, 0.0])) for _ in range(1000)]
    assert max(motion.velocity[0] for motion in motions) == 0.4
    # At rest the wall carries the force: 20 N / K_w beyond the narrower limit.
    assert motions[-1].position[0] == pytest.approx(0.3 + 20.0 / config.wall_stiffness, abs=1e-6)
    weak = Admittance(AdmittanceConfig(force_limit=4.0), Robot(2.0))
    assert weak.step(np.array([100.0, 0.0, 0.0])).acceleration[0] == pytest.approx(2.0)


def test_change_of_model_is_bumpless():
    for options in ({}, {"drive_frequency": 10.0}):
        robot = Admittance(AdmittanceConfig(**options), Robot(2.0, 5.0))
        for _ in range(50):
            before = robot.step(np.array([8.0, 0.0, 0.0]))
        robot.change(Robot(6.0, 1.0))
        after = robot.step(np.array([8.0, 0.0, 0.0]))
        assert abs(after.velocity[0] - before.velocity[0]) < 0.02
        assert abs(after.position[0] - before.position[0] - 0.01 * before.velocity[0]) < 2e-4
        with pytest.raises(ParameterError, match="apparent mass"):
            Admittance(AdmittanceConfig(feedback_mass=1.0), Robot(2.0)).change(Robot(0.5))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"feedback_mass": 2.5}, "apparent mass of -0.5 kg"),
        ({"drive_frequency": 5.0, "hand_stiffness": 3000.0, "hand_damping": 1.0}, "unstable in the hand; poles at"),
        ({"drive_frequency": 5.0, "spring_stiffness": 1e4}, "unstable on the springs; poles at"),
        ({"design_limits": (1.0, 1.0, 1.0), "wall_damping": 9000.0}, "unstable at a wall; poles at"),
        ({"drive_frequency": 5.0, "passive_up_to": 10.0}, "not passive at"),
        ({"design_limits": (1.0,)}, "design_limits"),
    ],
)
def test_refused_with_the_reason(options, words):
    with pytest.raises(ParameterError, match=words):
        check(AdmittanceConfig(**options), Robot(2.0, 0.1))


def test_passive_when_asked_and_possible():
    check(AdmittanceConfig(passive_up_to=400.0), Robot(2.0, 0.0))
    check(AdmittanceConfig(drive_frequency=40.0, passive_up_to=1.0), Robot(2.0, 20.0))
