"""Ticks: t_k = t_0 + k t_s, in whole nanoseconds, and the matching of two streams of messages tick by tick.

A tick is known by its stamp, so that standard messages (WrenchStamped) need no extra field.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from builtin_interfaces.msg import Time

NANOSECONDS = 1_000_000_000

#: t_0 in lockstep, where every run has the same stamps. Not zero: a zero stamp means "not set" to many tools.
LOCKSTEP_EPOCH = NANOSECONDS

L = TypeVar("L")
R = TypeVar("R")


def to_nanoseconds(seconds: float) -> int:
    """Seconds as whole nanoseconds, rounded to the nearest."""
    return round(seconds * NANOSECONDS)


def to_stamp(nanoseconds: int) -> Time:
    """Nanoseconds since the epoch as a ROS time."""
    sec, nanosec = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def from_stamp(stamp: Time) -> int:
    """A ROS time as nanoseconds since the epoch."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


@dataclass(frozen=True)
class TickClock:
    """t_k = epoch + k sample, both in nanoseconds."""

    epoch: int
    sample: int

    def stamp(self, tick: int) -> int:
        """t_k [ns] of tick k."""
        return self.epoch + tick * self.sample

    def tick(self, stamp: int) -> int | None:
        """The tick of a stamp [ns], None if no tick of this trial has it."""
        tick, rest = divmod(stamp - self.epoch, self.sample)
        return tick if rest == 0 and tick >= 0 else None


class Matched(NamedTuple, Generic[L, R]):
    """One tick, complete or given up: `right` is None if it never came; ages are counted from reception [ns]."""

    stamp: int
    left: L
    right: R | None
    left_received: int
    right_received: int


@dataclass
class TickMatcher(Generic[L, R]):
    """Pair the messages of two streams by stamp, each tick once, in order, whichever side comes first.

    The left stream says which ticks exist. A tick that its right side has overtaken, or kept waiting for longer than
    `expire` is told, is given up: it is handed out without a right side, so that every tick gets an answer. What comes
    for a tick that was handed out already is dropped and counted, never silently.
    """

    late: int = 0
    duplicates: int = 0
    overflows: int = 0
    capacity: int = 1000
    _left: OrderedDict[int, tuple[L, int]] = field(default_factory=OrderedDict)
    _right: OrderedDict[int, tuple[R, int]] = field(default_factory=OrderedDict)
    _done: int = -1

    def reset(self) -> None:
        """Forget everything: a new trial begins."""
        self.late = self.duplicates = self.overflows = 0
        self._left.clear()
        self._right.clear()
        self._done = -1

    @property
    def waiting(self) -> bool:
        """Whether a tick has been opened and not been completed."""
        return bool(self._left)

    def put_left(self, stamp: int, message: L, now: int) -> list[Matched[L, R]]:
        """Take the message that opens a tick; return the ticks that can be handled now, in order."""
        if stamp <= self._done:
            self.late += 1
            return []
        if stamp in self._left:
            self.duplicates += 1
            return []
        self._left[stamp] = (message, now)
        return self._hand_out(stamp) if stamp in self._right else []

    def put_right(self, stamp: int, message: R, now: int) -> list[Matched[L, R]]:
        """Take the message that completes a tick; return the ticks that can be handled now, in order."""
        if stamp <= self._done:
            self.late += 1
            return []
        if stamp in self._right:
            self.duplicates += 1
            return []
        if len(self._right) >= self.capacity:
            self._right.popitem(last=False)
            self.overflows += 1
        self._right[stamp] = (message, now)
        return self._hand_out(stamp) if stamp in self._left else []

    def expire(self, received_before: int) -> list[Matched[L, R]]:
        """Give up the ticks whose left side was received before the given time [ns] and whose right side is missing."""
        newest = max((stamp for stamp, (_, now) in self._left.items() if now < received_before), default=None)
        return [] if newest is None else self._hand_out(newest)

    def _hand_out(self, newest: int) -> list[Matched[L, R]]:
        if len(self._left) == len(self._right) == 1 and newest in self._right:
            # Nothing else waits: the usual case, in a third of the time.
            self._done = newest
            (opened, opened_at), (completed, completed_at) = self._left.pop(newest), self._right.pop(newest)
            return [Matched(newest, opened, completed, opened_at, completed_at)]
        ready = []
        for stamp in sorted(stamp for stamp in self._left if stamp <= newest):
            left, left_received = self._left.pop(stamp)
            right, right_received = self._right.pop(stamp, (None, left_received))
            ready.append(Matched(stamp, left, right, left_received, right_received))
        self._done = newest
        for overtaken in [overtaken for overtaken in self._right if overtaken <= newest]:
            del self._right[overtaken]
            self.late += 1
        return ready
