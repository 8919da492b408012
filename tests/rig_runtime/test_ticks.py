"""Ticks and their matching: every tick is handed out once, in order, whatever order its two sides arrive in."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from rig_runtime.ticks import TickClock, TickMatcher, from_stamp, to_stamp


@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
def test_stamps_survive_the_round_trip(sec: int, nanosec: int) -> None:
    nanoseconds = sec * 1_000_000_000 + nanosec
    stamp = to_stamp(nanoseconds)
    assert (stamp.sec, stamp.nanosec) == (sec, nanosec)
    assert from_stamp(stamp) == nanoseconds


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
