"""What the tests of rig_bag share: messages to put into bags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from mig_interfaces.msg import TaskState, TrialState

EPOCH = 1_000_000_000_000
STEP = 10_000_000


@pytest.fixture
def task_state() -> Callable[[int], TaskState]:
    """Makes the task's state of a tick."""

    def make(tick: int) -> TaskState:
        message = TaskState(tick=tick, time=tick * 0.01, state=[tick + 0.5, -1.0, 2.0, 3.0], control=[tick * 0.25])
        message.header.frame_id = "task"
        _stamp(message, EPOCH + tick * STEP)
        return message

    return make


def _stamp(message: Any, nanoseconds: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)
    return message


@pytest.fixture
def trial_state() -> Callable[..., TrialState]:
    """Makes the state of a trial."""
    return _trial_state


def _trial_state(phase: int, ticks: int = 0, uid: int = 1) -> TrialState:
    message = TrialState(
        uid=uid,
        phase=phase,
        subject="s07",
        group="training",
        set="b",
        trial=3,
        scenario="cart",
        seed=11,
        ticks_published=ticks,
    )
    message.configuration_hash = "ab" * 32
    message.sample_time.nanosec = STEP
    message.epoch.sec, message.epoch.nanosec = divmod(EPOCH, 1_000_000_000)
    return _stamp(message, EPOCH + max(0, ticks - 1) * STEP)
