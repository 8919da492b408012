"""Messages of a tick, for tests."""

from __future__ import annotations

import math

from geometry_msgs.msg import WrenchStamped

from mig_interfaces.msg import TaskState, TrialState
from rig_runtime.ticks import LOCKSTEP_EPOCH, to_stamp
from rig_runtime.topics import SENSOR_FRAME, TASK_FRAME

SAMPLE = 10_000_000


def state(tick: int, x: tuple[float, ...] = (math.pi - 0.4, 0.0, 0.0, 0.0)) -> TaskState:
    """The task's state of a tick."""
    message = TaskState(tick=tick, time=0.01 * tick, state=list(x))
    message.header.stamp = to_stamp(LOCKSTEP_EPOCH + tick * SAMPLE)
    message.header.frame_id = TASK_FRAME
    return message


def wrench(tick: int, force: float, frame: str = SENSOR_FRAME) -> WrenchStamped:
    """A force along x at a tick."""
    message = WrenchStamped()
    message.header.stamp = to_stamp(LOCKSTEP_EPOCH + tick * SAMPLE)
    message.header.frame_id = frame
    message.wrench.force.x = force
    return message


def trial(phase: int, uid: int = 1, ticks: int = 40) -> TrialState:
    """A trial of so many ticks."""
    message = TrialState(phase=phase, uid=uid, epoch=to_stamp(LOCKSTEP_EPOCH), ticks_planned=ticks)
    message.sample_time.nanosec = SAMPLE
    return message
