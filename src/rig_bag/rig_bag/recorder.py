"""The recorder node: raw subscriptions in, one bag out, or one for each trial.

It publishes how far it is on ``recorder/state``; in lockstep the pacemaker follows that, so that a slow disk slows the
run and loses nothing.
"""

from __future__ import annotations

import atexit
import datetime
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.subscription import Subscription
from rclpy.task import Future

from mig_interfaces.msg import NodeReport, RecorderState, TrialState
from rig_bag.configuration import RecorderConfig
from rig_bag.errors import BagError
from rig_bag.intake import TAKE_PERIOD, TAKE_PERIOD_LOCKSTEP, Declared, Intake, take_period
from rig_bag.opening import open_bag, place_of
from rig_bag.qos import load_overrides
from rig_bag.recording import Recording, Stream, Trial
from rig_bag.selection import Selection
from rig_bag.watch import EndWatch, PublisherWatch, SteadyWallClock
from rig_runtime import topics
from rig_runtime.node import RigNode
from rig_runtime.run import run
from rig_runtime.surroundings import scheduling
from rig_runtime.wire import MalformedError, decode
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

    longest_standstill = 0.1  # nothing that it does on time is due sooner

    def __init__(self, node_name: str = "recorder", **kwargs: Any) -> None:
        super().__init__(node_name, LoopConfig, RecorderConfig, follows_trial=False, **kwargs)
        #: Done when the bag is closed; the result is the reason.
        self.closed = Future()
        self.recording: Recording | None = None
        #: Each subscribed topic.
        self._declared: dict[str, Declared] = {}
        #: Where each topic goes in the bag that is open.
        self._streams: dict[str, Stream] = {}
        #: What takes a message of these topics; of the others it is only recorded.
        self._special: dict[str, Callable[[str, bytes, int, int], None]] = {}
        self._taking = False
        self._wall_clock = SteadyWallClock(_wall)
        self._publishers_watched = PublisherWatch()
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
        self._lockstep = self.parameters.get(LoopConfig).pacing == "lockstep"
        self._end_watch = EndWatch(config.settle_limit, _now)
        self._trial_topic = self.resolve_topic_name(topics.TRIAL_STATE.name)
        self._report_topic = self.resolve_topic_name(topics.NODE_REPORT.name)
        self._groups = [
            "|".join(self.resolve_topic_name(topic) for topic in group.split("|"))
            for group in config.per_tick_topics
            if group
        ]
        self.intake = self._make_intake()
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
        self._take_timer = self.create_timer(TAKE_PERIOD, self._take, clock=clock)
        self._search = self.create_timer(_SEARCH_PERIOD, self._look_for_publishers, clock=clock)
        self._watching = self.create_timer(_WATCH_PERIOD, self._watch, clock=clock)
        self._settle = self.create_timer(_SETTLE_PERIOD, self._check_settled, clock=clock)
        self._settle.cancel()
        self._look_for_publishers()

    def _make_intake(self) -> Intake:
        config = self.config
        wanted = [self.resolve_topic_name(topic) for topic in config.topics if topic]
        if config.follow_trial:
            self._special = {self._trial_topic: self._take_trial, self._report_topic: self._take_report}
            wanted += [self._trial_topic] * (self._trial_topic not in wanted)
        selection = Selection(
            everything=config.all,
            regex=config.regex,
            exclude_regex=config.exclude_regex,
            exclude=[self.resolve_topic_name(topic) for topic in config.exclude_topics if topic],
            hidden=config.include_hidden_topics,
        )
        path = config.qos_profile_overrides_path
        overrides = load_overrides(path) if path else {}
        return Intake(self, wanted, selection, overrides, declare=self._add_topic, lost=self._note_lost, wall=_wall)

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
            lockstep=self._lockstep,
            progress_ticks=config.progress_ticks,
            # Paced by wall time nobody waits for it, and it is said once a second.
            on_progress=self._publish_state if self._lockstep else None,
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

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that an executor serves; from the others this node takes by itself."""
        intake = getattr(self, "intake", None)
        return (each for each in super().subscriptions if intake is None or not intake.owns(each))

    def matched(self) -> dict[str, int]:
        """How many publishers each wanted or subscribed topic is matched with; 0 before it is subscribed."""
        return self.intake.matched()

    def make_report(self) -> NodeReport:
        report = super().make_report()
        # Of the listed topics, those of the loop must have a publisher before a trial starts; others may never get one.
        names = {name for group in self.config.per_tick_topics for name in group.split("|") if name}
        needed = {self.resolve_topic_name(name) for name in names} & set(self.intake.wanted)
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
        if not self.closed.done() and self.intake.look():
            if self.intake.selection.empty:
                self._search.cancel()
            else:
                self._search.timer_period_ns = int(_WATCH_PERIOD * 1e9)

    def _add_topic(self, topic: str, declared: Declared) -> None:
        if self.recording is not None:
            self._streams[topic] = self.recording.add_topic(topic, *declared)
            self.recording.writer.flush()
        self._declared[topic] = declared

    def _note_lost(self, topic: str, count: int) -> None:
        if self.recording is not None:
            self.recording.note_lost(topic, count)

    # -- messages ----------------------------------------------------------------------------------------------------

    def _take(self) -> None:
        """Record what has come."""
        if self._taking:
            return
        self._taking = True
        # The bag's own time: a log whose times go back could not be played.
        special, clock = self._special, self._wall_clock
        try:
            for steady, topic, data, under_way in self.intake.take():
                received = steady + clock.offset
                try:
                    special.get(topic, self._record)(topic, data, received, received - under_way)
                except MalformedError as error:
                    self.note_refused(topic, error)
        finally:
            self._taking = False

    def _record(self, topic: str, data: bytes, received: int, sent: int) -> None:
        recording = self.recording
        if recording is not None:
            try:
                recording.receive(self._streams[topic], data, received, sent)
            except BagError as error:
                self._fail(error)

    def _take_report(self, topic: str, data: bytes, received: int, sent: int) -> None:
        self._record(topic, data, received, sent)
        if self.recording is not None:
            report = decode(data, NodeReport)
            self.recording.note_answers(report.armed_uid, report.ticks_done, report.publishes)

    def _take_trial(self, topic: str, data: bytes, received: int, sent: int) -> None:
        try:
            message = decode(data, TrialState)
        except MalformedError:
            # It is recorded too, as it came.
            self._record(topic, data, received, sent)
            raise
        if self._splits:
            self._begin_trial(Trial.from_message(message))
        self._record(topic, data, received, sent)
        self.follow_trial(message)
        self._on_trial(message)

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
        paced = TAKE_PERIOD_LOCKSTEP if self._lockstep else take_period(1e-9 * trial.sample_time)
        self._take_timer.timer_period_ns = int(1e9 * (paced if trial.phase == Trial.RUNNING else TAKE_PERIOD))
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
            self._end_watch.restart()
            self._settle.reset()

    def _check_settled(self) -> None:
        """Close the bag of a trial that has ended, when it has all of it."""
        self._take()
        recording = self.recording
        if recording is None or recording.trial is None:
            self._settle.cancel()
        elif self._end_watch.settled(recording):
            self.close(f"trial {'finished' if recording.trial.phase == Trial.FINISHED else 'aborted'}")

    # -- the bag -----------------------------------------------------------------------------------------------------

    def _publish_state(self) -> None:
        state, recording = self._state, self.recording
        if recording is not None:
            state.header.stamp.sec, state.header.stamp.nanosec = divmod(max(recording.progress, 0), 1_000_000_000)
            state.messages = recording.writer.messages
            state.bytes = recording.writer.bytes
            state.lost = recording.lost()
            state.recording = not recording.writer.closed
        state.uri = str(self.path)
        state.message = self._reason
        self._publisher.publish(state)

    def _watch(self) -> None:
        """Once a second: bring the bag to the disk, say so, and see whether clock and publishers are as they were."""
        self._take()
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
        self._publish_state()
        if jump:
            self.get_logger().warning(f"the clock was set by {jump * 1e-9:+.3f} s; the bag's times go on as before")
            recording.note_clock_jump(jump)
        trial = recording.trial
        if gone and (trial is None or trial.under_way):
            self.get_logger().warning(f"no longer published: {', '.join(gone)}")
        if self._end_watch.abandoned(recording, gone=self._trial_topic in self._publishers_watched.gone):
            self.close(f"the publisher of {self._trial_topic} vanished during the trial")

    def _fail(self, error: BagError) -> None:
        self.failed = True
        self._reason = str(error)
        self.get_logger().error(str(error))
        self.close(str(error))

    def close(self, reason: str = "closed on request") -> None:
        """Close the bag and say so on ``recorder/state``. Idempotent; a fault is logged and published, not raised."""
        if self.recording is not None and self.recording.writer.error is None and self.context.ok():
            # What has come before this moment belongs to it.
            self._take()
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
