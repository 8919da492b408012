"""The shell around a simulated user: a state in, a force at the sensor out."""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from mig_interfaces.msg import TrialState
from rig_runtime import topics
from rig_runtime.node import RigNode
from rig_runtime.stages import delay_of
from rig_runtime.wire import MalformedError
from shared_control.loop import make_user
from shared_control.scenario import LoopConfig, Scenario, UserConfig

CONFIGURATIONS = (LoopConfig, UserConfig)


class UserSimNode(RigNode):
    """`task/state` in, `force_sensor/wrench` out."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("user_sim", *CONFIGURATIONS, **kwargs)
        self._loop = loop = self.parameters.get(LoopConfig)
        self._user = self.parameters.get(UserConfig)
        self._agent = make_user(Scenario(loop=loop, user=self._user), loop.seed)
        self._realtime = loop.pacing == "realtime"
        task = loop.make_task()
        self._state = topics.TASK_STATE.wire(state=task.n, control=task.m)
        self._wrench = topics.WRENCH.wire()
        #: Of a trial of a day; to draw the noise for one that is further on would take for ever.
        self._last_tick = int(86_400.0 / loop.sample_time)
        self._send = self.loop_sender(topics.WRENCH)
        self.loop_subscription(topics.TASK_STATE, self._on_state, raw=True)

    def prepare(self) -> None:
        self._agent.warm_up()

    def arm(self, trial: TrialState) -> None:
        user = self.parameters.get(UserConfig)
        if user != self._user:
            self._user = user
            self._agent = make_user(Scenario(loop=self._loop, user=user), trial.seed)
            self._agent.warm_up()
        self._agent.reset(trial.seed)

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        return DiagnosticStatus.OK, "pushing", {"ticks": self.ticks_done}

    def _on_state(self, data: bytes) -> None:
        begin = time.monotonic_ns()
        state, wrench = self._state, self._wrench
        state.load(data)
        if state["tick"] > self._last_tick:
            raise MalformedError(f"no trial has a tick {state['tick']}")
        wrench["wrench.force"] = self._agent.act(state["tick"], state["time"], state["state"], state["mode"])
        wrench.take_stamp(state)
        if self._realtime:
            compute_time = 1e-9 * (time.monotonic_ns() - begin)
            self.stage.add(delay_of(state.stamp) - compute_time, compute_time)
        self._send(wrench.data)
        self.ticks_done += 1
