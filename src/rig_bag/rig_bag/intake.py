"""What a recorder takes in: raw subscriptions to topics that are named or match a pattern, found as they appear.

No executor serves these subscriptions. It would be woken for each message, and handing one over costs it ten times what
taking it does; here their owner takes what has come from time to time, all together. The middleware says when each
message was received, so nothing is lost by that.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from rig_bag import definitions
from rig_bag.configuration import QUEUE_DEPTH
from rig_bag.errors import BagError
from rig_bag.qos import Qos
from rig_bag.selection import Selection
from rig_runtime.clocks import wall_ahead_of_steady

__all__ = [
    "TAKE_PERIOD",
    "TAKE_PERIOD_LOCKSTEP",
    "TAKE_PERIOD_REALTIME",
    "Declared",
    "Intake",
    "Taken",
    "take_period",
]

#: What a topic is declared as in a bag: type, QoS of its publishers, hash of the type.
Declared = tuple[str, list[Qos], str]

#: A message: steady time of its reception [ns], topic, its bytes, and how long it was under way [ns] by the system's
#: clock, 0 if the middleware does not know.
Taken = tuple[int, str, bytes, int]


TAKE_PERIOD = 0.02  # [s] between two looks for messages
TAKE_PERIOD_REALTIME = 0.2  # [s] the same while a trial is paced by wall time: nobody waits for what is recorded
TAKE_PERIOD_LOCKSTEP = 0.003  # [s] and while one runs as fast as it can: the pacemaker waits for progress
_TICK_COST = 40e-6  # [s] that it takes to record the messages of a tick


def take_period(sample_time: float) -> float:
    """Time between two looks for messages in a trial that wall time paces [s].

    What is taken at once takes an eighth of a tick: with the loop in the same process it holds it up, as does a chunk
    that is full, for 0.3 ms.
    """
    ticks = sample_time / (8.0 * _TICK_COST)
    return min(TAKE_PERIOD_REALTIME, max(TAKE_PERIOD_LOCKSTEP, ticks * sample_time))


class _Tap:
    """One subscription."""

    __slots__ = ("newest", "subscription", "topic", "type")

    def __init__(self, topic: str, message_type: Any, subscription: Subscription) -> None:
        self.topic = topic
        self.type = message_type
        self.subscription = subscription
        #: [ns] when its newest message was received
        self.newest = 0


class Intake:
    """The subscriptions of ``node`` to the topics ``wanted`` (fully qualified names) and to those of a selection.

    Parameters
    ----------
    overrides: quality of service by topic; by default the strictest that every publisher of the topic can serve.
    declare: called with a topic and what it is before it is subscribed; a BagError from it leaves the topic out.
    lost: called with a topic and how many of its messages the middleware says that it lost.
    wall, steady: [ns]; for tests.
    """

    def __init__(
        self,
        node: Node,
        wanted: Sequence[str],
        selection: Selection,
        overrides: Mapping[str, Qos],
        *,
        declare: Callable[[str, Declared], None],
        lost: Callable[[str, int], None],
        wall: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.wanted = tuple(wanted)
        self._node = node
        self.selection = selection
        self._overrides = overrides
        self._declare = declare
        self._lost = lost
        self._wall, self._steady = wall, steady
        self._taps: dict[str, _Tap] = {}
        self._skipped: set[str] = set()
        #: [ns] steady time of the last take.
        self._taken = steady()

    def owns(self, subscription: Subscription) -> bool:
        """Whether an executor must leave it alone."""
        return any(tap.subscription is subscription for tap in self._taps.values())

    # -- topics ------------------------------------------------------------------------------------------------------

    def matched(self) -> dict[str, int]:
        """How many publishers each wanted or subscribed topic is matched with; 0 before it is subscribed."""
        result = dict.fromkeys(self.wanted, 0)
        for topic, tap in self._taps.items():
            result[topic] = tap.subscription.get_publisher_count()
        return result

    def look(self) -> bool:
        """Subscribe to what has a publisher by now; whether each wanted topic has been found."""
        # One cheap question for all topics; that for a topic's publishers costs twenty times as much.
        for topic, _ in self._node.get_topic_names_and_types():
            if topic not in self._taps and (topic in self.wanted or self.selection.takes(topic)):
                self._subscribe(topic)
        return all(topic in self._taps or topic in self._skipped for topic in self.wanted)

    def _subscribe(self, topic: str) -> None:
        """Subscribe to a topic if it has a publisher."""
        if topic in self._skipped:
            return
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        types = sorted({info.topic_type for info in publishers})
        try:
            if len(types) > 1:
                raise BagError(f"its publishers disagree on its type: {', '.join(types)}")
            message_type = definitions.message_class(types[0])
            qos_of_publishers = [Qos.from_rclpy(info.qos_profile) for info in publishers]
            self._declare(topic, (types[0], qos_of_publishers, str(publishers[0].topic_type_hash)))
        except BagError as error:
            self._skipped.add(topic)
            self._node.get_logger().warning(f"{topic} is not recorded: {error}")
            return
        profile = self._qos_for(topic, [info.qos_profile for info in publishers])
        subscribe = partial(self._node.create_subscription, message_type, topic, _leave, profile, raw=True)
        try:
            subscription = subscribe(event_callbacks=self._events(topic))
        except UnsupportedEventTypeError:
            subscription = subscribe()
        self._taps[topic] = _Tap(topic, message_type, subscription)

    def _qos_for(self, topic: str, profiles: Sequence[QoSProfile]) -> QoSProfile:
        if topic in self._overrides:
            return self._overrides[topic].to_rclpy()
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
            self._node.get_logger().warning(f"{topic}: the middleware lost {event.total_count_change} messages")
            self._lost(topic, event.total_count_change)

        return SubscriptionEventCallbacks(message_lost=lost)

    # -- messages ----------------------------------------------------------------------------------------------------

    def take(self) -> list[Taken]:
        """What has come since the last time, by time of reception.

        The middleware's times are of a clock that may be set meanwhile: a message is never of a time before the last
        take or in the future, and those of a topic keep their order. A middleware that has no such time says 0: then it
        is that of this take.
        """
        ahead = wall_ahead_of_steady(self._wall, self._steady)
        now = self._steady()
        since, self._taken = self._taken, now
        found: list[Taken] = []
        for tap in self._taps.values():
            topic, kind, handle = tap.topic, tap.type, tap.subscription.handle
            newest = max(tap.newest, since)
            with handle:
                take = handle.take_message
                for _ in range(QUEUE_DEPTH):
                    got = take(kind, True)
                    if got is None:
                        break
                    data, about = got
                    arrived = about["received_timestamp"] or now + ahead
                    if newest < arrived - ahead:
                        newest = min(arrived - ahead, now)
                    found.append((newest, topic, data, arrived - (about["source_timestamp"] or arrived)))
            tap.newest = newest
        found.sort(key=itemgetter(0))
        return found


def _leave(_: bytes) -> None:
    """No executor calls this."""
