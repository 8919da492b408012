"""The loop as objects without ROS: user, filter, robot, plant, each called once a tick, in this order.

    force   = user.act(k, t_k, x_k, q_k)
    outcome = filter.decide(x_k, force, q_k)
    motion  = robot.step(outcome.admitted_force)
    x_k+1   = plant.step(motion, outcome.admitted_force)

with q_k the mode of a hybrid task, which ``plant.task_mode`` tells (0 for any other).
The nodes and :func:`shared_control.trial.run_trial` call exactly these, so that a trial headless and a trial through
the graph are the same numbers. Every array that an agent returns is new: the caller may keep it. After ``warm_up``
nothing compiles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from shared_control import users
from shared_control.admittance import Admittance, Motion
from shared_control.filter import INPUT_FAULTS, Decision, MigFilter, Mode, Reason, Verdict
from shared_control.scenario import Scenario
from shared_control.streams import stream
from shared_control.tasks.task import Array, Task

__all__ = [
    "INPUT_FAULTS",
    "Decision",
    "FilterAgent",
    "FilterOutcome",
    "Mode",
    "Motion",
    "PlantAgent",
    "Reason",
    "RobotAgent",
    "UserAgent",
    "Verdict",
    "make_filter",
    "make_plant",
    "make_robot",
    "make_user",
]

#: Outcomes of a trial so far, as in TaskState.msg.
OPEN, SUCCESS, FAILURE = 0, 1, 2


class FilterOutcome(NamedTuple):
    """What the filter hands on."""

    decision: Decision
    admitted_force: Array  # (3,) [N] to the robot
    added_force: Array  # (3,) [N] admitted - user's; nothing where accepted, the opposite where rejected


class UserAgent:
    """The simulated user of a scenario."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self._task = scenario.loop.make_task()
        self._user = users.make_configured(
            self._task, scenario.user, scenario.loop.robot, seed, scenario.loop.sample_time
        )
        self._seed = seed

    def act(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Force (3,) [N] for tick k at trial time k t_s [s] in the state (n,)."""
        return self._user.act(tick, time, x, task_mode)

    def reset(self, seed: int) -> None:
        """As new, for the trial with this seed."""
        self._seed = seed
        self._user.reset(seed)

    def warm_up(self) -> None:
        """Have everything loaded that acting needs."""
        self._user.act(0, 0.0, self._task.initial_state)
        self._user.reset(self._seed)


class FilterAgent:
    """The filter of a scenario, in forces."""

    def __init__(self, scenario: Scenario) -> None:
        self.task = scenario.loop.make_task()
        self._robot = scenario.loop.robot
        self._filter = MigFilter(self.task, scenario.filter, sample_time=scenario.loop.sample_time)
        self._seed = scenario.loop.seed
        self.reset()

    @property
    def mode(self) -> Mode:
        """Mode in force; set it by name or number, it takes effect at the next tick."""
        return self._filter.mode

    @mode.setter
    def mode(self, mode: str | int) -> None:
        self._filter.mode = mode

    def configure(self, **values: object) -> None:
        """Change live parameters of the filter; all or none.

        Raises
        ------
        ParameterError: not live, or refused by its declaration.
        """
        self._filter.configure(**values)

    def decide(self, x: Array, force: Array, task_mode: int | None = None) -> FilterOutcome:
        """Judge the user's force (3,) [N] at the state (n,); once a tick."""
        components = force.tolist()
        if not all(map(math.isfinite, components)):
            return self.fallback(Reason.NON_FINITE_WRENCH, force)
        if max(map(abs, components)) > self._filter.max_force:
            return self.fallback(Reason.EXCESSIVE_WRENCH, force)
        u_user = self.task.control_from_wrench(force, self._robot)
        return self._outcome(self._filter.decide(x, u_user, task_mode), force)

    def fallback(self, reason: Reason | int, force: Array) -> FilterOutcome:
        """No force, in place of one that could not be judged; once a tick, instead of :meth:`decide`."""
        return self._outcome(self._filter.fallback(reason, self.task.control_from_wrench(force, self._robot)), force)

    def reset(self, seed: int | None = None) -> None:
        """As new, for the trial with this seed (the scenario's); live parameters stay as they were set."""
        self._filter.reset(self._seed if seed is None else seed)

    def warm_up(self) -> None:
        """Compile or load every kernel; leaves the agent as :meth:`reset` does."""
        self._filter.warm_up()
        self.reset()

    def _outcome(self, decision: Decision, force: Array) -> FilterOutcome:
        if decision.verdict is Verdict.ACCEPTED:
            return FilterOutcome(decision, np.array(force), np.zeros(3))
        admitted = self.task.wrench_from_control(decision.applied_control, self._robot)
        return FilterOutcome(decision, admitted, admitted - force)


class RobotAgent:
    """The admittance robot of a scenario."""

    def __init__(self, scenario: Scenario) -> None:
        self._robot = Admittance(scenario.robot, scenario.loop.robot, sample_time=scenario.loop.sample_time)

    def step(self, force: Array) -> Motion:
        """Motion over one sample under the admitted force (3,) [N]."""
        return self._robot.step(force)

    def reset(self) -> None:
        """At rest at the origin."""
        self._robot.reset()

    def warm_up(self) -> None:
        """Nothing to compile."""
        self._robot.reset()


class PlantAgent:
    """The task of a scenario, simulated."""

    task: Task
    #: Whether x_k lies in the success region, and the outcome of the trial so far.
    in_success_region: bool
    outcome: int
    #: Mode that a hybrid task is in, otherwise 0.
    task_mode: int
    _x: Array
    _u: Array

    def __init__(self, scenario: Scenario, seed: int) -> None:
        # Imported here: user and robot, who need no plant, need no compiler.
        from shared_control.integrate import Stepper

        self._config = scenario.task
        self.task = self._config.make_plant(scenario.loop.make_task())
        self._robot = scenario.loop.robot
        self._stepper = Stepper(self.task, scenario.loop.sample_time)
        self._dwell = round(self.task.success_dwell / scenario.loop.sample_time)
        self.reset(seed)

    @property
    def state(self) -> Array:
        """x_k (n,), a copy."""
        return np.array(self._x)

    @property
    def control(self) -> Array:
        """Control (m,) that brought the task here, a copy; zero at the start."""
        return np.array(self._u)

    def step(self, motion: Motion, force: Array) -> Array:
        """x_k+1 (n,), under the end effector's motion over the sample and the admitted force (3,) [N]."""
        return self._advance(self.task.control_from_motion(motion, self._robot, force))

    def coast(self) -> Array:
        """x_k+1 (n,) under no control."""
        return self._advance(np.zeros(self.task.m))

    def reset(self, seed: int) -> None:
        """At the start of the trial with this seed."""
        self._seed = seed
        self.in_success_region = False
        start = self._config.initial_state
        self._x = np.array(start, dtype=float) if start else self.task.initial_state
        if self._config.initial_sd:
            self._x += stream(seed, "plant").standard_normal(self.task.n) * np.array(self._config.initial_sd)
        self.task_mode = self.task.mode(self._x)
        self._u = np.zeros(self.task.m)
        self._inside = 0
        self.outcome = OPEN
        self._judge(moved=False)

    def warm_up(self) -> None:
        """Compile or load every kernel; leaves the agent as :meth:`reset` does."""
        self.coast()
        self.reset(self._seed)

    def _advance(self, u: Array) -> Array:
        self._u = u
        self.task_mode = self._stepper.advance(self._x, u, self.task_mode)
        self._judge(moved=True)
        return np.array(self._x)

    def _judge(self, moved: bool) -> None:
        was_inside = moved and self.in_success_region
        self.in_success_region = self.task.success_region(self._x)
        # Samples spent inside: the first node inside begins the dwell.
        self._inside = self._inside + 1 if was_inside and self.in_success_region else 0
        if self.outcome == OPEN:
            if self.task.failure(self._x):
                self.outcome = FAILURE
            elif self.in_success_region and self._inside >= self._dwell:
                self.outcome = SUCCESS


def make_user(scenario: Scenario, seed: int) -> UserAgent:
    """The scenario's user, for the trial with this seed."""
    return UserAgent(scenario, seed)


def make_filter(scenario: Scenario) -> FilterAgent:
    """The scenario's filter."""
    return FilterAgent(scenario)


def make_robot(scenario: Scenario) -> RobotAgent:
    """The scenario's robot."""
    return RobotAgent(scenario)


def make_plant(scenario: Scenario, seed: int) -> PlantAgent:
    """The scenario's task, at the start of the trial with this seed."""
    return PlantAgent(scenario, seed)
