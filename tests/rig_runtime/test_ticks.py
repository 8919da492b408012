"""Ticks and their matching: every tick is handed out once, in order, whatever order its two sides arrive in."""

from __future__ import annotations

from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from rig_runtime.ticks import (
    LOCKSTEP_EPOCH,
    NANOSECONDS,
    Matched,
    TickClock,
    TickMatcher,
    from_stamp,
    to_nanoseconds,
    to_stamp,
)


@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
def test_stamps_survive_the_round_trip(sec: int, nanosec: int) -> None:
    nanoseconds = sec * 1_000_000_000 + nanosec
    stamp = to_stamp(nanoseconds)
    assert (stamp.sec, stamp.nanosec) == (sec, nanosec)
    assert from_stamp(stamp) == nanoseconds


def test_seconds_are_rounded_to_the_nearest_nanosecond() -> None:
    assert NANOSECONDS == 10**9
    assert [to_nanoseconds(t) for t in (0.01, 1.0, 2.6e-9, -1.5)] == [10_000_000, 10**9, 3, -1_500_000_000]


def test_a_trial_in_lockstep_begins_at_one_second() -> None:
    begin = to_stamp(LOCKSTEP_EPOCH)
    assert (begin.sec, begin.nanosec) == (1, 0)


@given(st.integers(0, 10**18), st.integers(1, 10**9), st.integers(0, 10**7))
def test_a_tick_is_known_by_its_stamp(epoch: int, sample: int, tick: int) -> None:
    clock = TickClock(epoch, sample)
    assert clock.tick(clock.stamp(tick)) == tick


def test_a_stamp_off_the_grid_is_no_tick() -> None:
    clock = TickClock(1_000, 10)
    assert clock.tick(1_005) is None
    assert clock.tick(990) is None


@given(st.permutations([(side, stamp) for stamp in range(1, 7) for side in "lr"]))
def test_each_complete_tick_comes_out_once_and_in_order(events: list[tuple[str, int]]) -> None:
    matcher: TickMatcher[int, int] = TickMatcher()
    out: list[Any] = []
    for side, stamp in events:
        put = matcher.put_left if side == "l" else matcher.put_right
        out += put(stamp, stamp, 0)
    out += matcher.expire(1)
    stamps = [tick.stamp for tick in out]
    assert stamps == sorted(set(stamps))
    assert all(tick.left == tick.stamp and tick.right in (tick.stamp, None) for tick in out)
    # What was not handed out came after a newer tick had been: it is counted, not forgotten.
    lost_left = 6 - len(out)
    lost_right = sum(tick.right is None for tick in out)
    assert matcher.late >= lost_left
    assert lost_left + lost_right <= matcher.late + 6


@given(st.lists(st.tuples(st.sampled_from("lr"), st.integers(1, 8)), max_size=60))
def test_repeats_never_yield_a_tick_twice(events: list[tuple[str, int]]) -> None:
    matcher: TickMatcher[int, int] = TickMatcher()
    out: list[Any] = []
    for side, stamp in events:
        out += (matcher.put_left if side == "l" else matcher.put_right)(stamp, stamp, 0)
    stamps = [tick.stamp for tick in out]
    assert stamps == sorted(set(stamps))


class _Model:
    """What the matcher promises, in lists: what is open, what waits for its opening, what is done."""

    def __init__(self, capacity: int) -> None:
        self.capacity, self.done = capacity, -1
        self.open: list[tuple[int, str, int]] = []
        self.early: list[tuple[int, str, int]] = []
        self.late = self.duplicates = self.overflows = 0

    def put(self, side: str, stamp: int, message: str, now: int) -> list[Matched[str, str]]:
        mine, other = (self.open, self.early) if side == "l" else (self.early, self.open)
        if stamp <= self.done:
            self.late += 1
            return []
        if any(stamp == there for there, _, _ in mine):
            self.duplicates += 1
            return []
        if side == "r" and len(mine) == self.capacity:
            mine.pop(0)
            self.overflows += 1
        mine.append((stamp, message, now))
        return self.up_to(stamp) if any(stamp == there for there, _, _ in other) else []

    def expire(self, before: int) -> list[Matched[str, str]]:
        old = [stamp for stamp, _, now in self.open if now < before]
        return self.up_to(max(old)) if old else []

    def up_to(self, newest: int) -> list[Matched[str, str]]:
        out = []
        for stamp, left, now in sorted(self.open):
            if stamp <= newest:
                right = [(message, at) for there, message, at in self.early if there == stamp]
                out.append(Matched(stamp, left, *((right[0][0], now, right[0][1]) if right else (None, now, now))))
        self.late += sum(stamp <= newest for stamp, _, _ in self.early) - sum(m.right is not None for m in out)
        self.open = [entry for entry in self.open if entry[0] > newest]
        self.early = [entry for entry in self.early if entry[0] > newest]
        self.done = newest
        return out


@given(st.lists(st.tuples(st.sampled_from("lllrrrx0"), st.integers(0, 7)), max_size=80), st.integers(1, 3))
@example([("r", 0), ("r", 1), ("r", 2), ("l", 0), ("l", 1)], 2)  # more that are early than there is room for
@example([("l", 0), ("r", 1), ("x", 5)], 3)  # one of each side waits, and not for each other
@example([("l", 0), ("x", 1)], 3)  # as old as the limit is not older
@example([("l", 7), ("r", 7), ("0", 0), ("l", 0), ("r", 0)], 3)  # a new trial's stamps begin anew
def test_whatever_comes_is_handed_out_or_counted(events: list[tuple[str, int]], capacity: int) -> None:
    matcher: TickMatcher[str, str] = TickMatcher(capacity=capacity)
    model = _Model(capacity)
    for now, (kind, number) in enumerate(events):
        if kind == "0":
            matcher.reset()
            model = _Model(capacity)
        elif kind == "x":
            assert matcher.expire(now - number) == model.expire(now - number)
        else:
            put, message = matcher.put_left if kind == "l" else matcher.put_right, f"{kind}{now}"
            assert put(number, message, now) == model.put(kind, number, message, now)
        counts = (matcher.late, matcher.duplicates, matcher.overflows, matcher.waiting)
        assert counts == (model.late, model.duplicates, model.overflows, bool(model.open))


def test_a_thousand_may_wait_for_their_state() -> None:
    matcher: TickMatcher[str, int] = TickMatcher()
    assert (matcher.late, matcher.duplicates, matcher.overflows) == (0, 0, 0)
    for stamp in range(1000):
        matcher.put_right(stamp, stamp, 0)
    assert matcher.overflows == 0
    matcher.put_right(1000, 1000, 0)
    assert matcher.overflows == 1


def test_a_tick_without_its_right_side_is_given_up_after_the_time_out() -> None:
    matcher: TickMatcher[str, str] = TickMatcher()
    matcher.put_left(1, "state 1", now=100)
    matcher.put_left(2, "state 2", now=200)
    assert [(tick.stamp, tick.right) for tick in matcher.expire(150)] == [(1, None)]
    assert matcher.put_right(1, "too late", now=300) == []
    assert matcher.late == 1
    assert [tick.right for tick in matcher.put_right(2, "in time", now=300)] == ["in time"]


def test_an_overtaken_tick_still_gets_its_answer() -> None:
    matcher: TickMatcher[str, str] = TickMatcher()
    matcher.put_left(1, "a", 0)
    matcher.put_left(2, "b", 0)
    assert [(tick.stamp, tick.right) for tick in matcher.put_right(2, "B", 0)] == [(1, None), (2, "B")]


def test_what_waits_for_its_state_is_bounded() -> None:
    matcher: TickMatcher[str, int] = TickMatcher(capacity=3)
    for stamp in range(1, 6):
        matcher.put_right(stamp, stamp, 0)
    assert matcher.overflows == 2


def test_a_new_trial_begins_with_nothing_of_the_one_before() -> None:
    matcher: TickMatcher[str, str] = TickMatcher()
    matcher.put_left(5, "state", 0)
    matcher.put_right(5, "wrench", 0)
    matcher.put_right(4, "late", 0)
    matcher.put_left(7, "open", 0)
    matcher.put_right(8, "early", 0)
    assert matcher.late == 1
    assert matcher.waiting
    matcher.reset()
    assert (matcher.late, matcher.duplicates, matcher.overflows, matcher.waiting) == (0, 0, 0, False)
    assert matcher.expire(1) == []
    # Stamps of the trial before are free again, and the early wrench is none of this trial's.
    assert [tick.right for tick in [*matcher.put_left(8, "state", 0), *matcher.put_right(8, "mine", 0)]] == ["mine"]
