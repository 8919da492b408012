"""What a recorder looks at once a second: whether wall time has jumped, and whether publishers have vanished."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

__all__ = ["PublisherWatch", "SteadyWallClock"]

#: [ns] Between the two clocks' readings a stalled machine may let this pass.
_TOLERANCE = 50_000_000


class SteadyWallClock:
    """Wall time that goes on steadily whatever is done to the machine's clock.

    ``wall``, ``steady``: [ns]; for tests.
    """

    def __init__(self, wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = time.monotonic_ns) -> None:
        self._wall, self._steady = wall, steady
        self.begin()

    def begin(self) -> None:
        """From now on, and until this is called again, time is what the machine's clock says plus what passes."""
        #: [ns] between wall time and steady time.
        self.offset = self._seen = self._wall() - self._steady()

    def jump(self) -> int:
        """[ns] by which the machine's wall time was set since the last look; 0 if it was not."""
        offset = self._wall() - self._steady()
        jump = offset - self._seen
        if abs(jump) <= _TOLERANCE:
            return 0
        self._seen = offset
        return jump


class PublisherWatch:
    """Which topics had publishers and have none any more."""

    def __init__(self) -> None:
        self._there: set[str] = set()
        self.gone: set[str] = set()

    def look(self, publishers: Mapping[str, int]) -> list[str]:
        """Take note of how many publishers each topic has; returns those that have lost their last one since."""
        there = {topic for topic, count in publishers.items() if count}
        lost = sorted(self._there - there)
        self.gone = (self.gone | set(lost)) - there
        self._there = there
        return lost
