"""The topics of the loop: names (relative, the scenario's namespace stands in front), types and quality of service.

One home for all of them; `docs/topics.md` says what each carries.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from mig_interfaces.msg import (
    EndEffectorState,
    FilterDecision,
    NodeReport,
    RecorderState,
    SessionState,
    StudyChoices,
    TaskState,
    TrialState,
)
from rig_runtime.wire import WireMessage

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

#: For what only eyes look at; a viewer that is slow may miss some.
VIEW_QOS = QoSProfile(depth=10)

#: Frames of the messages' headers.
TASK_FRAME = "task"
SENSOR_FRAME = "force_sensor"
BASE_FRAME = "robot_base"


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of the loop."""

    name: str
    type: Any
    frame: str = ""
    qos: QoSProfile = field(default_factory=lambda: DATA_QOS)

    def wire(self, **lengths: int) -> WireMessage:
        """A message of this topic to read and write in place; ``lengths`` of its sequences."""
        return WireMessage(self.type, self.frame, **lengths)


TASK_STATE = Topic("task/state", TaskState, TASK_FRAME)
WRENCH = Topic("force_sensor/wrench", WrenchStamped, SENSOR_FRAME)
COMMAND = Topic("mig_filter/command", WrenchStamped, SENSOR_FRAME)
ACCEPTED = Topic("mig_filter/accepted", WrenchStamped, SENSOR_FRAME)
REJECTED = Topic("mig_filter/rejected", WrenchStamped, SENSOR_FRAME)
REPLACED = Topic("mig_filter/replaced", WrenchStamped, SENSOR_FRAME)
DECISION = Topic("mig_filter/decision", FilterDecision, SENSOR_FRAME)
END_EFFECTOR = Topic("admittance/end_effector", EndEffectorState, BASE_FRAME)
TRIAL_STATE = Topic("trial/state", TrialState, qos=LATCHED_QOS)
NODE_REPORT = Topic("trial/reports", NodeReport, qos=REPORT_QOS)
SESSION_STATE = Topic("conductor/state", SessionState, qos=LATCHED_QOS)
STUDY_CHOICES = Topic("conductor/choices", StudyChoices, qos=LATCHED_QOS)
RECORDER_STATE = Topic("recorder/state", RecorderState, qos=LATCHED_QOS)

#: For RViz and Foxglove: the task's picture and its state, a few times a second.
MARKERS = Topic("task/markers", MarkerArray, TASK_FRAME, VIEW_QOS)
JOINT_STATES = Topic("task/joint_states", JointState, TASK_FRAME, VIEW_QOS)

#: One message for each tick of a trial.
PER_TICK = (TASK_STATE, WRENCH, COMMAND, DECISION, END_EFFECTOR)

#: What a recorded trial holds besides: the three of them together have one message for each tick.
BY_VERDICT = (ACCEPTED, REJECTED, REPLACED)

START_SERVICE = "trial/start"
ABORT_SERVICE = "trial/abort"
RESET_SERVICE = "trial/reset"

#: Of the conductor of a session: the next trial waits; goes on; the last one again; whose session is next.
PAUSE_SERVICE = "conductor/pause"
RESUME_SERVICE = "conductor/resume"
REPEAT_SERVICE = "conductor/repeat"
CHOOSE_SERVICE = "conductor/choose"

#: Where a fault that was kept (`recovery: explicit`) is cleared.
CLEAR_FILTER_SERVICE = "mig_filter/clear_fault"
CLEAR_ROBOT_SERVICE = "admittance/clear_fault"
