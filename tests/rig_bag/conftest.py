"""What the tests of rig_bag share: messages to put into bags."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from recorded_loop import EPOCH, STEP
from std_msgs.msg import String

from mig_interfaces.msg import TaskState, TrialState
from rig_bag import BagWriter
from rig_bag.recording import Recording, Trial


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


@pytest.fixture
def trial_bag(tmp_path: Path, task_state: Callable[[int], TaskState]) -> Callable[..., Path]:
    """Records a trial of some ticks, with the rig's topics and its recording, and returns the bag."""

    def make(
        name: str = "bag", ticks: int = 40, *, lacks: Collection[int] = (), twice: Collection[int] = (), **options: Any
    ) -> Path:
        writer = BagWriter(tmp_path / name, **{"chunk_size": 1500, **options})
        topics = ["/rig/task/state", "/rig/mig_filter/accepted|/rig/mig_filter/rejected"]
        recording = Recording(writer, per_tick=topics, progress_ticks=1)
        trial = recording.add_topic("/rig/trial/state", "mig_interfaces/msg/TrialState")
        state = recording.add_topic("/rig/task/state", "mig_interfaces/msg/TaskState")
        verdicts = [
            recording.add_topic(f"/rig/mig_filter/{verdict}", "geometry_msgs/msg/WrenchStamped")
            for verdict in ("accepted", "rejected")
        ]
        text = recording.add_topic("/text", "std_msgs/msg/String")
        writer.attach("scenario.yaml", b"a: 1\n", "application/yaml", 5)
        now = EPOCH

        def send(stream: Any, message: Any) -> None:
            nonlocal now
            now += 1000
            recording.receive(stream, serialize_message(message), now)

        def announce(phase: int, published: int = 0) -> None:
            message = _trial_state(phase, published)
            send(trial, message)
            recording.follow(Trial.from_message(message))

        announce(TrialState.PHASE_RUNNING)
        for tick in range(ticks):
            now = EPOCH + tick * STEP
            wrench = _stamp(WrenchStamped(), EPOCH + tick * STEP)
            for _ in range(0 if tick in lacks else 2 if tick in twice else 1):
                send(state, task_state(tick))
                send(verdicts[tick % 3 == 0], wrench)
            if tick % 7 == 0:
                send(text, String(data="x" * tick))
        announce(TrialState.PHASE_FINISHED, ticks)
        recording.close("the test ended it")
        return writer.path

    return make
