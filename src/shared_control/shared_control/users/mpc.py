"""Users with a purpose: model predictive control of their own objective, and what takes skill away from it."""

from __future__ import annotations

from collections import deque

import numpy as np

from shared_control import controllers, tasks
from shared_control.cost import quadratic
from shared_control.tasks.task import Array, Robot, Task
from shared_control.users import UserConfig, presets
from shared_control.users.noise import Noise

__all__ = ["GradedUser", "MpcUser"]


class MpcUser:
    """u = control of the present tick in the schedule that minimises the preset's J from what the user saw when it was
    made: at every tick, or every ``replan`` ticks.
    """

    def __init__(self, task: Task, config: UserConfig, robot: Robot, seed: int, sample_time: float) -> None:
        self._task, self._robot = task, robot
        self._replan = config.replan
        self._preset = preset = presets.get(task.name, config.preset)
        believed = tasks.parse(config.model_parameters)
        self.model = tasks.get(task.name, **{**task.parameters._asdict(), **believed})
        objective = quadratic(
            self.model, preset.state_weights, preset.control_weights, preset.terminal_weights, preset.target
        )
        self._controller = controllers.make(
            "ilqr", self.model, objective, dt=sample_time, horizon=preset.horizon, limits=preset.limits,
            iterations=preset.iterations,
        )  # fmt: skip

    def act(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Force for the control that the user intends."""
        return self._task.wrench_from_control(self.intend(tick, time, x, task_mode), self._robot)

    def plans(self, tick: int) -> bool:
        """Whether the user makes a new plan at a tick."""
        return tick % self._replan == 0

    def intend(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Control (m,)."""
        self._controller.advance()
        if not self.plans(tick):
            return self._controller.fallback()
        if self._preset.sway:
            # The objective holds one target over its horizon: that of the middle, or the user would lag by as much.
            self._controller.aim(self._preset.aim(time + 0.5 * self._preset.horizon))
        return self._controller.solve(x, task_mode).control

    def reset(self, seed: int) -> None:
        """Forget the schedule."""
        self._controller.reset()


class GradedUser(MpcUser):
    """u = s u_mpc(x(t - delay)) + (1 - s) u_noise."""

    def __init__(self, task: Task, config: UserConfig, robot: Robot, seed: int, sample_time: float) -> None:
        super().__init__(task, config, robot, seed, sample_time)
        self._noise = Noise(task, config, seed)
        self._skill = config.skill
        self._seen: deque[tuple[Array, int | None]] = deque(maxlen=round(config.delay / sample_time) + 1)

    def intend(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Control (m,)."""
        self._seen.append((np.array(x), task_mode))
        wanted = super().intend(tick, time, *self._seen[0])
        return self._skill * wanted + (1.0 - self._skill) * self._noise.at(tick)

    def reset(self, seed: int) -> None:
        """Forget what was seen, and begin the stream of this trial."""
        super().reset(seed)
        self._noise.reset(seed)
        self._seen.clear()
