"""The topics of the loop: names (relative, the scenario's namespace stands in front), types and quality of service.

One home for all of them; `docs/topics.md` says what each carries.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from mig_interfaces.msg import EndEffectorState, FilterDecision, NodeReport, RecorderState, TaskState, TrialState

#: Samples that a writer keeps for a slow reader. In lockstep the pacemaker stays within half of it (RECORDER_WINDOW).
DEPTH = 200

#: [ticks] How far the pacemaker may run ahead of the recorder in lockstep.
RECORDER_WINDOW = DEPTH // 2

DATA_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)

#: For what a node that joins late must still learn.
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

#: Each node of the graph writes one sample on the same topic, so a latched reader must keep one for each writer.
REPORT_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=32,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of the loop."""

    name: str
    type: Any
    qos: QoSProfile = field(default_factory=lambda: DATA_QOS)


TASK_STATE = Topic("task/state", TaskState)
WRENCH = Topic("force_sensor/wrench", WrenchStamped)
COMMAND = Topic("mig_filter/command", WrenchStamped)
ACCEPTED = Topic("mig_filter/accepted", WrenchStamped)
REJECTED = Topic("mig_filter/rejected", WrenchStamped)
REPLACED = Topic("mig_filter/replaced", WrenchStamped)
DECISION = Topic("mig_filter/decision", FilterDecision)
END_EFFECTOR = Topic("admittance/end_effector", EndEffectorState)
TRIAL_STATE = Topic("trial/state", TrialState, LATCHED_QOS)
NODE_REPORT = Topic("trial/reports", NodeReport, REPORT_QOS)
RECORDER_STATE = Topic("recorder/state", RecorderState, LATCHED_QOS)

#: One message for each tick of a trial.
PER_TICK = (TASK_STATE, WRENCH, COMMAND, DECISION, END_EFFECTOR)

#: What a recorded trial holds besides: the three of them together have one message for each tick.
BY_VERDICT = (ACCEPTED, REJECTED, REPLACED)

START_SERVICE = "trial/start"
ABORT_SERVICE = "trial/abort"
RESET_SERVICE = "trial/reset"

#: Frames of the messages' headers.
TASK_FRAME = "task"
SENSOR_FRAME = "force_sensor"
BASE_FRAME = "robot_base"
