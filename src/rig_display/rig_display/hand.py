"""The hand on the page as a force sensor. Neither ROS nor a server in here: time comes in as nanoseconds.

    f = clip(f_page, -limits, limits)   while somebody drives, the link is fresh and nobody pressed the emergency stop
    f = 0                               otherwise, with the reason

One thread puts, another takes; each step is a single read or write of a reference, so neither ever waits.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

__all__ = ["NO_DRIVER", "STOPPED", "Hand", "Sample"]

Force = tuple[float, float, float]

ZERO: Force = (0.0, 0.0, 0.0)

#: Why nothing is pushed, besides what a page says of itself (hidden, out of focus).
NO_DRIVER = "nobody drives"
STOPPED = "emergency stop"
STALLED = "the page has fallen silent"
LET_GO = "waiting for the hand to let go"

#: Events that wait for a tick; a mouse makes about ten in one.
_PENDING = 64


class Sample(NamedTuple):
    """What the hand does at a tick."""

    force: Force  # [N]
    reason: str  # why it is zero; empty while the hand is in force
    events: tuple[int, ...]  # [ns] when the input events happened that no earlier sample has taken


class _Push(NamedTuple):
    force: Force
    received: int


class Hand:
    """The newest force of whoever drives.

    Parameters
    ----------
    limits: [N] largest magnitude along x, y, z.
    stale_after: [ns] how long a force lasts without another message.
    """

    def __init__(self, limits: Force, stale_after: int) -> None:
        self.limits = limits
        self.clipped = 0
        self._stale_after = stale_after
        self._push: _Push | None = None
        self._zeroed = NO_DRIVER
        self._stopped_by = ""
        self._must_let_go = False
        self._events: deque[int] = deque(maxlen=_PENDING)

    # -- the server's side ---------------------------------------------------------------------------------------

    def put(self, force: Force, received: int, event: int | None = None) -> None:
        """Take the force of a message received at `received` [ns], made by an input event at `event` [ns] if any."""
        limits = self.limits
        clipped: Force = (
            min(max(force[0], -limits[0]), limits[0]),
            min(max(force[1], -limits[1]), limits[1]),
            min(max(force[2], -limits[2]), limits[2]),
        )
        if clipped != force:
            self.clipped += 1
        if clipped == ZERO:
            self._must_let_go = False
        self._push = _Push(clipped, received)
        self._zeroed = ""
        if event is not None:
            self._events.append(event)

    def zero(self, reason: str) -> None:
        """Push nothing until the next message, for a reason that people are shown."""
        self._zeroed = reason
        self._push = None
        self._events.clear()

    def stop(self, who: str) -> None:
        """Emergency stop: nothing is pushed until :meth:`release`, whatever the page says."""
        self._must_let_go = True
        self._stopped_by = self._stopped_by or who

    def release(self) -> None:
        """End the emergency stop. The hand counts again once it has let go."""
        self._stopped_by = ""

    @property
    def stopped_by(self) -> str:
        """Who pressed the emergency stop; empty if it is not latched."""
        return self._stopped_by

    # -- the loop's side -----------------------------------------------------------------------------------------

    def take(self, now: int) -> Sample:
        """The force at `now` [ns]."""
        events = []
        for _ in range(len(self._events)):
            try:
                events.append(self._events.popleft())
            except IndexError:  # cleared meanwhile
                break
        reason = self.reason(now)
        push = self._push
        if reason or push is None:
            return Sample(ZERO, reason or NO_DRIVER, ())
        return Sample(push.force, "", tuple(events))

    def reason(self, now: int) -> str:
        """Why nothing is pushed at `now` [ns]; empty while the hand is in force."""
        push = self._push
        if self._stopped_by:
            return STOPPED
        if push is None:
            return self._zeroed or NO_DRIVER
        if now - push.received > self._stale_after:
            return STALLED
        return LET_GO if self._must_let_go else ""
