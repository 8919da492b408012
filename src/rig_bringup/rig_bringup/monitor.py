"""Watches a running graph through its topics: how far the trial is, what the filter decided, when the bag is closed."""

from __future__ import annotations

from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from mig_interfaces.msg import RecorderState, TrialState
from rig_runtime import topics
from rig_runtime.run import make_executor


class Monitor:
    """A node of its own in this process. Context manager; `wait` serves it."""

    def __init__(self, namespace: str) -> None:
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("rig_monitor", namespace=namespace, context=self._context)
        self._executor = make_executor(self._context)
        self._executor.add_node(self._node)
        self._prefix = f"/{namespace}"
        self.trial: TrialState | None = None
        self.recorder: RecorderState | None = None
        self.values: dict[str, dict[str, str]] = {}
        for topic, callback in ((topics.TRIAL_STATE, self._on_trial), (topics.RECORDER_STATE, self._on_recorder)):
            self._node.create_subscription(topic.type, topic.name, callback, topic.qos)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, QoSProfile(depth=50))

    def __enter__(self) -> Monitor:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def wait(self, seconds: float) -> None:
        """Serve for up to this long; returns earlier when something has come."""
        self._executor.spin_once(timeout_sec=seconds)

    @property
    def over(self) -> bool:
        """Whether the trial has ended."""
        return self.trial is not None and self.trial.phase in (TrialState.PHASE_FINISHED, TrialState.PHASE_ABORTED)

    @property
    def bag_closed(self) -> bool:
        """Whether the recorder has said that the bag is closed."""
        return self.recorder is not None and not self.recorder.recording

    def progress(self) -> str:
        """One line for a person."""
        trial = self.trial
        if trial is None:
            return "starting the graph"
        if trial.phase in (TrialState.PHASE_IDLE, TrialState.PHASE_ARMING):
            return trial.message
        pacing = self.values.get(f"{self._prefix}/task_sim", {})
        judging = self.values.get(f"{self._prefix}/mig_filter", {})
        end = trial.ticks_planned * (trial.sample_time.sec + 1e-9 * trial.sample_time.nanosec)
        time = end if trial.phase == TrialState.PHASE_FINISHED else float(pacing.get("trial time [s]", 0.0))
        return f"{time:6.2f} of {end:.2f} s   {_shares(judging)}   missed {pacing.get('missed deadlines', 0)}"

    def speed(self) -> float | None:
        """Trial time over wall time of a trial that has ended; None before."""
        pacing = self.values.get(f"{self._prefix}/task_sim", {})
        wall = float(pacing.get("wall time [s]", 0.0))
        return float(pacing["trial time [s]"]) / wall if self.over and wall > 0.0 else None

    @property
    def pace_known(self) -> bool:
        """Whether a trial in lockstep that ran to its end has said how fast; of others nobody asks."""
        trial = self.trial
        asked = trial is not None and trial.pacing == TrialState.PACING_LOCKSTEP
        return not asked or trial.phase != TrialState.PHASE_FINISHED or self.speed() is not None

    def _on_trial(self, message: TrialState) -> None:
        self.trial = message

    def _on_recorder(self, message: RecorderState) -> None:
        self.recorder = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.values[status.name] = {pair.key: pair.value for pair in status.values}


def _shares(judging: dict[str, Any]) -> str:
    total = max(int(judging.get("ticks", 0)), 1)
    names = ("accepted", "rejected", "replaced")
    return "  ".join(f"{name} {100 * int(judging.get(name, 0)) / total:3.0f} %" for name in names)
