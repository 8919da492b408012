"""The shell around a simulated user: a state in, a force at the sensor out."""

from __future__ import annotations

from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped

from mig_interfaces.msg import TaskState, TrialState
from rig_runtime import topics
from rig_runtime.node import RigNode
from shared_control.loop import make_user
from shared_control.scenario import LoopConfig, Scenario, UserConfig

CONFIGURATIONS = (LoopConfig, UserConfig)


class UserSimNode(RigNode):
    """`task/state` in, `force_sensor/wrench` out."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("user_sim", *CONFIGURATIONS, **kwargs)
        loop = self.parameters.get(LoopConfig)
        self._agent = make_user(Scenario(loop=loop, user=self.parameters.get(UserConfig)), loop.seed)
        self._wrench = WrenchStamped()
        self._wrench.header.frame_id = topics.SENSOR_FRAME
        self._publisher = self.loop_publisher(topics.WRENCH)
        self.loop_subscription(topics.TASK_STATE, self._on_state)

    def prepare(self) -> None:
        self._agent.warm_up()

    def arm(self, trial: TrialState) -> None:
        self._agent.reset(trial.seed)

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        return DiagnosticStatus.OK, "pushing", {"ticks": self.ticks_done}

    def _on_state(self, state: TaskState) -> None:
        force = self._agent.act(state.tick, state.time, np.asarray(state.state), state.mode)
        wrench = self._wrench
        wrench.header.stamp = state.header.stamp
        wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z = force.tolist()
        self._publisher.publish(wrench)
        self.ticks_done += 1
