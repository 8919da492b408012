"""The shell around the hand on the page: a state in, the hand's force out; everything else is for the eyes."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped

from mig_interfaces.msg import (
    FilterDecision,
    NodeReport,
    RecorderState,
    SessionState,
    StudyChoices,
    TaskState,
    TrialState,
)
from rig_display.desk import FILTER, GraphDesk
from rig_display.feed import Feed
from rig_display.gate import Gate
from rig_display.hand import STALLED, Hand
from rig_display.latency import Window
from rig_display.losses import Losses
from rig_display.parameters import DisplayConfig
from rig_display.seat import Seat
from rig_display.server import PageServer, ServerError
from rig_runtime import topics
from rig_runtime.node import NO_FORCE, RigNode
from rig_runtime.ticks import to_nanoseconds
from shared_control.parameters import ParameterError
from shared_control.scenario import LoopConfig

CONFIGURATIONS = (LoopConfig, DisplayConfig)

#: [s] How often it is looked whether the hand or a node has become silent, so that it is said when it happens.
_WATCH_PERIOD = 0.1


class DisplayNode(RigNode):
    """`task/state` in, `force_sensor/wrench` out, in place of `user_sim`; serves the pages.

    Raises
    ------
    ParameterError: lockstep, an address without its token, a port that is taken, limits that are not three.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("display", *CONFIGURATIONS, **kwargs)
        loop, config = self.parameters.get(LoopConfig), self.parameters.get(DisplayConfig)
        if loop.pacing != "realtime":
            raise ParameterError(f"display: pacing {loop.pacing!r} is not allowed; a person needs pacing: realtime")
        self._loop, self._config = loop, config
        self._task = loop.make_task()
        self.hand = Hand(self._limits(), to_nanoseconds(config.stale_after))
        self.feed = Feed()
        self.latency = Window()
        self._desk = GraphDesk(self)
        self.seat = Seat(config, self.hand, self.feed, self._desk, self.latency, self._describe)
        token = config.token or os.environ.get("RIG_DISPLAY_TOKEN", "")
        self.server = PageServer(config, Gate(config.host, token), self.seat)
        self.feed.wake = self.server.wake
        self.parameters.on_change(self._reconfigure)
        self._reason = ""
        self._losses = Losses(loop.command_timeout)
        self._zeroed_ticks = 0
        self._wrench = WrenchStamped()
        self._wrench.header.frame_id = topics.SENSOR_FRAME
        self._publisher = self.loop_publisher(topics.WRENCH)
        self.loop_subscription(topics.TASK_STATE, self._on_state)
        self.loop_subscription(topics.DECISION, self._on_decision)
        for topic, take in (
            (topics.RECORDER_STATE, self._on_recorder),
            (topics.SESSION_STATE, self._on_session),
            (topics.STUDY_CHOICES, self._on_choices),
        ):
            self.create_subscription(topic.type, topic.name, take, topic.qos)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.create_timer(_WATCH_PERIOD, self._watch, clock=self.steady)
        self.create_timer(self._losses.period, lambda: self._losses.look(self._running), clock=self.steady)

    # -- life ----------------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        try:
            self.server.start()
        except ServerError as error:
            raise ParameterError(str(error)) from error
        # Hands come in by it; but no page is served before a tick.
        self.threads_below = [self.server.thread]
        self.get_logger().info(f"the page is at {self.address}")

    @property
    def address(self) -> str:
        """Where a browser on this machine finds the page."""
        host = self._config.host if self._config.host not in ("0.0.0.0", "::") else "127.0.0.1"  # noqa: S104
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.port}/"

    def destroy_node(self) -> None:
        self.server.stop()
        super().destroy_node()

    def arm(self, trial: TrialState) -> None:
        self.latency.clear()
        self.seat.arrival.clear()
        self._losses.reset()
        self._zeroed_ticks = 0

    def follow_trial(self, trial: TrialState) -> None:
        super().follow_trial(trial)
        self.feed.put_trial(trial)
        self.server.call(self.seat.on_change)
        if trial.phase <= TrialState.PHASE_ARMING:
            self._desk.read_filter(self._on_filter)

    def make_report(self) -> NodeReport:
        report = super().make_report()
        if self.seat.driver is None:
            # Said in trial/state while a trial waits for it, however it was begun.
            report.error = f"nobody drives yet; the page is at {self.address}"
        return report

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        seat, hand, pointer, arrival = self.seat, self.hand, self.latency.spread(), self.seat.arrival.spread()
        driver = seat.driver
        values: dict[str, object] = {
            "ticks": self.ticks_done,
            "ticks without a hand": self._zeroed_ticks,
            "zero because": self._reason,
            "pages": len(seat.clients),
            "messages refused": seat.refused,
            "forces clipped": hand.clipped,
            "pointer to display p50 [ms]": round(arrival.p50, 3),
            "pointer to display p99 [ms]": round(arrival.p99, 3),
            "pointer to wrench p50 [ms]": round(pointer.p50, 3),
            "pointer to wrench p99 [ms]": round(pointer.p99, 3),
            "pointer to wrench largest [ms]": round(pointer.largest, 3),
        }
        if driver is not None:
            values |= {
                "state to drawn p50 [ms]": driver.drawn.p50,
                "state to drawn p99 [ms]": driver.drawn.p99,
                "state to drawn largest [ms]": driver.drawn.largest,
                "round trip [ms]": driver.round_trip,
                "frames [1/s]": driver.frames,
            }
        bad = hand.stopped_by or self._reason == STALLED
        return DiagnosticStatus.WARN if bad else DiagnosticStatus.OK, self._reason or "a hand is on the page", values

    # -- the loop ------------------------------------------------------------------------------------------------

    def _on_state(self, state: TaskState) -> None:
        received = time.monotonic_ns()
        sample = self.hand.take(received)
        wrench = self._wrench
        wrench.header.stamp = state.header.stamp
        wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z = sample.force
        self._publisher.publish(wrench)
        published = time.monotonic_ns()
        self.ticks_done += 1
        self._losses.states.heard()
        self._zeroed_ticks += bool(sample.reason)
        latency = None
        for event in sample.events:
            latency = round(1e-6 * (published - event), 3)
            self.latency.add(latency)
        self.feed.put_state(state, sample, received, latency)

    def _on_decision(self, decision: FilterDecision) -> None:
        self._losses.decided(*self.feed.put_decision(decision))
        self._tell_loss()

    def _on_recorder(self, state: RecorderState) -> None:
        self.feed.put_recorder(state)

    def _on_session(self, state: SessionState) -> None:
        self.feed.put_session(state)
        self.server.call(self.seat.on_change)

    def _on_choices(self, choices: StudyChoices) -> None:
        self.feed.put_choices(choices)
        self.server.call(self.seat.offer)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        home = self.get_namespace().rstrip("/") + "/"
        for status in array.status:
            if not status.name.startswith(home):
                continue
            node = status.name.removeprefix(home)
            because = next((pair.value for pair in status.values if pair.key == NO_FORCE), "")
            failed = status.level == DiagnosticStatus.ERROR
            if self.feed.put_error(node, status.message if failed else None, because):
                self.server.call(self.seat.on_change)
            # What waits for somebody is shown by itself, and of the filter the decisions say more.
            self._losses.hear(node, "" if failed or node == FILTER else because, time.monotonic_ns())

    @property
    def _running(self) -> bool:
        return self.trial.phase == TrialState.PHASE_RUNNING and self.ticks_done > 0

    def _tell_loss(self) -> None:
        if self._losses.decisions.silent:
            self.feed.decision = None
        self.feed.loss, news = self._losses.tell(time.monotonic_ns(), self._running)
        if news:
            self.server.call(self.seat.on_change)

    def _watch(self) -> None:
        self._tell_loss()
        reason = self.hand.reason(time.monotonic_ns())
        if reason != self._reason:
            self._reason = reason
            self.publish_diagnostics()
            self.server.call(self.seat.on_change)

    # -- what the pages are told ---------------------------------------------------------------------------------

    def _on_filter(self, mode: str, target: tuple[float, ...]) -> None:
        self.feed.mode = mode
        if target != self.feed.target:
            self.feed.target = target
            self.server.call(self.seat.describe_again)

    def _reconfigure(self) -> None:
        self.seat.feedback = self.parameters.get(DisplayConfig).feedback
        self.server.call(self.seat.on_change)

    def _limits(self) -> tuple[float, float, float]:
        given = self._config.force_limits
        if len(given) not in (0, 3):
            raise ParameterError(f"force_limits: {given!r} is not allowed; it must be three numbers, along x, y, z [N]")
        x, y, z = (
            given or self._task.wrench_from_control(np.array(self._task.control_limits), self._loop.robot).tolist()
        )
        return abs(x), abs(y), abs(z)

    def _describe(self) -> dict[str, Any]:
        task, config = self._task, self._config
        return {
            "type": "task",
            "name": task.name,
            "states": [list(pair) for pair in zip(task.state_names, task.state_units, strict=True)],
            "angles": list(task.angles),
            "initial": task.initial_state.tolist(),
            "scene": task.scene(self.feed.target or task.target),
            "sample": self._loop.sample_time,
            "dwell": task.success_dwell,
            "limits": list(self.hand.limits),
            "hand": config.hand,
            "stiffness": config.spring_stiffness,
            "damping": config.spring_damping,
            "driver_starts": config.driver_starts,
        }
