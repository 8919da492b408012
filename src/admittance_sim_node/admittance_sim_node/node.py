"""The shell around the admittance-controlled robot: an admitted force in, the end effector's motion out."""

from __future__ import annotations

from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from mig_interfaces.msg import TrialState
from rig_runtime import topics
from rig_runtime.node import RigNode
from shared_control.loop import make_robot
from shared_control.scenario import AdmittanceConfig, LoopConfig, Scenario

CONFIGURATIONS = (LoopConfig, AdmittanceConfig)


class AdmittanceSimNode(RigNode):
    """`mig_filter/command` in, `admittance/end_effector` out."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("admittance_sim", *CONFIGURATIONS, **kwargs)
        self._agent = make_robot(
            Scenario(loop=self.parameters.get(LoopConfig), robot=self.parameters.get(AdmittanceConfig))
        )
        self._dropped = 0
        self._gaps = 0
        self._zero = np.zeros(3)
        self._command = topics.COMMAND.wire()
        self._state = topics.END_EFFECTOR.wire()
        self._publisher = self.loop_publisher(topics.END_EFFECTOR)
        self.loop_subscription(topics.COMMAND, self._on_command, raw=True)

    def prepare(self) -> None:
        self._agent.warm_up()

    def arm(self, trial: TrialState) -> None:
        self._agent.reset()
        self._dropped = self._gaps = 0

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        level = DiagnosticStatus.WARN if self._dropped or self._gaps else DiagnosticStatus.OK
        values = {"ticks": self.ticks_done, "dropped": self._dropped, "ticks without command": self._gaps}
        return level, "moving", values

    def _on_command(self, data: bytes) -> None:
        command, state = self._command, self._state
        command.load(data)
        tick = self.tick_of(command.stamp)
        if tick is None or tick < self.ticks_done:
            self._dropped += 1
            return
        while self.ticks_done < tick:
            # Nothing was admitted for these ticks, and the robot has moved on under no force.
            self._agent.step(self._zero)
            self.ticks_done += 1
            self._gaps += 1
        motion = self._agent.step(command["wrench.force"])
        state.stamp = command.stamp
        state["tick"] = tick
        state["force"] = command["wrench.force"]
        state["position"] = motion.position
        state["velocity"] = motion.velocity
        state["acceleration"] = motion.acceleration
        state["reference_velocity"] = motion.reference_velocity
        self._publisher.publish(state.data)
        self.ticks_done += 1
