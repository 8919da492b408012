"""Latencies: a page's clock as seen from here, and the spread of what was measured lately."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

__all__ = ["LinkClock", "Spread", "Window"]

_MILLISECOND = 1_000_000
#: [ns] For how long the fastest message is remembered: clocks drift by less than a tenth of a millisecond in it.
_MEMORY = 10_000_000_000


class LinkClock:
    """When a message was sent, on this clock, from when it says so on the page's.

        sent = received - (d - min d) - rtt/2,      d = received - t_page

    The fastest message of the last seconds defines the offset of the clocks; what another took longer is its queueing.
    """

    def __init__(self) -> None:
        self.half_round_trip = 0
        self._best: int | None = None
        self._next: int | None = None
        self._since = 0

    def queueing(self, page: int, received: int) -> int:
        """How much longer [ns] than the fastest a message took that says it was sent at `page` [ns]."""
        difference = received - page
        if self._best is None or self._next is None or received - self._since > _MEMORY:
            self._best = difference if self._next is None else min(self._next, difference)
            self._next = difference
            self._since = received
        self._best = min(self._best, difference)
        self._next = min(self._next, difference)
        return difference - self._best

    def sent(self, received: int, queueing: int) -> int:
        """When [ns] it was sent, on this clock."""
        return received - queueing - self.half_round_trip

    def round_trip(self, milliseconds: float) -> None:
        """The page has measured a round trip."""
        self.half_round_trip = round(0.5 * milliseconds * _MILLISECOND)


class Spread(NamedTuple):
    """Median, 99th percentile and largest of `count` values [ms]; NaN where there are none."""

    count: int
    p50: float
    p99: float
    largest: float


class Window:
    """The last values of a measurement [ms]."""

    def __init__(self, size: int = 1000) -> None:
        self._values: deque[float] = deque(maxlen=size)

    def add(self, value: float) -> None:
        """Take one more."""
        self._values.append(value)

    def clear(self) -> None:
        """Forget all."""
        self._values.clear()

    def spread(self) -> Spread:
        """How they are spread."""
        values = list(self._values)
        if not values:
            return Spread(0, *(float("nan"),) * 3)
        p50, p99 = np.percentile(values, (50.0, 99.0)).tolist()
        return Spread(len(values), p50, p99, max(values))
