"""The account of a trial's ticks: of which topic how many came, which are missing, which came twice.

The recorder keeps it while it records; the check of a bag keeps it again from the bag's bytes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from rig_bag.continuity import Continuity
from rig_bag.trial import Trial

__all__ = ["Account"]

#: Gaps listed one by one.
_GAPS_LISTED = 20


class Account:
    """Ticks of each group of topics.

    Parameters
    ----------
    groups: topics that have one message a tick; ``a|b|c`` stands for one message on one of the three.
    """

    def __init__(self, groups: Iterable[str]) -> None:
        #: The trial's newest state.
        self.trial: Trial | None = None
        self._ticks = {group: Continuity(gates="|" not in group) for group in groups}
        self._of_topic = {topic: ticks for group, ticks in self._ticks.items() for topic in group.split("|")}
        #: Those that the progress of a recording waits for.
        self.gating = [ticks for ticks in self._ticks.values() if ticks.gates]

        #: Ticks of the trial that the publisher of each group says that it answered.
        self._answered: dict[str, int] = {}

    @property
    def groups(self) -> Mapping[str, Continuity]:
        """Ticks by group."""
        return self._ticks

    def ticks_of(self, topic: str) -> Continuity | None:
        """Where the stamps of a topic are counted; None if it has no place here."""
        return self._of_topic.get(topic)

    def follow(self, trial: Trial) -> bool:
        """Take note of the trial's state; whether it is another trial than before, which begins a new account."""
        other = self.trial is not None and trial.uid != self.trial.uid
        if other:
            self._answered.clear()
            for ticks in self._ticks.values():
                ticks.restart()
        self.trial = trial
        if trial.sample_time > 0:
            for ticks in self._ticks.values():
                ticks.step = trial.sample_time
        return other

    def note_answers(self, uid: int, ticks: int, topics: Iterable[str]) -> None:
        """A node says how many ticks of trial ``uid`` it has answered on the topics that it publishes."""
        if self.trial is not None and uid == self.trial.uid and ticks > 0:
            published = set(topics)
            for group in self._ticks:
                if published.issuperset(group.split("|")):
                    self._answered[group] = max(ticks, self._answered.get(group, 0))

    def complete(self) -> bool:
        """Whether every topic that gates has come as far as the trial's last tick."""
        trial = self.trial
        return trial is not None and all(ticks.newest >= trial.last_tick for ticks in self.gating)

    def lost(self) -> int:
        """Ticks missing between the first and the newest of each group; of all the trial once it has ended."""
        return sum(map(self.missing, self._ticks.values()))

    def received(self) -> int:
        """Messages that have come so far."""
        return sum(ticks.received for ticks in self._ticks.values())

    def duplicates(self) -> int:
        """Messages whose tick was there already."""
        return sum(ticks.duplicates for ticks in self._ticks.values())

    def missing(self, ticks: Continuity) -> int:
        """Ticks that one group lacks."""
        trial = self.trial
        missing = ticks.missing()
        if trial is None or trial.sample_time <= 0 or (not trial.ended and ticks.first < 0):
            return missing
        if ticks.first < 0:
            return max(0, trial.ticks_published - (trial.phase == trial.ABORTED))
        missing += max(0, round((ticks.first - trial.epoch) / trial.sample_time))
        if trial.ended:
            # A trial that was aborted owes no answers to its last tick.
            last = trial.last_tick - (trial.sample_time if trial.phase == trial.ABORTED else 0)
            missing += max(0, round((last - ticks.newest) / trial.sample_time))
        return missing

    @property
    def expected(self) -> int | None:
        """Ticks that the trial had; None while it is not known to have ended."""
        return self.trial.ticks_published if self.trial is not None and self.trial.ended else None

    def report(self) -> dict[str, dict[str, Any]]:
        """What is known of each group. Stamps in nanoseconds, -1 where there is none."""
        result = {}
        for group, ticks in self._ticks.items():
            gaps = ticks.open_gaps()
            result[group] = {
                "expected": self.expected,
                "answered": self._answered.get(group),
                "received": ticks.received,
                "missing": self.missing(ticks),
                "duplicates": ticks.duplicates,
                "late": ticks.late(),
                "first_stamp": ticks.first,
                "last_stamp": ticks.newest,
                "gaps": [list(gap) for gap in gaps[:_GAPS_LISTED]],
                "gaps_not_listed": max(0, len(gaps) - _GAPS_LISTED) + ticks.overflow,
            }
        return result

    def strings(self) -> dict[str, str]:
        """The account as a map of strings: ``complete`` (true, false, not checked), ``lost``, and more by group."""
        lost, trial = self.lost(), self.trial
        begun = all(ticks.newest >= 0 for ticks in self.gating) and bool(self.gating)
        if not self._ticks:
            verdict = "not checked"
        elif lost == 0 == self.duplicates() and (trial.ended if trial is not None else begun):
            verdict = "true"
        else:
            verdict = "false"
        result = {"complete": verdict, "lost": str(lost)}
        return result | {f"ticks {group}": json.dumps(entry) for group, entry in self.report().items()}
