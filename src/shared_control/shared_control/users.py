"""Simulated users. Each yields a wrench: the force that a hand would apply.

``noise``   u_j ~ N(0, sd_j^2), a new sample every ``noise_hold`` ticks, clipped where asked, as force through the ideal
robot
``idle``    no force
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from shared_control.parameters import ParameterError, build, parameter
from shared_control.streams import stream
from shared_control.tasks.task import Array, Robot, Task

__all__ = ["IdleUser", "NoiseUser", "User", "UserConfig", "make", "make_configured", "names"]


@dataclasses.dataclass(frozen=True)
class UserConfig:
    """Parameters of the simulated user. An empty array stands for the task's own default."""

    user: str = parameter("noise", "Which user.", choices=("noise", "idle"))
    noise_sd: tuple[float, ...] = parameter(
        (), "Standard deviation of each control; empty: the task's.", unit="of the control", ge=0.0
    )
    noise_hold: int = parameter(1, "Ticks for which one sample of the noise is held.", ge=1, le=100000)
    noise_clip: tuple[float, ...] = parameter(
        (), "Largest magnitude of each control; empty: not clipped.", unit="of the control", ge=0.0
    )


class User(Protocol):
    """Acts on what it sees."""

    def act(self, tick: int, time: float, x: Array) -> Array:
        """Force (3,) [N] for tick k at trial time k t_s [s], in the state (n,)."""

    def reset(self, seed: int) -> None:
        """As new, for the trial with this seed."""


class IdleUser:
    """Nobody pushes."""

    def __init__(self, *_: object) -> None:
        """Takes what every user takes, and needs none of it."""

    def act(self, tick: int, time: float, x: Array) -> Array:
        """Zero."""
        return np.zeros(3)

    def reset(self, seed: int) -> None:
        """Nothing to forget."""


class NoiseUser:
    """White noise on the control, expressed as force. The force of a tick depends on seed and tick alone."""

    #: Samples drawn at a time: a draw costs as much for one as for hundreds.
    _BLOCK = 512

    _samples: Array

    def __init__(self, task: Task, config: UserConfig, robot: Robot, seed: int) -> None:
        self._task, self._robot = task, robot
        self._hold = config.noise_hold
        self._sd = _per_control("noise_sd", config.noise_sd or task.noise_sd, task)
        self._clip = _per_control("noise_clip", config.noise_clip, task) if config.noise_clip else None
        self.reset(seed)

    def act(self, tick: int, time: float, x: Array) -> Array:
        """Force of the sample in force at this tick."""
        index = tick // self._hold
        while index >= len(self._samples):
            block = self._random.standard_normal((self._BLOCK, len(self._sd))) * self._sd
            if self._clip is not None:
                block = np.clip(block, -self._clip, self._clip)
            self._samples = np.concatenate([self._samples, block])
        return self._task.wrench_from_control(self._samples[index], self._robot)

    def reset(self, seed: int) -> None:
        """Begin the stream of this trial."""
        self._random = stream(seed, "user")
        self._samples = np.empty((0, len(self._sd)))


_REGISTRY: dict[str, Callable[[Task, UserConfig, Robot, int], User]] = {"noise": NoiseUser, "idle": IdleUser}


def _per_control(name: str, values: tuple[float, ...], task: Task) -> Array:
    if len(values) != task.m:
        raise ParameterError(f"{name}: {list(values)} is not allowed; {task.name} has {task.m} controls")
    return np.array(values, dtype=float)


def names() -> tuple[str, ...]:
    """Names of the registered users."""
    return tuple(_REGISTRY)


def make(name: str, task: Task, seed: int = 0, *, robot: Robot | None = None, **options: Any) -> User:
    """The user of this name, who pushes at a robot; ``options`` are those of :class:`UserConfig`.

    Raises
    ------
    ParameterError: no such user or option, or a value that is refused.
    """
    if name not in _REGISTRY:
        near = difflib.get_close_matches(name, _REGISTRY, n=1)
        hint = f"did you mean {near[0]}?" if near else "known: " + ", ".join(_REGISTRY)
        raise ParameterError(f"user: {name!r} is not known; {hint}")
    return make_configured(task, build(UserConfig, {"user": name, **options}), robot or Robot(), seed)


def make_configured(task: Task, config: UserConfig, robot: Robot, seed: int) -> User:
    """The user that a configuration names."""
    return _REGISTRY[config.user](task, config, robot, seed)
