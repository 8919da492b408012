"""The shell around the admittance-controlled robot: an admitted force in, the end effector's motion out."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticStatus

from mig_interfaces.msg import TrialState
from rig_runtime import topics
from rig_runtime.faults import FaultLatch, Lateness, Silence
from rig_runtime.node import RigNode
from rig_runtime.stages import delay_of
from rig_runtime.ticks import to_nanoseconds
from shared_control.loop import make_robot
from shared_control.scenario import AdmittanceConfig, LoopConfig, Scenario

#: [ticks] That a command may be ahead by, besides the time that has passed.
_LEAD = 100

_NO_COMMAND = "no command came in time"

CONFIGURATIONS = (LoopConfig, AdmittanceConfig)


class AdmittanceSimNode(RigNode):
    """`mig_filter/command` in, `admittance/end_effector` out.

    In real time, when no command comes for `command_timeout`, the robot goes on under no force, tick by tick, and says
    so; a command for a tick that has passed this way is dropped. One that is late by `command_timeout`, against the
    trial's least late one, is none, so that a stream of such is silence. A command that is not finite is no force. With
    `recovery: explicit` no force counts from either on, nor after this node itself has stood still for
    `command_timeout` or was started in the middle of a trial, until `admittance/clear_fault` is called or a new trial
    begins.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("admittance_sim", *CONFIGURATIONS, **kwargs)
        loop = self.parameters.get(LoopConfig)
        self._agent = make_robot(Scenario(loop=loop, robot=self.parameters.get(AdmittanceConfig)))
        self._dropped = self._late = self._gaps = self._losses = 0
        self._sample_time = loop.sample_time
        self._realtime = loop.pacing == "realtime"
        self._silence = Silence(loop.command_timeout)
        self._lost_at = self._armed_at = 0
        self._timeout = to_nanoseconds(loop.command_timeout)
        self._lateness = Lateness(self._timeout)
        self._looked = 0  # [ns] when the watchdog last looked; 0 before it does
        self._latch: FaultLatch[str] = FaultLatch(loop.recovery == "explicit")
        self._refused: str | None = None  # why the last command was no force
        self._zero = np.zeros(3)
        self._command = topics.COMMAND.wire()
        self._state = topics.END_EFFECTOR.wire()
        self._send = self.loop_sender(topics.END_EFFECTOR)
        self.loop_subscription(topics.COMMAND, self._on_command, raw=True)
        if self._realtime:
            self.create_timer(self._silence.period, self._watchdog, clock=self.steady)
        self.serve_clearing(topics.CLEAR_ROBOT_SERVICE, self._latch)

    def prepare(self) -> None:
        self._agent.warm_up()

    def arm(self, trial: TrialState) -> None:
        self._agent.reset()
        self._armed_at = time.monotonic_ns()
        self._dropped = self._late = self._gaps = self._losses = 0
        self._lateness.reset()
        self._refused = None
        self._silence.heard()
        self._latch.clear()
        if trial.phase == TrialState.PHASE_RUNNING:
            self._latch.hold("it was started in the middle of a trial")

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        level = DiagnosticStatus.WARN if self._dropped or self._late or self._gaps else DiagnosticStatus.OK
        values: dict[str, object] = {
            "ticks": self.ticks_done,
            "dropped": self._dropped,
            "late": self._late,
            "ticks without command": self._gaps,
            "times without command": self._losses,
        }
        return self.with_loss(level, "moving", values, kept=self._latch.kept, service=topics.CLEAR_ROBOT_SERVICE)

    def _watchdog(self) -> None:
        self._notice_sleep(time.monotonic_ns())
        lost, kept = self._stand_in(), self._latch.kept
        # Said when it is done: words can wait.
        self.note_loss(kept if kept is not None else lost)

    def _stand_in(self) -> str | None:
        """Go on under no force while no command comes; returns what is lost, the commands or what the last one said."""
        # Before its first command of a trial the robot stands, and after its last tick it has nothing to follow.
        if self.trial.phase != TrialState.PHASE_RUNNING or not self.ticks_done:
            return None
        was_silent = self._silence.silent
        if not self._silence.look():
            return self._refused
        # Again at each look: to clear it while the silence lasts is to clear what has not been lost yet.
        self._latch.hold(_NO_COMMAND)
        if not was_silent:
            self._lost_at = self.ticks_done
        # One less than have been due: the task takes no motion for a tick that it has not published yet.
        passed = self._lost_at + int(self._silence.lasting / self._sample_time) - 1
        while self.ticks_done < min(passed, self.trial.ticks_planned):
            self._move(self.ticks_done, self._zero)
            self._gaps += 1
        if not was_silent:
            self._losses += 1
            self.get_logger().error(
                f"no command for {self._silence.lasting:.3g} s: no force", throttle_duration_sec=1.0
            )
        return _NO_COMMAND

    def _notice_sleep(self, now: int) -> None:
        """What waited while this node stood still is nothing to go on with where a person is at the robot."""
        if self._looked and now - self._looked > self._timeout and self.trial.phase == TrialState.PHASE_RUNNING:
            self._latch.hold("it stood still itself")
        self._looked = now

    def _on_command(self, data: bytes) -> None:
        begin = time.monotonic_ns()
        if self._looked:
            self._notice_sleep(begin)
        command = self._command
        command.load(data)
        tick = self.tick_of(command.stamp)
        # To catch up with a stamp that is further ahead than time can be would only hold up what is true.
        if tick is None or tick - self.ticks_done > self._most_ahead():
            self._dropped += 1
            return
        if self._realtime and self._lateness.late(command.stamp, begin):
            # Not heard: the robot goes on under no force for as long as nothing else comes.
            self._late += 1
            return
        self._silence.heard()
        if tick < self.ticks_done:
            # In time, but the robot has gone on without it; it waits here until the loop has come level.
            self._dropped += 1
            return
        if not self.ticks_done:
            # Started again in the middle of a trial: under no force it would still be at rest.
            self.ticks_done, self._gaps = tick, tick
        while self.ticks_done < tick:
            # Nothing was admitted for these ticks, and the robot has moved on under no force.
            self._agent.step(self._zero)
            self.ticks_done += 1
            self._gaps += 1
        force, self._refused = command["wrench.force"], None
        if not all(map(math.isfinite, force.tolist())):
            self._dropped += 1
            self._refused = self._latch.hold("the command is not finite")
            force = self._zero
        self._move(tick, force if self._latch.kept is None else self._zero, begin)

    def _most_ahead(self) -> int:
        """[ticks] How far a command may be ahead of the robot."""
        if not self.ticks_done:
            return self.trial.ticks_planned
        return _LEAD + int(1e-9 * (time.monotonic_ns() - self._armed_at) / self._sample_time)

    def _move(self, tick: int, force: npt.NDArray[np.float64], begin: int = 0) -> None:
        assert self.clock is not None
        state, motion = self._state, self._agent.step(force)
        state.stamp = self.clock.stamp(tick)
        state["tick"] = tick
        state["force"] = force
        state["position"] = motion.position
        state["velocity"] = motion.velocity
        state["acceleration"] = motion.acceleration
        state["reference_velocity"] = motion.reference_velocity
        if self._realtime:
            self._note_times(begin)
        self._send(state.data)
        self.ticks_done += 1

    def _note_times(self, begin: int) -> None:
        """Of a command received at a time [ns], 0 if none was."""
        state, delay, compute_time = self._state, 0.0, 0.0
        if begin:
            compute_time = 1e-9 * (time.monotonic_ns() - begin)
            delay = delay_of(state.stamp) - compute_time
            self.stage.add(delay, compute_time)
        state["delay"], state["compute_time"] = delay, compute_time
