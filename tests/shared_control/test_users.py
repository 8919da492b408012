"""The noise user against its definition, and determinism."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from shared_control import tasks, users
from shared_control.parameters import ParameterError
from shared_control.streams import stream
from shared_control.tasks import Robot

TASK = tasks.get("cart_pendulum")
NOWHERE = np.zeros(4)


def forces(user, count, start=0):
    return np.array([user.act(k, 0.01 * k, NOWHERE) for k in range(start, start + count)])


def test_is_white_gaussian_along_x():
    f = forces(users.make("noise", TASK, 3, robot=Robot(1.5), noise_sd=[20.0]), 20000)
    assert np.all(f[:, 1:] == 0.0)
    u = f[:, 0] / 1.5
    assert abs(u.mean()) < 4.0 * 20.0 / np.sqrt(len(u))
    assert stats.kstest(u / 20.0, "norm").pvalue > 1e-3
    for lag in (1, 2, 10):
        assert abs(np.corrcoef(u[:-lag], u[lag:])[0, 1]) < 4.0 / np.sqrt(len(u))
    assert np.abs(u).max() > 60.0


def test_default_is_the_tasks():
    u = forces(users.make("noise", TASK, 4), 5000)[:, 0] / Robot().mass
    assert u.std() == pytest.approx(20.0, rel=0.04)


def test_hold_and_clip():
    f = forces(users.make("noise", TASK, 5, noise_hold=5, noise_clip=[10.0]), 1000)[:, 0] / Robot().mass
    held = f.reshape(-1, 5)
    assert np.all(held == held[:, :1])
    # More than half of it lies beyond the clip: two values, and the rest all different.
    assert len(np.unique(held[:, 0])) > 50
    assert np.abs(f).max() == 10.0


def test_same_seed_same_floats_whatever_the_order():
    a, b = users.make("noise", TASK, 6), users.make("noise", TASK, 7)
    whole = forces(a, 1500)
    assert not np.array_equal(forces(b, 1500), whole)
    b.reset(6)
    assert np.array_equal(b.act(1200, 12.0, NOWHERE), whole[1200])
    assert np.array_equal(forces(b, 1500), whole)


def test_streams_do_not_depend_on_each_other():
    assert stream(1, "user").integers(1 << 60) != stream(1, "plant").integers(1 << 60)
    assert stream(1, "user").integers(1 << 60) == stream(1, "user").integers(1 << 60)


def test_idle():
    assert np.array_equal(forces(users.make("idle", TASK), 3), np.zeros((3, 3)))


def test_refused():
    with pytest.raises(ParameterError, match="did you mean noise"):
        users.make("nose", TASK)
    with pytest.raises(ParameterError, match="noise_sd"):
        users.make("noise", TASK, noise_sd=[1.0, 2.0])
    with pytest.raises(ParameterError, match="noise_hold"):
        users.make("noise", TASK, noise_hold=0)
    with pytest.raises(ParameterError, match="did you mean noise_hold"):
        users.make("noise", TASK, noise_holds=1)
