"""Playing a bag: its stored bytes, untouched, on its topics, at its times."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosgraph_msgs.msg import Clock

from rig_bag import definitions
from rig_bag.errors import BagError
from rig_bag.qos import Qos
from rig_bag.reader import Message, info, ordered
from rig_bag.ticks import schema_of

__all__ = ["Player"]

_DEPTH = 1000
#: [s] between two looks at whether a paused player is to stop.
_LOOK = 0.1
#: [s] after which a wait looks again at when it ends.
_SLICE = 0.25
#: [s] that rounding may let a wait end before its time.
_EARLY = 1e-6


class Player:
    """Publishes what a bag holds. The publishers exist from construction on, so that subscribers can match before
    :meth:`play`.

    Parameters
    ----------
    node: on which the publishers are made.
    bag: its directory.
    topics: those to play; by default all. A topic whose type is not installed is left out with a warning.
    rate: of play, > 0.
    start_offset: [s] from the bag's start, >= 0.
    duration: [s] of the bag's time to play, > 0; None: to its end.
    remap: other names for topics.
    qos: by topic of the bag, what to publish with instead of what was recorded.
    clock_rate: [Hz] at which ``/clock`` says how far in the bag's time the play is; 0: it does not.
    clock: [s] monotonic; for tests.

    Raises
    ------
    BagError: the bag cannot be read, a topic asked for is not in it, or nothing is left to play.
    """

    def __init__(
        self,
        node: Node,
        bag: str | os.PathLike[str],
        *,
        topics: Sequence[str] = (),
        rate: float = 1.0,
        start_offset: float = 0.0,
        duration: float | None = None,
        remap: Mapping[str, str] | None = None,
        qos: Mapping[str, Qos] | None = None,
        clock_rate: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not rate > 0.0:
            raise BagError(f"a bag plays at a rate above 0, not {rate}")
        if start_offset < 0.0:
            raise BagError(f"a bag plays from an offset of at least 0 s, not {start_offset}")
        if duration is not None and not duration > 0.0:
            raise BagError(f"a bag plays for more than 0 s, not {duration}")
        described = info(bag)
        entries = {entry.name: entry for entry in described.metadata.topics}
        names, profiles = dict(remap or {}), dict(qos or {})
        missing = [name for name in (*topics, *names) if name not in entries]
        if missing:
            raise BagError(f"{bag} has no topic {', '.join(missing)}; it has {', '.join(entries)}")
        self._rate = rate
        self._clock = clock
        self.publishers: dict[str, Any] = {}
        files = described.contents()
        recorded = {channel.topic: (part, channel) for part in files for channel in part.channels.values()}
        for name, entry in entries.items():
            if topics and name not in topics:
                continue
            try:
                message_class = definitions.message_class(entry.type)
                if name in recorded and not definitions.as_installed(schema_of(*recorded[name])):
                    raise BagError(f"{entry.type} was recorded with other fields than the installed definition has")
            except BagError as error:
                node.get_logger().warning(f"{name} is not played: {error}")
                continue
            offered = profiles[name].to_rclpy() if name in profiles else _offer(entry.qos)
            self.publishers[name] = node.create_publisher(message_class, names.get(name, name), offered)
        stored = list(ordered(files, list(self.publishers)))
        self.origin = (stored[0].log_time if stored else 0) + int(start_offset * 1e9)
        end = self.origin + int(duration * 1e9) if duration is not None else None
        self.messages: list[Message] = [
            message for message in stored if message.log_time >= self.origin and (end is None or message.log_time < end)
        ]
        if not self.messages:
            raise BagError(f"{bag} has nothing to play" + (f" after {start_offset} s" if start_offset else ""))
        self._clock_rate = clock_rate
        self._clock_publisher = node.create_publisher(Clock, "/clock", 10) if clock_rate > 0.0 else None
        #: [s] how much later than due each message went out.
        self.lateness: list[float] = []
        self._changed = threading.Condition()
        self._paused_at: float | None = None
        self._steps = 0
        #: A moment [s] of the clock, and how far in the bag's time [s] after the origin the play was then.
        self._anchor = 0.0, 0.0

    # -- control, from any thread ------------------------------------------------------------------------------------

    @property
    def paused(self) -> bool:
        return self._paused_at is not None

    @property
    def rate(self) -> float:
        return self._rate

    def set_rate(self, rate: float) -> None:
        """Go on at another rate, > 0, from where the play is."""
        if not rate > 0.0:
            raise BagError(f"a bag plays at a rate above 0, not {rate}")
        with self._changed:
            now = self._clock() if self._paused_at is None else self._paused_at
            self._anchor = now, self._position(now)
            self._rate = rate

    def pause(self) -> None:
        """Hold before the next message."""
        with self._changed:
            if self._paused_at is None:
                self._paused_at = self._clock()

    def resume(self) -> None:
        """Go on; what was to come comes later by the length of the pause."""
        with self._changed:
            if self._paused_at is not None:
                self._anchor = self._clock(), self._position(self._paused_at)
                self._paused_at = None
                self._steps = 0
                self._changed.notify_all()

    def _position(self, now: float) -> float:
        """How far in the bag's time [s] after the origin the play is at a moment of the clock."""
        moment, position = self._anchor
        return position + (now - moment) * self._rate

    def step(self) -> bool:
        """Publish the next message, and no more; only while paused (else False)."""
        with self._changed:
            if self._paused_at is None:
                return False
            self._steps += 1
            self._changed.notify_all()
            return True

    # -- playing -----------------------------------------------------------------------------------------------------

    def play(self, stop: threading.Event | None = None) -> int:
        """Publish everything once, in the order and at the distances of the log times; returns how many were published.

        ``stop`` ends it early. Late messages are sent at once: the bag's own time is kept, never stretched, except by
        a pause.
        """
        event = stop or threading.Event()
        start = self._clock()
        self._anchor = start, 0.0
        if self._paused_at is not None:
            self._paused_at = start
        count = ticks = 0
        # In the bag's time: /clock ticks as often in wall time only as long as the rate stays.
        tick = self._rate / self._clock_rate if self._clock_rate else 0.0
        for message in self.messages:
            offset = (message.log_time - self.origin) * 1e-9
            while self._clock_publisher is not None and ticks * tick <= offset:
                if self._wait(ticks * tick, event) is None:
                    return count
                self._publish_time(self.origin + int(ticks * tick * 1e9))
                ticks += 1
            late = self._wait(offset, event, steps=True)
            if late is None:
                break
            self.publishers[message.topic].publish(message.data)
            self.lateness.append(late)
            count += 1
        return count

    def _wait(self, offset: float, stop: threading.Event, *, steps: bool = False) -> float | None:
        """Wait until the bag's time has come as far as ``offset`` [s] and as long as the player is paused; returns how
        late it is [s], or None if it is to stop. A step lets what waits with ``steps`` through.
        """
        while True:
            if not self.paused:
                # Not in one go: the rate may change, and a pause may move what is due.
                wait = min(self._due(offset) - self._clock(), _SLICE)
                if (wait > 0.0 and stop.wait(wait)) or stop.is_set():
                    return None
            with self._changed:
                if self._paused_at is None:
                    late = self._clock() - self._due(offset)
                    if late >= -_EARLY:
                        return max(late, 0.0)
                    continue
                if self._steps > 0:
                    self._steps -= steps
                    return 0.0
                # A signal handler that sets `stop` cannot notify.
                self._changed.wait(_LOOK)
            if stop.is_set():
                return None

    def _due(self, offset: float) -> float:
        """The moment of the clock at which the bag's time is as far as this."""
        moment, position = self._anchor
        return moment + (offset - position) / self._rate

    def _publish_time(self, nanoseconds: int) -> None:
        assert self._clock_publisher is not None
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(nanoseconds, 1_000_000_000)
        self._clock_publisher.publish(message)

    def drain(self, limit: float | None = 1.0) -> bool:
        """Wait until the matched reliable readers have acknowledged everything, ``limit`` seconds a topic at most."""
        timeout = Duration(nanoseconds=-1 if limit is None else int(limit * 1e9))
        acknowledged = [publisher.wait_for_all_acked(timeout) for publisher in self.publishers.values()]
        return all(acknowledged)


def _offer(profiles: Sequence[Qos]) -> QoSProfile:
    """The profile that serves every reader that the recorded publishers served."""
    reliable = not profiles or all(profile.reliability == "reliable" for profile in profiles)
    latched = bool(profiles) and all(profile.durability == "transient_local" for profile in profiles)
    depths = [profile.depth for profile in profiles]
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max([*depths, 1]) if latched else max([*depths, _DEPTH]),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.AUTOMATIC,
    )
