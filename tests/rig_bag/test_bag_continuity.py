"""Counting gaps, duplicates and late ticks, against a model that remembers every stamp."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from rig_bag.continuity import Continuity

STEP = 10_000_000
EPOCH = 1_700_000_000_123_456_789


class Ticks(RuleBasedStateMachine):
    """Ticks of one topic arrive; the step becomes known at some time."""

    def __init__(self) -> None:
        super().__init__()
        self.ticks = Continuity()
        self.seen: set[int] = set()
        self.received = self.duplicates = self.late = 0
        self.newest = -1

    def _send(self, tick: int) -> None:
        self.ticks.observe(EPOCH + tick * STEP)
        self.received += 1
        if tick in self.seen:
            self.duplicates += 1
        elif self.seen and min(self.seen) < tick < self.newest:
            self.late += 1
        self.seen.add(tick)
        self.newest = max(self.newest, tick)

    @rule(first=st.integers(0, 5), run=st.integers(1, 40))
    def regular(self, first: int, run: int) -> None:
        start = self.newest + 1 if self.seen else first
        for tick in range(start, start + run):
            self._send(tick)

    @precondition(lambda self: self.seen)
    @rule(skipped=st.integers(1, 30))
    def gap(self, skipped: int) -> None:
        self._send(self.newest + 1 + skipped)

    @precondition(lambda self: self.seen)
    @rule(data=st.data())
    def duplicate(self, data: st.DataObject) -> None:
        self._send(data.draw(st.sampled_from(sorted(self.seen))))

    @precondition(lambda self: set(range(self.newest)) - self.seen)
    @rule(data=st.data())
    def late_or_before_the_first(self, data: st.DataObject) -> None:
        self._send(data.draw(st.sampled_from(sorted(set(range(self.newest)) - self.seen))))

    @rule()
    def step_becomes_known(self) -> None:
        self.ticks.step = STEP

    @invariant()
    def agrees_with_the_model(self) -> None:
        ticks = self.ticks
        assert (ticks.received, ticks.duplicates, ticks.late()) == (self.received, self.duplicates, self.late)
        if not self.seen:
            assert ticks.first == ticks.newest == -1
            return
        assert ticks.first == EPOCH + min(self.seen) * STEP
        assert ticks.newest == EPOCH + max(self.seen) * STEP
        missing = max(self.seen) - min(self.seen) + 1 - len(self.seen)
        assert ticks.missing() == (missing if ticks.step else 0)
        if ticks.step:
            assert sum(count for _, _, count in ticks.open_gaps()) == missing


Ticks.TestCase.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
TestTicks = Ticks.TestCase


def test_a_new_trial_is_no_gap() -> None:
    ticks = Continuity(STEP)
    for stamp in (EPOCH, EPOCH + STEP):
        ticks.observe(stamp)
    ticks.restart()
    ticks.observe(EPOCH + 500 * STEP)
    assert (ticks.received, ticks.missing(), ticks.duplicates) == (3, 0, 0)


def test_stamps_that_do_not_tick_are_counted_only() -> None:
    ticks = Continuity(STEP)
    for number in range(10_050):
        ticks.observe(number * number)
    assert len(ticks.gaps) == 10_000
    assert ticks.overflow == 49
