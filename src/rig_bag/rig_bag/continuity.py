"""Whether a stream that has one message a tick has every tick, once.

A tick is known by its stamp, t_k = t_0 + k t_s, in whole nanoseconds. Source: the rig's rule for stamps
(docs/topics.md).
"""

from __future__ import annotations

__all__ = ["Continuity"]

#: [intervals] beyond this a stream is not one of ticks, and only the number of its irregular intervals is kept.
_LIMIT = 10_000


class Continuity:
    """Follows the stamps of one topic, in the order of their arrival, in constant time for a regular one.

    The sample time may become known later than the first stamps: intervals that differ from it are kept as they are,
    and are judged when asked.
    """

    __slots__ = ("duplicates", "first", "gaps", "gates", "newest", "overflow", "received", "step")

    def __init__(self, step: int = 0, *, gates: bool = True) -> None:
        #: Whether the progress of a recording waits for this stream.
        self.gates = gates
        #: [ns] sample time; 0 while unknown.
        self.step = step
        #: [ns] stamps; -1 before the first.
        self.first = -1
        self.newest = -1
        self.received = 0
        self.duplicates = 0
        #: irregular intervals: [stamp before, stamp after, stamps inside that came late].
        self.gaps: list[tuple[int, int, set[int]]] = []
        self.overflow = 0

    def observe(self, stamp: int) -> None:
        """Take note of one message with this stamp [ns]."""
        self.received += 1
        newest = self.newest
        if stamp > newest:
            self.newest = stamp
            if newest < 0:
                self.first = stamp
            elif stamp - newest != self.step:
                if len(self.gaps) < _LIMIT:
                    self.gaps.append((newest, stamp, set()))
                else:
                    self.overflow += 1
        elif stamp == newest or not self._fill(stamp):
            self.duplicates += 1

    def _fill(self, stamp: int) -> bool:
        """Whether a stamp that is not the newest was missing until now; one before the first extends the stream."""
        if stamp < self.first:
            self.gaps.append((stamp, self.first, set()))
            self.first = stamp
            return True
        for before, after, late in self.gaps:
            if before < stamp < after and stamp not in late:
                late.add(stamp)
                return True
        return False

    def ticks_between(self, earlier: int, later: int) -> int:
        """Number of ticks strictly between two stamps; 0 while the sample time is unknown."""
        return max(0, round((later - earlier) / self.step) - 1) if self.step > 0 else 0

    def missing(self) -> int:
        """Ticks between the first and the newest stamp that never came."""
        return sum(max(0, self.ticks_between(before, after) - len(late)) for before, after, late in self.gaps)

    def late(self) -> int:
        """Messages that came after a newer one."""
        return sum(len(late) for _, _, late in self.gaps)

    def open_gaps(self) -> list[tuple[int, int, int]]:
        """(stamp before, stamp after, ticks missing between) of each gap that was never filled."""
        result = []
        for before, after, late in self.gaps:
            missing = self.ticks_between(before, after) - len(late)
            if missing > 0:
                result.append((before, after, missing))
        return result

    def restart(self) -> None:
        """A new trial: what comes next is no continuation. The counts stay."""
        self.newest = -1
