"""A user out of a recording."""

from __future__ import annotations

import numpy as np

from shared_control.parameters import ParameterError
from shared_control.tasks.task import Array, Robot, Task
from shared_control.users import UserConfig

__all__ = ["ReplayUser"]


class ReplayUser:
    """The recorded force of each tick, and none after the end of the recording."""

    def __init__(self, task: Task, config: UserConfig, robot: Robot, seed: int, sample_time: float) -> None:
        try:
            self._forces = np.asarray(np.load(config.recording, allow_pickle=False), dtype=float)
        except (OSError, ValueError) as error:
            raise ParameterError(f"recording: {config.recording!r} cannot be read as a .npy array: {error}") from None
        if self._forces.ndim != 2 or self._forces.shape[1] != 3:
            raise ParameterError(f"recording: {config.recording!r} holds {self._forces.shape}; it must hold (N, 3)")

    def act(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Force of this tick."""
        return np.array(self._forces[tick]) if tick < len(self._forces) else np.zeros(3)

    def reset(self, seed: int) -> None:
        """A recording has no seed."""
