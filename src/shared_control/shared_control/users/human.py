"""A user with a body.

    seen        x(t - d), carried forward to t by the user's model of the task and copies of the user's own commands
    command     c = s u_mpc + (1 - s) u_noise,  s = 1 - (1 - skill) exp(-trial / L)
    muscle      a' = (c - a) / tau
    motor noise u = a (1 + e),  e ~ N(0, cv^2), a new sample each tick

d = 150 ms, the latency of rapid responses of the hand to what is seen (Franklin and Wolpert, Journal of Neuroscience
28, 2008); the forward model is that of Miall, Weir, Wolpert, Stein, Journal of Motor Behavior 25, 1993. tau = 40 ms
(order of muscle activation, Winters and Stark, IEEE Transactions on Biomedical Engineering 32, 1985). Noise in
proportion to the command: Harris and Wolpert, Nature 394, 1998; cv = 0.1 stands for a whole arm at 100 Hz and is ours.
Practice takes the remaining error away exponentially (Heathcote, Brown, Mewhort, Psychonomic Bulletin & Review 7,
2000); L = 20 trials, two thirds of a set of the paper's study, is ours.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from shared_control.integrate import Stepper
from shared_control.streams import stream
from shared_control.tasks.task import Array, Robot, Task
from shared_control.users import UserConfig
from shared_control.users.mpc import MpcUser
from shared_control.users.noise import Noise

__all__ = ["HumanUser"]

DELAY = 0.15  # [s]
MUSCLE = 0.04  # [s]
MOTOR_NOISE = 0.1
PRACTICE = 20.0  # [trials]


class HumanUser(MpcUser):
    """See the module."""

    def __init__(self, task: Task, config: UserConfig, robot: Robot, seed: int, sample_time: float) -> None:
        super().__init__(task, config, robot, seed, sample_time)
        self._noise = Noise(task, config, seed)
        self._skill = 1.0 - (1.0 - config.skill) * math.exp(-config.trial / PRACTICE)
        self._follow = -math.expm1(-sample_time / MUSCLE)
        self._model = Stepper(self.model, sample_time)
        delay = round(DELAY / sample_time)
        self._seen: deque[tuple[Array, int | None]] = deque(maxlen=delay + 1)
        self._done: deque[Array] = deque(maxlen=delay)
        self._muscle: Array = np.zeros(task.m)
        self.reset(seed)

    def intend(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Control (m,)."""
        self._seen.append((np.array(x), task_mode))
        now, mode = self._bridge() if self.plans(tick) else self._seen[0]
        command = self._skill * super().intend(tick, time, now, mode) + (1.0 - self._skill) * self._noise.at(tick)
        self._muscle = self._muscle + self._follow * (command - self._muscle)
        self._done.append(self._muscle)
        noisy: Array = self._muscle * (1.0 + MOTOR_NOISE * self._motor.standard_normal(len(command)))
        return noisy

    def _bridge(self) -> tuple[Array, int | None]:
        """Where what has been done since takes the state that is seen."""
        seen, mode = self._seen[0]
        now = np.array(seen)
        # At the start of a trial less has been done than the delay holds.
        for u in list(self._done)[len(self._done) - len(self._seen) + 1 :]:
            mode = self._model.advance(now, u, mode)
        return now, mode

    def reset(self, seed: int) -> None:
        """At rest, having seen nothing."""
        super().reset(seed)
        self._noise.reset(seed)
        self._motor = stream(seed, "motor")
        self._muscle = np.zeros_like(self._muscle)
        self._seen.clear()
        self._done.clear()
