"""The recorder node: raw subscriptions in, one bag out, or one for each trial.

It publishes how far it is on ``recorder/state``; in lockstep the pacemaker follows that, so that a slow disk slows the
run and loses nothing.
"""

from __future__ import annotations

import atexit
import datetime
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from mig_interfaces.msg import NodeReport, RecorderState, TrialState
from rig_bag import definitions
from rig_bag.configuration import QUEUE_DEPTH, RecorderConfig
from rig_bag.errors import BagError
from rig_bag.opening import open_bag, place_of
from rig_bag.qos import Qos, load_overrides
from rig_bag.recording import Recording, Stream, Trial
from rig_bag.selection import Selection
from rig_bag.watch import PublisherWatch, SteadyWallClock
from rig_runtime import topics
from rig_runtime.node import RigNode
from rig_runtime.run import run
from rig_runtime.surroundings import scheduling
from rig_runtime.wire import decode
from shared_control.parameters import ParameterError
from shared_control.scenario import LoopConfig

__all__ = ["RecorderNode", "main"]

_SEARCH_PERIOD = 0.05  # [s] between looks for publishers while a listed topic has none
_WATCH_PERIOD = 1.0  # [s] the same once all are there, for patterns; and between flushes
_SETTLE_PERIOD = 0.02  # [s] of silence that ends a recording which has everything
_now = time.monotonic
_wall = time.time_ns


class RecorderNode(RigNode):
    """Records topics into a bag, from construction until the trial ends, :meth:`close` is called, or the node is
    destroyed; with ``split: trial`` into a bag for each trial, from its announcement until it ends.

    Its parameters are those of :class:`rig_bag.configuration.RecorderConfig`, all read-only, and ``pacing``; keyword
    arguments are those of ``rclpy.node.Node``.

    Raises
    ------
    BagError: the bag cannot be opened.
    """

    def __init__(self, node_name: str = "recorder", **kwargs: Any) -> None:
        super().__init__(node_name, LoopConfig, RecorderConfig, follows_trial=False, **kwargs)
        #: Done when the bag is closed; the result is the reason.
        self.closed = Future()
        self.recording: Recording | None = None
        self._subscriptions_of: dict[str, Any] = {}
        #: What each subscribed topic is declared as in a bag: type, QoS of its publishers, hash of the type.
        self._declared: dict[str, tuple[str, list[Qos], str]] = {}
        #: Where each topic goes in the bag that is open.
        self._streams: dict[str, Stream] = {}
        self._skipped: set[str] = set()
        self._wall_clock = SteadyWallClock(_wall)
        self._publishers_watched = PublisherWatch()
        #: Of a trial whose publisher has vanished: ticks received by then, and until when others are waited for.
        self._abandoned: tuple[int, float] | None = None
        self._settle: Any = None
        self._settled_at = self._settled_ticks = 0
        self._recorded_uid = 0
        self._reason = ""
        #: Whether something is missing in the bag because it could not be written.
        self.failed = False
        try:
            self._open()
        except BaseException:
            super().destroy_node()
            raise

    def _open(self) -> None:
        self.config = config = self.parameters.get(RecorderConfig)
        self._splits = config.split == "trial"
        self._selection = Selection(
            everything=config.all,
            regex=config.regex,
            exclude_regex=config.exclude_regex,
            exclude=[self.resolve_topic_name(topic) for topic in config.exclude_topics if topic],
            hidden=config.include_hidden_topics,
        )
        self._trial_topic = self.resolve_topic_name(topics.TRIAL_STATE.name)
        self._report_topic = self.resolve_topic_name(topics.NODE_REPORT.name)
        self._wanted = [self.resolve_topic_name(topic) for topic in config.topics if topic]
        path = config.qos_profile_overrides_path
        self._qos_overrides = load_overrides(path) if path else {}
        if config.follow_trial and self._trial_topic not in self._wanted:
            self._wanted.append(self._trial_topic)
        self._groups = [
            "|".join(self.resolve_topic_name(topic) for topic in group.split("|"))
            for group in config.per_tick_topics
            if group
        ]
        announced = topics.RECORDER_STATE
        self._publisher = self.create_publisher(announced.type, announced.name, announced.qos)
        self._state = RecorderState()
        atexit.register(self.close, "the process ended")
        place = config.uri or datetime.datetime.now().astimezone().strftime("rosbag2_%Y_%m_%d-%H_%M_%S")
        if self._splits:
            self.path = Path(place)
            self._publish_state()
        else:
            self._begin(Path(place))
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._search = self.create_timer(_SEARCH_PERIOD, self._look_for_publishers, clock=clock)
        self._watching = self.create_timer(_WATCH_PERIOD, self._watch, clock=clock)
        self._settle = self.create_timer(_SETTLE_PERIOD, self._check_settled, clock=clock)
        self._settle.cancel()
        self._look_for_publishers()

    def _begin(self, place: Path) -> None:
        """Open a bag; BagError if that cannot be."""
        config = self.config
        limits = {"max_size": config.max_bag_size, "max_duration": round(config.max_bag_duration * 1e9)}
        writer = open_bag(place, config.attachments, **limits)
        writer.set_custom_data(dict(pair.split("=", 1) for pair in config.custom_data if "=" in pair))
        self.path = writer.path
        self._wall_clock.begin()
        recording = Recording(
            writer,
            per_tick=self._groups,
            lockstep=self.parameters.get(LoopConfig).pacing == "lockstep",
            progress_ticks=config.progress_ticks,
            on_progress=self._publish_state,
        )
        for topic, declared in self._declared.items():
            self._streams[topic] = recording.add_topic(topic, *declared)
        # From the first moment on a bag that is cut says what it is of.
        writer.flush()
        self.recording = recording
        self._reason = ""
        self._publish_state()
        self.get_logger().info(f"recording to {self.path}")

    # -- readiness ---------------------------------------------------------------------------------------------------

    def topics_wanted(self) -> tuple[str, ...]:
        """Fully qualified names of the topics that are listed (those of a pattern are not known in advance)."""
        return tuple(self._wanted)

    def matched(self) -> dict[str, int]:
        """How many publishers each wanted or subscribed topic is matched with; 0 before it is subscribed."""
        result = dict.fromkeys(self._wanted, 0)
        for topic, subscription in self._subscriptions_of.items():
            result[topic] = subscription.get_publisher_count()
        return result

    def make_report(self) -> NodeReport:
        report = super().make_report()
        # Of the listed topics, those of the loop must have a publisher before a trial starts; others may never get one.
        names = {name for group in self.config.per_tick_topics for name in group.split("|") if name}
        needed = {self.resolve_topic_name(name) for name in names} & set(self._wanted)
        matched = {topic: count for topic, count in self.matched().items() if topic in needed}
        report.subscribes, report.matched_publishers = list(matched), list(matched.values())
        if self.recording is None and (self.failed or not self._splits):
            report.error = f"its bag is closed: {self._reason}"
        return report

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        if self.recording is None:
            # Between two trials this is how the last one ended.
            return DiagnosticStatus.ERROR if self.failed else DiagnosticStatus.OK, self._reason, {}
        lost = self.recording.lost()
        values: dict[str, object] = {"messages": self.recording.writer.messages, "lost": lost, "bag": self.path}
        return DiagnosticStatus.WARN if lost else DiagnosticStatus.OK, "recording", values

    def finish(self) -> None:
        self.close("the recorder was told to end")
        self._end()
        self.exit_code = int(self.failed)

    # -- topics ------------------------------------------------------------------------------------------------------

    def _look_for_publishers(self) -> None:
        if self.closed.done():
            return
        # One cheap question for all topics; that for a topic's publishers costs twenty times as much.
        for topic, _ in self.get_topic_names_and_types():
            if topic not in self._subscriptions_of and (topic in self._wanted or self._selection.takes(topic)):
                self._subscribe(topic)
        if all(topic in self._subscriptions_of or topic in self._skipped for topic in self._wanted):
            if not self._selection.empty:
                self._search.timer_period_ns = int(_WATCH_PERIOD * 1e9)
            else:
                self._search.cancel()

    def _subscribe(self, topic: str) -> None:
        """Subscribe to a topic if it has a publisher."""
        if topic in self._skipped:
            return
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        types = sorted({info.topic_type for info in publishers})
        try:
            if len(types) > 1:
                raise BagError(f"its publishers disagree on its type: {', '.join(types)}")
            message_type = definitions.message_class(types[0])
            qos_of_publishers = [Qos.from_rclpy(info.qos_profile) for info in publishers]
            declared = (types[0], qos_of_publishers, str(publishers[0].topic_type_hash))
            if self.recording is not None:
                self._streams[topic] = self.recording.add_topic(topic, *declared)
                self.recording.writer.flush()
            self._declared[topic] = declared
        except BagError as error:
            self._skipped.add(topic)
            self.get_logger().warning(f"{topic} is not recorded: {error}")
            return
        profile = self._qos_for(topic, [info.qos_profile for info in publishers])
        subscribe = partial(self.create_subscription, message_type, topic, self._callback(topic), profile, raw=True)
        try:
            subscription = subscribe(event_callbacks=self._events(topic))
        except UnsupportedEventTypeError:
            subscription = subscribe()
        self._subscriptions_of[topic] = subscription

    def _qos_for(self, topic: str, profiles: Sequence[QoSProfile]) -> QoSProfile:
        """The strictest that every publisher can serve, or what was asked for."""
        if topic in self._qos_overrides:
            return self._qos_overrides[topic].to_rclpy()
        reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
        latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=QUEUE_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

    def _events(self, topic: str) -> SubscriptionEventCallbacks:
        """What the middleware says of a subscription besides its messages."""

        def lost(event: Any) -> None:
            self.get_logger().warning(f"{topic}: the middleware lost {event.total_count_change} messages")
            if self.recording is not None:
                self.recording.note_lost(topic, event.total_count_change)

        return SubscriptionEventCallbacks(message_lost=lost)

    def _callback(self, topic: str) -> Callable[[bytes], None]:
        # The bag's own time: a log whose times go back could not be played.
        now, clock = time.monotonic_ns, self._wall_clock
        streams = self._streams

        def take(data: bytes) -> None:
            recording = self.recording
            if recording is None:
                return
            try:
                recording.receive(streams[topic], data, now() + clock.offset)
            except BagError as error:
                self._fail(error)

        def take_report(data: bytes) -> None:
            take(data)
            if self.recording is not None:
                report = decode(data, NodeReport)
                self.recording.note_answers(report.armed_uid, report.ticks_done, report.publishes)

        def take_trial(data: bytes) -> None:
            message = decode(data, TrialState)
            if self._splits:
                self._begin_trial(Trial.from_message(message))
            take(data)
            self.follow_trial(message)
            self._on_trial(message)

        special = {self._trial_topic: take_trial, self._report_topic: take_report}
        return special.get(topic, take) if self.config.follow_trial else take

    # -- the trial ---------------------------------------------------------------------------------------------------

    def _begin_trial(self, trial: Trial) -> None:
        """Open the trial's own bag when it is announced."""
        if trial.phase != Trial.ARMING or (self.recording is not None and trial.uid == self._recorded_uid):
            return
        self.close("the next trial begins")
        self.failed = False
        try:
            self._begin(place_of(trial, Path(self.config.uri or ".")))
        except BagError as error:
            self._fail(error)

    def _on_trial(self, message: TrialState) -> None:
        recording = self.recording
        if recording is None:
            return
        trial = Trial.from_message(message)
        if trial.under_way:
            self._recorded_uid = trial.uid
            if trial.phase == Trial.RUNNING:
                # What has no publisher by now may get one, but is not worth the ticks' time.
                self._search.timer_period_ns = int(_WATCH_PERIOD * 1e9)
        elif trial.uid != self._recorded_uid:
            # What is left over, latched, from a trial before this recording.
            return
        recording.follow(trial)
        if trial.ended:
            self._settled_at = -1
            self._settled_ticks = -1
            self._settle.reset()

    def _check_settled(self) -> None:
        """Close once everything is here and nothing more comes, or nothing has come for long enough."""
        recording = self.recording
        if recording is None or recording.trial is None:
            self._settle.cancel()
            return
        quiet = recording.writer.messages == self._settled_at
        self._settled_at = recording.writer.messages
        if recording.ticks_received() != self._settled_ticks:
            # A machine that is behind still brings what is missing: the limit is one of silence.
            self._settled_ticks = recording.ticks_received()
            self._deadline = _now() + self.config.settle_limit
        late = _now() >= self._deadline
        if (quiet and (recording.complete() or recording.trial.phase == Trial.ABORTED)) or late:
            self.close(f"trial {'finished' if recording.trial.phase == Trial.FINISHED else 'aborted'}")

    # -- the bag -----------------------------------------------------------------------------------------------------

    def _publish_state(self) -> None:
        state, recording = self._state, self.recording
        if recording is not None:
            progress = recording.progress
            state.header.stamp.sec, state.header.stamp.nanosec = divmod(max(progress, 0), 1_000_000_000)
            state.messages = recording.writer.messages
            state.bytes = recording.writer.bytes
            state.lost = recording.lost()
            state.recording = not recording.writer.closed
        state.uri = str(self.path)
        state.message = self._reason
        self._publisher.publish(state)

    def _watch(self) -> None:
        """Once a second: bring the bag to the disk, and see whether clock and publishers are as they were."""
        recording = self.recording
        jump = self._wall_clock.jump()
        gone = self._publishers_watched.look(self.matched())
        if recording is None:
            return
        try:
            recording.writer.flush()
        except BagError as error:
            self._fail(error)
            return
        if jump:
            self.get_logger().warning(
                f"the machine's clock was set by {jump * 1e-9:+.3f} s; the bag's times go on as before"
            )
            recording.note_clock_jump(jump)
        trial = recording.trial
        if gone and (trial is None or trial.under_way):
            self.get_logger().warning(f"no longer published: {', '.join(gone)}")
        self._close_if_abandoned(recording)

    def _close_if_abandoned(self, recording: Recording) -> None:
        """A trial whose pacemaker has vanished is never said to have ended."""
        trial, ticks = recording.trial, recording.ticks_received()
        if trial is None or not trial.under_way or self._trial_topic not in self._publishers_watched.gone:
            self._abandoned = None
        elif self._abandoned is None or self._abandoned[0] != ticks:
            self._abandoned = ticks, _now() + self.config.settle_limit
        elif _now() >= self._abandoned[1]:
            self.close(f"the publisher of {self._trial_topic} vanished during the trial")

    def _fail(self, error: BagError) -> None:
        self.failed = True
        self._reason = str(error)
        self.get_logger().error(str(error))
        self.close(str(error))

    def close(self, reason: str = "closed on request") -> None:
        """Close the bag and say so on ``recorder/state``. Idempotent; a fault is logged and published, not raised."""
        recording = self.recording
        if recording is None or recording.writer.closed:
            return
        self._reason = reason
        # By now it is what it was in the trial; where the bag was opened, perhaps not yet.
        recording.writer.set_custom_data({"scheduling": scheduling()})
        try:
            recording.close(reason)
        except BagError as error:
            self.failed = True
            self._reason = str(error)
            self.get_logger().error(str(error))
        if self.context.ok() and hasattr(self, "_publisher"):
            self._publish_state()
            self.get_logger().info(f"closed {self.path} ({recording.writer.messages} messages): {self._reason}")
        self.recording = None
        if not self._splits:
            self._end()

    def _end(self) -> None:
        """No other bag will follow."""
        atexit.unregister(self.close)
        if not self.closed.done():
            self.closed.set_result(self._reason)

    def destroy_node(self) -> None:
        self.close("the node was destroyed")
        self._end()
        super().destroy_node()


def make_recorder(**kwargs: Any) -> RecorderNode:
    """A recorder for `rig_runtime.run`, which reports a bag that cannot be opened as it does a bad parameter."""
    try:
        return RecorderNode(**kwargs)
    except BagError as error:
        raise ParameterError(f"recorder: {error}") from error


def main() -> int:
    """Entry point of ``ros2 run rig_bag recorder``."""
    return run(make_recorder)


if __name__ == "__main__":
    sys.exit(main())
