"""The registry, the description of the task and its maps."""

from __future__ import annotations

import numpy as np
import pytest

from shared_control import tasks
from shared_control.admittance import Motion
from shared_control.parameters import ParameterError


def test_description():
    for name in tasks.names():
        task = tasks.get(name)
        assert task.name == name
        assert len(task.state_names) == len(task.state_units) == len(task.angles) == len(task.state_weights) == task.n
        assert len(task.control_names) == len(task.control_units) == len(task.control_weights) == task.m
        assert task.initial_state.shape == (task.n,)
        assert not task.failure(task.initial_state)
        assert task.mode(task.initial_state) == 0
        assert set(task.parameter_bounds) == set(task.parameters._fields)


def test_success_region():
    task = tasks.get("cart_pendulum")
    assert task.success_region(np.array([2.0 * np.pi - 0.39, 0.75, 9.0, 9.0]))
    assert not task.success_region(np.array([0.41, 0.0, 0.0, 0.0]))
    assert not task.success_region(np.array([0.0, -0.76, 0.0, 0.0]))


def test_maps_invert_each_other():
    task, robot = tasks.get("cart_pendulum"), tasks.Robot(3.0, 0.5)
    for u in (-7.3, 0.0, 20.0):
        force = task.wrench_from_control(np.array([u]), robot)
        assert task.control_from_wrench(force, robot) == pytest.approx([u])
    motion = Motion(*(np.arange(3.0) + i for i in (1, 2, 3, 4)))
    assert np.array_equal(task.control_from_motion(motion, robot), [3.0])


def test_refused():
    with pytest.raises(ParameterError, match="did you mean cart_pendulum"):
        tasks.get("cart_pendulums")
    with pytest.raises(ParameterError, match="did you mean gravity"):
        tasks.get("cart_pendulum", gravty=1.0)
    for values in ({"mass": 0.0}, {"damping": -1.0}, {"length": float("nan")}):
        with pytest.raises(ParameterError, match=next(iter(values))):
            tasks.get("cart_pendulum", **values)
