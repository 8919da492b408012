"""The robot against scipy.signal, and the ideal setting to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import StateSpace, cont2discrete

from shared_control.admittance import Admittance, AdmittanceConfig
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


def test_arrays_are_the_callers():
    robot = Admittance()
    kept = robot.step(np.array([3.0, 0.0, 0.0]))
    values = kept.velocity.copy()
    robot.step(np.array([3.0, 0.0, 0.0]))
    assert np.array_equal(kept.velocity, values)
