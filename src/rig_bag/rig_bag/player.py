"""Playing a bag: its stored bytes, untouched, on its topics, at its times."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Sequence
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

from rig_bag import definitions
from rig_bag.errors import BagError
from rig_bag.qos import Qos
from rig_bag.reader import Message, info, messages

__all__ = ["Player"]

_DEPTH = 1000


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
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not rate > 0.0:
            raise BagError(f"a bag plays at a rate above 0, not {rate}")
        if start_offset < 0.0:
            raise BagError(f"a bag plays from an offset of at least 0 s, not {start_offset}")
        described = info(bag)
        entries = {entry.name: entry for entry in described.metadata.topics}
        missing = [name for name in topics if name not in entries]
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
            self.publishers[name] = node.create_publisher(message_class, name, _offer(entry.qos))
        stored = list(messages(bag, list(self.publishers)))
        self.origin = (stored[0].log_time if stored else 0) + int(start_offset * 1e9)
        self.messages: list[Message] = [message for message in stored if message.log_time >= self.origin]
        if not self.messages:
            raise BagError(f"{bag} has nothing to play" + (f" after {start_offset} s" if start_offset else ""))

    def play(self, stop: threading.Event | None = None) -> int:
        """Publish everything once, in the order and at the distances of the log times; returns how many were published.

        ``stop`` ends it early. Late messages are sent at once: the bag's own time is kept, never stretched.
        """
        event = stop or threading.Event()
        start = self._clock()
        scale = 1e-9 / self._rate
        count = 0
        for message in self.messages:
            wait = start + (message.log_time - self.origin) * scale - self._clock()
            if (wait > 0.0 and event.wait(wait)) or event.is_set():
                break
            self.publishers[message.topic].publish(message.data)
            count += 1
        return count

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
