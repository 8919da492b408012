"""The agents: what they return, that they reset to the bit, and what a process pays for each."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from shared_control import loop
from shared_control.scenario import load


@pytest.fixture(scope="module")
def agent(scenario):
    agent = loop.make_filter(scenario)
    agent.warm_up()
    return agent


X = np.array([0.3, 0.5, 0.0, 0.0])


def test_accept_adds_nothing(agent):
    force = np.array([8.0, 1.0, 2.0])
    decision, admitted, added = agent.decide(X, force)
    assert decision.verdict == loop.Verdict.ACCEPTED
    assert np.array_equal(admitted, force)
    assert np.array_equal(added, np.zeros(3))
    assert admitted is not force


def test_reject_adds_the_opposite(agent):
    agent.mode = "training"
    force = np.array([-8.0, 1.0, 2.0])
    decision, admitted, added = agent.decide(X, force)
    agent.mode = "assistance"
    assert decision.verdict == loop.Verdict.REJECTED
    assert np.array_equal(admitted, np.zeros(3))
    assert np.array_equal(added, -force)


def test_replace_adds_what_brings_the_net_to_the_controllers(agent, scenario):
    force = np.array([-8.0, 0.0, 0.0])
    decision, admitted, added = agent.decide(X, force)
    assert decision.verdict == loop.Verdict.REPLACED
    assert force + added == pytest.approx(admitted, rel=1e-15)
    motion = loop.make_robot(scenario).step(admitted)
    assert motion.acceleration[0] == decision.applied_control[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_wrench_that_is_not_finite_on_any_axis(agent, axis):
    force = np.array([8.0, 0.0, 0.0])
    force[axis] = np.nan
    decision, admitted, _ = agent.decide(X, force)
    assert decision.reason == loop.Reason.NON_FINITE_WRENCH
    assert np.all(np.isfinite(admitted))


def test_a_force_beyond_the_sensors_range_is_not_believed(agent):
    force = np.array([-51.0, 0.0, 0.0])
    assert agent.decide(X, force).decision.reason == loop.Reason.CRITERION
    agent.configure(max_force=50.0)
    decision, admitted, _ = agent.decide(X, force)
    assert (decision.verdict, decision.reason) == (loop.Verdict.REJECTED, loop.Reason.EXCESSIVE_WRENCH)
    assert np.array_equal(admitted, np.zeros(3))
    agent.configure(max_force=51.0)
    assert agent.decide(X, force).decision.reason == loop.Reason.CRITERION


def test_the_mode_in_force_is_told(agent):
    was = agent.mode
    for mode in ("off", "training", "assistance"):
        agent.mode = mode
        assert agent.mode.name == mode.upper()
    agent.mode = was


def test_plant_outcomes():
    upright = {"/**/task_sim": {"ros__parameters": {"initial_state": [0.0, 0.0, 0.0, 0.0]}}}
    plant = loop.make_plant(load(upright), 0)
    outcomes = []
    for _ in range(201):
        outcomes.append(plant.outcome)
        plant.coast()
    assert plant.in_success_region
    assert outcomes.index(loop.SUCCESS) == 200
    tracked = {"/**": {"ros__parameters": {"task_parameters": ["track=0.5"]}}}
    plant = loop.make_plant(load(tracked), 0)
    robot = loop.make_robot(load(tracked))
    for _ in range(100):
        force = np.array([40.0, 0.0, 0.0])
        plant.step(robot.step(force), force)
    assert plant.outcome == loop.FAILURE


def test_plant_may_differ_from_the_model():
    differs = load({"/**/task_sim": {"ros__parameters": {"plant_parameters": ["length=1.0"]}}})
    really = load({"/**": {"ros__parameters": {"task_parameters": ["length=1.0"]}}})
    plant, expected = loop.make_plant(differs, 0), loop.make_plant(really, 0)
    robot, force = loop.make_robot(differs), np.array([6.0, 0.0, 0.0])
    for _ in range(50):
        motion = robot.step(force)
        assert np.array_equal(plant.step(motion, force), expected.step(motion, force))
    assert plant.task.parameters.length == 1.0
    assert loop.make_filter(differs).task.parameters.length == 2.0


def test_plant_goes_on_with_a_motion_held_and_coasts_without(scenario):
    plant, robot = loop.make_plant(scenario, 0), loop.make_robot(scenario)
    force = np.array([6.0, 0.0, 0.0])
    motion = robot.step(force)
    plant.step(motion, force)
    assert plant.control == 3.0
    plant.step(motion, force)
    assert plant.control == 3.0
    assert plant.state[3] == pytest.approx(0.06)
    plant.coast()
    assert plant.control == 0.0
    assert plant.state[3] == pytest.approx(0.06)


def test_plant_and_robot_agree_on_the_cart(scenario):
    plant, robot = loop.make_plant(scenario, 0), loop.make_robot(scenario)
    for fx in np.random.default_rng(0).normal(0.0, 40.0, 300):
        force = np.array([fx, 0.0, 0.0])
        motion = robot.step(force)
        x = plant.step(motion, force)
    assert x[2:] == pytest.approx([motion.position[0], motion.velocity[0]], rel=1e-9)


def test_states_are_the_callers(scenario):
    plant = loop.make_plant(scenario, 0)
    start = plant.state
    x = plant.coast()
    x[:] = 7.0
    start[:] = 7.0
    assert plant.state[0] != 7.0


def test_perturbed_start_is_the_seeds():
    perturbed = load({"/**/task_sim": {"ros__parameters": {"initial_sd": [0.1, 0.0, 0.2, 0.0]}}})
    plant = loop.make_plant(perturbed, 5)
    start = plant.state
    assert start[0] != np.pi
    assert start[1] == start[3] == 0.0
    plant.warm_up()
    assert np.array_equal(plant.state, start)
    plant.reset(6)
    assert not np.array_equal(plant.state, start)
    plant.reset(5)
    assert np.array_equal(plant.state, start)


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_what_each_process_imports():
    """A user and a robot pay for numpy only; nobody pays for scipy, YAML (but to read a file) or a pool."""
    loaded = run(
        "import sys\n"
        "before = set(sys.modules)\n"
        "import shared_control.loop as loop\n"
        "from shared_control.scenario import load\n"
        "s = load({})\n"
        "user, robot = loop.make_user(s, 0), loop.make_robot(s)\n"
        "user.warm_up(); robot.warm_up()\n"
        "robot.step(user.act(0, 0.0, None))\n"
        "wanted = ('numba', 'scipy', 'yaml', 'multiprocessing', 'matplotlib', 'rclpy')\n"
        "print(*(m for m in wanted if m in sys.modules and m not in before))\n"
    )
    assert loaded.split() == []
