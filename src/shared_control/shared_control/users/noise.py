"""Users without a purpose: white noise, and nobody."""

from __future__ import annotations

import numpy as np

from shared_control.parameters import ParameterError
from shared_control.streams import stream
from shared_control.tasks.task import Array, Robot, Task
from shared_control.users import UserConfig

__all__ = ["IdleUser", "Noise", "NoiseUser"]


class IdleUser:
    """Nobody pushes."""

    def __init__(self, *_: object) -> None:
        """Takes what every user takes, and needs none of it."""

    def act(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Zero."""
        return np.zeros(3)

    def reset(self, seed: int) -> None:
        """Nothing to forget."""


class Noise:
    """White Gaussian controls (m,), held and clipped; that of a tick depends on seed and tick alone.

    Only the block in force is kept, so that a trial of any length takes the same memory.
    """

    #: Samples drawn at a time: a draw costs as much for one as for hundreds.
    _BLOCK = 512

    _samples: Array

    def __init__(self, task: Task, config: UserConfig, seed: int) -> None:
        self._hold = config.noise_hold
        self._sd = _per_control("noise_sd", config.noise_sd or task.noise_sd, task)
        self._clip = _per_control("noise_clip", config.noise_clip, task) if config.noise_clip else None
        self.reset(seed)

    def at(self, tick: int) -> Array:
        """Control of the sample in force at this tick."""
        index = tick // self._hold
        if index < self._first:
            self.reset(self._seed)
        while index >= self._first + len(self._samples):
            block = self._random.standard_normal((self._BLOCK, len(self._sd))) * self._sd
            if self._clip is not None:
                block = np.clip(block, -self._clip, self._clip)
            self._first += len(self._samples)
            self._samples = block
        return np.array(self._samples[index - self._first])

    def reset(self, seed: int) -> None:
        """Begin the stream of this trial."""
        self._seed = seed
        self._random = stream(seed, "user")
        self._first = 0
        self._samples = np.empty((0, len(self._sd)))


class NoiseUser:
    """White noise on the control, expressed as force."""

    def __init__(self, task: Task, config: UserConfig, robot: Robot, seed: int, sample_time: float) -> None:
        self._task, self._robot = task, robot
        self._noise = Noise(task, config, seed)

    def act(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Force of the sample in force at this tick."""
        return self._task.wrench_from_control(self._noise.at(tick), self._robot)

    def reset(self, seed: int) -> None:
        """Begin the stream of this trial."""
        self._noise.reset(seed)


def _per_control(name: str, values: tuple[float, ...], task: Task) -> Array:
    if len(values) != task.m:
        raise ParameterError(f"{name}: {list(values)} is not allowed; {task.name} has {task.m} controls")
    return np.array(values, dtype=float)
