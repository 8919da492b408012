"""What a node that moves a robot must notice by itself: a silent stream, an old message, a fault that has to stay.

Neither ROS nor a clock in here: time comes in as numbers, looks as calls.
"""

from __future__ import annotations

import math
from typing import Generic, TypeVar

__all__ = ["LOOKS", "STEADY", "FaultLatch", "Lateness", "Loss", "Silence", "in_words"]

T = TypeVar("T")

#: Two clocks run apart by less than one part in this: 200 us in a second, several times what a quartz may be off.
STEADY = 5000

#: How often a watchdog looks within the time that it allows.
LOOKS = 10

#: [s] Between two changes of a loss that are said at once: people cannot read faster, and to say it takes time.
_PAUSE = 0.2

#: [s] A shorter one than this has just begun.
_WORTH_SAYING = 0.1


class Silence:
    """Whether a stream has been silent for a time, counted in looks.

    Looks rather than a clock: a process that was itself asleep looks once when it wakes, before it has seen what came
    meanwhile, and must not take its own sleep for the other side's silence.

    Parameters
    ----------
    limit: how long a stream may be silent [s].
    """

    def __init__(self, limit: float) -> None:
        #: [s] How often to look.
        self.period = max(limit / LOOKS, 1e-3)
        self._limit = math.ceil(limit / self.period)
        self._looks = 0

    def heard(self) -> None:
        """Something came."""
        self._looks = 0

    def look(self) -> bool:
        """To be called every :attr:`period`; whether the stream is silent."""
        self._looks += 1
        return self.silent

    @property
    def silent(self) -> bool:
        """As the last look found it."""
        return self._looks >= self._limit

    @property
    def lasting(self) -> float:
        """For how long it has been silent [s]."""
        return self._looks * self.period


class Lateness:
    """Whether a message comes later than it could, by more than a limit: (r_k - s_k) - d_k > limit.

    With s_k the stamp, r_k the reception on a steady clock, and d_k the least r_j - s_j of the trial so far, which may
    rise by one part in :data:`STEADY` from one message in time to the next: clocks of two machines need neither agree
    nor run alike. A wall clock that jumps changes nothing, because stamps of ticks are counted from the trial's
    beginning.

    Parameters
    ----------
    limit: [ns].
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._least: int | None = None
        self._received = 0
        #: [ns] By how much the last message was later than it could be.
        self.last = 0

    def reset(self) -> None:
        """A new trial, with stamps of its own."""
        self._least = None
        self.last = 0

    def late(self, stamp: int, received: int) -> bool:
        """Whether a message with this stamp, received at this time [ns], is."""
        delay = received - stamp
        least = delay
        if self._least is not None:
            least = min(delay, self._least + (received - self._received) // STEADY)
        self._received = received
        self.last = delay - least
        if self.last > self._limit:
            # No rise: otherwise what comes late for long enough would be in time again.
            return True
        self._least = least
        return False


def in_words(fault: object) -> str:
    """A fault for a person to read: a sentence as it is, a member of an enumeration by its name."""
    return fault if isinstance(fault, str) else str(getattr(fault, "name", fault)).lower().replace("_", " ")


class FaultLatch(Generic[T]):
    """Keeps a fault until it is cleared, or, with automatic recovery, not at all.

    Parameters
    ----------
    explicit: whether a fault stays until :meth:`clear`.
    """

    def __init__(self, explicit: bool) -> None:
        self._explicit = explicit
        #: The fault that is kept.
        self.kept: T | None = None

    def hold(self, fault: T | None) -> T | None:
        """The fault that is in force, given the one of this tick; the first one is kept, it is what happened."""
        if self.kept is not None:
            return self.kept
        if self._explicit:
            self.kept = fault
        return fault

    def clear(self) -> T | None:
        """Forget the fault and return it."""
        fault, self.kept = self.kept, None
        return fault


class Loss:
    """What keeps every force away at this moment, since when, and whether that is still to be said.

    A change is to be said at once; but what comes and goes with every tick only five times a second, as it then is.
    """

    def __init__(self) -> None:
        self._pause = round(1e9 * _PAUSE)
        self._said: object | None = None
        self._said_at = -self._pause
        self.reset()

    def reset(self) -> None:
        """A new trial: nothing is lost, nor has been."""
        #: What is lost; None if nothing is.
        self.what: object | None = None
        self._since = self._until = 0
        self._last: object | None = None

    def tell(self, what: object | None, now: int) -> bool:
        """What is lost now [ns], None if nothing is; whether it is time to say so. Cheap: called at every tick."""
        if what != self.what:
            if self.what is None:
                self._since = now
            elif what is None:
                self._last, self._until = self.what, now
            self.what = what
        if what == self._said or now - self._said_at < self._pause:
            return False
        self._said, self._said_at = what, now
        return True

    def lasting(self, now: int) -> float:
        """For how long there has been no force [s]; 0 if nothing is lost."""
        return 0.0 if self.what is None else 1e-9 * (now - self._since)

    def words(self, now: int, consequence: str = "no force", remember: float = math.inf) -> str:
        """The loss that lasts, or one that ended in the last `remember` [s]; empty if there is none."""
        if self.what is not None:
            lasting = self.lasting(now)
            so_far = f" for {_seconds(lasting)}" if lasting >= _WORTH_SAYING else ""
            return f"{consequence}{so_far}: {in_words(self.what)}"
        ago = 1e-9 * (now - self._until)
        if self._last is None or ago > remember:
            return ""
        lasted = 1e-9 * (self._until - self._since)
        return f"{consequence} for {_seconds(lasted)} until {ago:.1f} s ago: {in_words(self._last)}"


def _seconds(duration: float) -> str:
    return f"{duration:.2f} s" if duration < 1.0 else f"{duration:.1f} s"
