"""The base of every node of the rig: parameters, the loop's endpoints, arming for a trial, reports and diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Thread
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from mig_interfaces.msg import NodeReport, TrialState
from rig_runtime import topics
from rig_runtime.diagnostics import Diagnostics
from rig_runtime.faults import FaultLatch, Loss, in_words
from rig_runtime.parameters import NodeParameters, refuse_unknown_types
from rig_runtime.realtime import collect_garbage
from rig_runtime.stages import StageTimes
from rig_runtime.ticks import NANOSECONDS, TickClock, from_stamp
from rig_runtime.topics import Topic
from rig_runtime.wire import LAST_SECOND, MalformedError

#: [s] How often matched endpoints are looked at while a trial is being armed.
_MATCHING_PERIOD = 0.05

#: [s] One of four beats is for diagnostics. The two beside it repeat the report, so that the pacemaker can tell a
#: silent node from a finished one, and no tick meets both.
_BEAT = 0.25

#: The value in `/diagnostics` that names what keeps every force away; empty while nothing does.
NO_FORCE = "no force because"

#: [ns] A day, the longest trial.
_LONGEST = 86_400 * NANOSECONDS


class RigNode(Node):
    """A node of the loop.

    A subclass declares its parameters by naming configuration dataclasses, opens its endpoints with
    :meth:`loop_publisher` and :meth:`loop_subscription`, and overrides :meth:`prepare`, :meth:`arm`, :meth:`diagnose`
    and :meth:`finish` as it needs. Keyword arguments go to :class:`rclpy.node.Node`.
    """

    #: [s] How long its timers may stand still when the wall clock is stepped back; `rig_runtime.run` sees to it.
    longest_standstill = 0.01

    def __init__(self, name: str, *configurations: type, follows_trial: bool = True, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.parameters = NodeParameters(self, *configurations)
        #: A live clock that does not stop or jump with ROS time: watchdogs must fire whatever that does.
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.ticks_done = 0
        self.armed_uid = 0
        self.trial = TrialState()
        #: The trial's ticks; None until its t_0 is known.
        self.clock: TickClock | None = None
        self.exit_code = 0
        #: When this node's part of each tick began and what it took, where wall time paces the trial.
        self.stage = StageTimes()
        #: What keeps every force away at this moment, as far as this node knows.
        self.loss = Loss()
        #: Messages that were malformed and not taken.
        self.refused = 0
        #: How the process is scheduled, for diagnostics; set by `rig_runtime.run`.
        self.scheduling = "not by rig_runtime.run"
        #: Of its own, started by :meth:`prepare`; in real time they come just below the loop.
        self.threads_below: list[Thread] = []
        self._publishers_of_loop: dict[str, Publisher[Any]] = {}
        self._subscriptions_of_loop: dict[str, Subscription[Any]] = {}
        self._on_stop: Callable[[], None] | None = None
        self._sample = 1
        self._last_report: tuple[object, ...] = ()
        self._beats = 0
        self._report_publisher = self.create_publisher(NodeReport, topics.NODE_REPORT.name, topics.NODE_REPORT.qos)
        self._diagnostics = Diagnostics(self)
        if follows_trial:
            self.create_subscription(TrialState, topics.TRIAL_STATE.name, self.follow_trial, topics.TRIAL_STATE.qos)
        self._matching = self.create_timer(_MATCHING_PERIOD, self._report_matching, clock=self.steady)
        self._matching.cancel()
        self.create_timer(_BEAT, self._beat, clock=self.steady)

    # -- for subclasses ------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Do what takes long (compile, load) before the first tick. Called once, before the node is spun."""

    def arm(self, trial: TrialState) -> None:
        """Return to the initial state for a trial."""

    def trial_ended(self, trial: TrialState) -> None:
        """The trial that this node was armed for has finished or was aborted."""

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        """Level, one sentence and values for `/diagnostics`."""
        return DiagnosticStatus.OK, "running", {}

    def finish(self) -> None:
        """Called once, between two callbacks, before the node is destroyed."""

    # -- endpoints -----------------------------------------------------------------------------------------------

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, *args: Any, **kwargs: Any) -> Any:
        """As rclpy's; but a message that the callback finds malformed is counted, and ends nothing."""

        def take(message: Any) -> None:
            try:
                callback(message)
            except MalformedError as error:
                self.note_refused(topic, error)

        return super().create_subscription(msg_type, topic, take, *args, **kwargs)

    def note_refused(self, topic: str, error: MalformedError) -> None:
        """Count a message that was malformed and not taken, and say so."""
        self.refused += 1
        self.get_logger().warning(f"{topic}: not taken: {error}", throttle_duration_sec=1.0)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **kwargs: Any) -> Any:
        """As rclpy's; but rclpy's own parameter services refuse what has a type that there is not."""
        if srv_type in (SetParameters, SetParametersAtomically):
            callback = refuse_unknown_types(callback)
        return super().create_service(srv_type, srv_name, callback, **kwargs)

    def loop_publisher(self, topic: Topic) -> Publisher[Any]:
        """Open a publisher that the readiness proof covers."""
        publisher = self.create_publisher(topic.type, topic.name, topic.qos)
        self._publishers_of_loop[publisher.topic_name] = publisher
        return publisher

    def loop_sender(self, topic: Topic) -> Callable[[bytes], None]:
        """As :meth:`loop_publisher`; returns what publishes a serialised message, without a look at its type."""
        send: Callable[[bytes], None] = self.loop_publisher(topic).handle.publish_raw
        return send

    def loop_subscription(
        self, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False
    ) -> Subscription[Any]:
        """Open a subscription that the readiness proof covers."""
        subscription = self.create_subscription(topic.type, topic.name, callback, topic.qos, raw=raw)
        self.cover_subscription(subscription)
        return subscription

    def cover_subscription(self, subscription: Subscription[Any]) -> None:
        """Let the readiness proof cover a subscription that was opened otherwise."""
        self._subscriptions_of_loop[subscription.topic_name] = subscription

    def serve_clearing(self, service: str, latch: FaultLatch[Any]) -> None:
        """Serve the clearing of a fault that is kept; if its cause lasts, the next tick says so again."""

        def clear(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            kept = latch.clear()
            response.success, response.message = True, f"cleared: {in_words(kept)}" if kept is not None else "no fault"
            if not self.note_loss(None):
                self.publish_diagnostics()
            return response

        self.create_service(Trigger, service, clear)

    # -- the end -------------------------------------------------------------------------------------------------

    def on_stop(self, callback: Callable[[], None]) -> None:
        """Whom :meth:`stop` tells that the node is done; set by `rig_runtime.run`."""
        self._on_stop = callback

    def stop(self, exit_code: int = 0) -> None:
        """Ask whoever spins this node to end."""
        self.exit_code = max(self.exit_code, exit_code)
        if self._on_stop is not None:
            self._on_stop()

    # -- trials --------------------------------------------------------------------------------------------------

    def follow_trial(self, trial: TrialState) -> None:
        """Take note of the trial's state; whoever does not follow the topic calls this.

        Raises
        ------
        MalformedError: no pacemaker says this.
        """
        _check_trial(trial)
        was = self.trial
        self.trial = trial
        if trial.phase in (TrialState.PHASE_ARMING, TrialState.PHASE_RUNNING) and trial.uid != self.armed_uid:
            # RUNNING with another uid: this node was started again in the middle of a trial.
            self.take_trial(trial)
        if trial.phase == TrialState.PHASE_RUNNING:
            self.clock = TickClock(from_stamp(trial.epoch), self._sample)
        elif trial.uid == self.armed_uid and trial.phase >= TrialState.PHASE_FINISHED > was.phase:
            self.trial_ended(trial)

    def take_trial(self, trial: TrialState) -> None:
        """Reset for a trial and report it."""
        self.trial = trial
        self._sample = trial.sample_time.sec * NANOSECONDS + trial.sample_time.nanosec
        self.clock = None
        self.ticks_done = 0
        self.stage.reset()
        self.loss.reset()
        collect_garbage()
        self.arm(trial)
        self.armed_uid = trial.uid
        self._report()
        self._matching.reset()

    def tick_of(self, stamp: int) -> int | None:
        """The tick that a stamp [ns] belongs to, None if it is none of this trial's, or no trial is known yet."""
        if self.clock is None:
            if not self.armed_uid:
                # Started again in the middle of a trial: neither its t_0 nor its sample time has been heard.
                return None
            # The first message of a trial may overtake the announcement of its t_0 on the other topic; it is tick 0.
            self.clock = TickClock(stamp, self._sample)
        return self.clock.tick(stamp)

    # -- reports -------------------------------------------------------------------------------------------------

    def make_report(self) -> NodeReport:
        """What this node has matched at this moment."""
        report = NodeReport(node=self.get_fully_qualified_name(), armed_uid=self.armed_uid, ticks_done=self.ticks_done)
        report.publishes = list(self._publishers_of_loop)
        report.matched_subscriptions = [p.get_subscription_count() for p in self._publishers_of_loop.values()]
        report.subscribes = list(self._subscriptions_of_loop)
        report.matched_publishers = [s.get_publisher_count() for s in self._subscriptions_of_loop.values()]
        return report

    def _report_matching(self) -> None:
        if self.trial.phase == TrialState.PHASE_ARMING:
            self._report(force=False)
        else:
            # Nothing changes while ticks flow, and to be woken takes time from them.
            self._matching.cancel()

    def _beat(self) -> None:
        self._beats += 1
        if self._beats % 2:
            self._report()
        elif self._beats % 4 == 0:
            self.publish_diagnostics()

    def _report(self, force: bool = True) -> None:
        report = self.make_report()
        endpoints = (report.publishes, report.matched_subscriptions, report.subscribes, report.matched_publishers)
        said = (report.armed_uid, report.ticks_done, report.error, *endpoints)
        if not force and self._last_report == said:
            return
        self._last_report = said
        report.stamp.sec, report.stamp.nanosec = divmod(time.time_ns(), NANOSECONDS)
        self._report_publisher.publish(report)

    def note_loss(self, what: object | None) -> bool:
        """Take note of what keeps every force away now, None if nothing does; returns whether that was said at once."""
        news = self.loss.tell(what, time.monotonic_ns())
        if news:
            self.publish_diagnostics()
        return news

    def with_loss(
        self,
        level: bytes,
        message: str,
        values: dict[str, object],
        *,
        consequence: str = "no force",
        kept: object | None = None,
        service: str = "",
    ) -> tuple[bytes, str, dict[str, object]]:
        """What :meth:`diagnose` says, together with the loss that lasts or the last one, or with a fault that is kept.

        A loss that lasts is WARN, it goes by without anybody; a kept fault is ERROR, it waits for the service.
        """
        now = time.monotonic_ns()
        words, what = self.loss.words(now, consequence), self.loss.what if kept is None else kept
        if kept is not None:
            level, message = DiagnosticStatus.ERROR, f"{in_words(kept)}: no force until {service} is called"
        elif what is not None:
            level, message = DiagnosticStatus.WARN, words
        elif words:
            message = f"{message}; {words}"
        values[NO_FORCE] = "" if what is None else in_words(what)
        values["no force for [s]"] = round(self.loss.lasting(now), 3)
        return level, message, values

    def publish_diagnostics(self) -> None:
        """Publish what :meth:`diagnose` says; this happens once a second by itself."""
        level, message, values = self.diagnose()
        values = {**values, **self.stage.values(), "malformed messages": self.refused, "scheduling": self.scheduling}
        self._diagnostics.publish(self.get_clock().now().to_msg(), level, message, values)


def _check_trial(trial: TrialState) -> None:
    sample = trial.sample_time.sec * NANOSECONDS + trial.sample_time.nanosec
    if trial.phase > TrialState.PHASE_ABORTED:
        raise MalformedError(f"there is no phase {trial.phase}")
    if trial.phase != TrialState.PHASE_IDLE and not 0 < sample * (trial.ticks_planned or 1) <= _LONGEST + sample:
        raise MalformedError(f"{trial.ticks_planned} ticks of {sample} ns are no trial")
    if not (0 <= trial.epoch.sec <= LAST_SECOND and trial.epoch.nanosec < NANOSECONDS):
        raise MalformedError(f"{trial.epoch.sec} s and {trial.epoch.nanosec} ns are no beginning of a trial")
