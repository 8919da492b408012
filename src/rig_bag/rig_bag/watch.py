"""What a recorder looks at beside its messages: jumps of the wall time, publishers that vanish, the end of a trial."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from rig_bag.recording import Recording
from rig_bag.trial import Trial
from rig_runtime.clocks import wall_ahead_of_steady

__all__ = ["EndWatch", "PublisherWatch", "SteadyWallClock"]

#: [ns] By less than this from one look to the next a clock is trimmed, and not set.
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
        self.offset = self._seen = wall_ahead_of_steady(self._wall, self._steady)

    def jump(self) -> int:
        """[ns] by which the machine's wall time was set since the last look; 0 if it was not."""
        before, self._seen = self._seen, wall_ahead_of_steady(self._wall, self._steady)
        jump = self._seen - before
        return jump if abs(jump) > _TOLERANCE else 0


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


class EndWatch:
    """When the recording of a trial can be closed. A machine that is behind still brings what is missing: the limit
    [s] is one of silence, counted from the last tick that came.
    """

    def __init__(self, limit: float, now: Callable[[], float] = time.monotonic) -> None:
        self._limit, self._now = limit, now
        self._deadline = 0.0
        self._messages = self._ticks = -1

    def restart(self) -> None:
        """Something has been said of the trial: from now on there must be silence."""
        self._messages = self._ticks = -1

    def settled(self, recording: Recording) -> bool:
        """Of an ended trial: whether everything is here and nothing more comes, or nothing has come for long enough."""
        assert recording.trial is not None
        quiet = recording.writer.messages == self._messages
        self._messages = recording.writer.messages
        late = self._silent(recording)
        return late or (quiet and (recording.complete() or recording.trial.phase == Trial.ABORTED))

    def abandoned(self, recording: Recording, *, gone: bool) -> bool:
        """Of a trial under way whose pacemaker is ``gone`` and never says that it has ended: the same."""
        if recording.trial is None or not recording.trial.under_way:
            return False
        if not gone:
            self._ticks = -1
        return gone and self._silent(recording)

    def _silent(self, recording: Recording) -> bool:
        ticks = recording.ticks_received()
        if ticks != self._ticks:
            self._ticks = ticks
            self._deadline = self._now() + self._limit
        return self._now() >= self._deadline
