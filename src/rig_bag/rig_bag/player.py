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
from rig_bag.reader import Message, info, messages

__all__ = ["Player"]

_DEPTH = 1000
#: [s] between two looks at whether a paused player is to stop.
_LOOK = 0.1
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
        names = dict(remap or {})
        missing = [name for name in (*topics, *names) if name not in entries]
        if missing:
            raise BagError(f"{bag} has no topic {', '.join(missing)}; it has {', '.join(entries)}")
        self._rate = rate
        self._clock = clock
        self.publishers: dict[str, Any] = {}
        for name, entry in entries.items():
            if topics and name not in topics:
                continue
            try:
                message_class = definitions.message_class(entry.type)
            except BagError as error:
                node.get_logger().warning(f"{name} is not played: {error}")
                continue
            self.publishers[name] = node.create_publisher(message_class, names.get(name, name), _offer(entry.qos))
        stored = list(messages(bag, list(self.publishers)))
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
        self._shift = 0.0
        self._steps = 0

    # -- control, from any thread ------------------------------------------------------------------------------------

    @property
    def paused(self) -> bool:
        return self._paused_at is not None

    def pause(self) -> None:
        """Hold before the next message."""
        with self._changed:
            if self._paused_at is None:
                self._paused_at = self._clock()

    def resume(self) -> None:
        """Go on; what was to come comes later by the length of the pause."""
        with self._changed:
            if self._paused_at is not None:
                self._shift += self._clock() - self._paused_at
                self._paused_at = None
                self._steps = 0
                self._changed.notify_all()

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
        start, self._shift = self._clock(), 0.0
        if self._paused_at is not None:
            self._paused_at = start
        scale = 1e-9 / self._rate
        count = ticks = 0
        for message in self.messages:
            offset = (message.log_time - self.origin) * scale
            while self._clock_publisher is not None and ticks <= offset * self._clock_rate:
                at = ticks / self._clock_rate
                if self._wait(start, at, event) is None:
                    return count
                self._publish_time(self.origin + int(at / scale))
                ticks += 1
            late = self._wait(start, offset, event, steps=True)
            if late is None:
                break
            self.publishers[message.topic].publish(message.data)
            self.lateness.append(late)
            count += 1
        return count

    def _wait(self, start: float, offset: float, stop: threading.Event, *, steps: bool = False) -> float | None:
        """Wait until ``start + offset`` and as long as the player is paused; returns how late it is [s], or None if it
        is to stop. A step lets what waits with ``steps`` through.
        """
        while True:
            if not self.paused:
                wait = start + offset + self._shift - self._clock()
                if (wait > 0.0 and stop.wait(wait)) or stop.is_set():
                    return None
            with self._changed:
                if self._paused_at is None:
                    late = self._clock() - start - offset - self._shift
                    if late >= -_EARLY:
                        return max(late, 0.0)
                    # It was paused and resumed meanwhile: what is due has moved.
                    continue
                if self._steps > 0:
                    self._steps -= steps
                    return 0.0
                # A signal handler that sets `stop` cannot notify.
                self._changed.wait(_LOOK)
            if stop.is_set():
                return None

    def _publish_time(self, nanoseconds: int) -> None:
        assert self._clock_publisher is not None
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(nanoseconds, 1_000_000_000)
        self._clock_publisher.publish(message)

    def drain(self, limit: float = 1.0) -> bool:
        """Wait until the matched reliable readers have acknowledged everything, ``limit`` seconds a topic at most."""
        timeout = Duration(nanoseconds=int(limit * 1e9))
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
