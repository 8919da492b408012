"""Silence, lateness and kept faults, with time as numbers."""

from __future__ import annotations

import enum
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_runtime.faults import LOOKS, STEADY, FaultLatch, Lateness, Loss, Silence, in_words

MILLISECOND = 1_000_000


def test_a_stream_is_silent_after_its_limit_and_not_before() -> None:
    silence = Silence(0.05)
    assert silence.period == pytest.approx(0.005)
    found = [silence.look() for _ in range(LOOKS + 2)]
    assert found == [False] * (LOOKS - 1) + [True] * 3
    assert silence.lasting == pytest.approx(0.06)
    silence.heard()
    assert not silence.silent
    assert silence.lasting == 0.0


@given(limit=st.floats(1e-3, 10.0), heard_at=st.floats(0.0, 1.0))
def test_silence_is_found_within_its_limit(limit: float, heard_at: float) -> None:
    """However the last message falls between two looks, from it to the finding passes at most the limit."""
    silence = Silence(limit)
    silence.heard()
    # The next look comes a part of a period after the message.
    elapsed = heard_at * silence.period
    while not silence.look():
        elapsed += silence.period
    assert elapsed <= limit * (1 + 1e-9) + 1e-3


def test_a_process_that_slept_looks_once_when_it_wakes() -> None:
    silence = Silence(0.05)
    assert not silence.look(), "one look, however late, is no silence"


SAMPLE, OFFSET = 10 * MILLISECOND, 123_456_789_012


@given(st.lists(st.integers(0, 10**9), min_size=1), st.integers(0, 10**9))
def test_lateness_is_against_the_best_so_far(delays: list[int], limit: int) -> None:
    lateness = Lateness(limit)
    for k in range(1, len(delays)):
        # None overtakes the one before.
        delays[k] = max(delays[k], delays[k - 1] - SAMPLE)
    for k, delay in enumerate(delays):
        late = lateness.late(k * SAMPLE, OFFSET + k * SAMPLE + delay)
        against = delay - min(delays[: k + 1])
        # The best may have risen, by no more than clocks can run apart meanwhile.
        rise = (k * SAMPLE + 10**9) // STEADY
        assert against - rise <= lateness.last <= against
        assert late is (lateness.last > limit)


@given(st.floats(-1.0, 1.0), st.integers(1, 400))
def test_clocks_that_run_apart_make_nothing_late(apart: float, seconds: int) -> None:
    lateness = Lateness(MILLISECOND)
    for second in range(seconds):
        stamp = second * 10**9
        assert not lateness.late(stamp, OFFSET + stamp + int(apart * stamp / STEADY))


@given(st.integers(1, 10**9), st.integers(1, 2000))
def test_what_is_late_stays_so_for_however_long_it_is(beyond: int, ticks: int) -> None:
    limit = 50 * MILLISECOND
    lateness = Lateness(limit)
    assert not lateness.late(0, OFFSET)
    delay = limit + 2 * 10**9 // STEADY + beyond
    assert all(lateness.late(k * SAMPLE, OFFSET + k * SAMPLE + delay) for k in range(1, ticks + 1))
    assert not lateness.late((ticks + 1) * SAMPLE, OFFSET + (ticks + 1) * SAMPLE)


def test_clocks_may_run_apart_by_200_microseconds_in_a_second() -> None:
    apart = 200 * 1000 + 40  # the 200 us themselves take a little, in which the clocks go on
    for more, late in ((0, False), (1, True)):
        lateness = Lateness(0)
        assert not lateness.late(0, 0)
        assert lateness.late(10**9, 10**9 + apart + more) is late


def test_lateness_begins_anew_with_a_trial() -> None:
    lateness = Lateness(10)
    assert lateness.last == 0
    assert not lateness.late(0, 5)
    assert lateness.late(0, 50)
    assert lateness.last == 45
    lateness.reset()
    assert lateness.last == 0
    assert not lateness.late(1000, 10**9)
    assert lateness.last == 0


@given(st.lists(st.sampled_from([None, "a", "b"])))
def test_a_kept_fault_is_the_first_one(faults: list[str | None]) -> None:
    latch: FaultLatch[str] = FaultLatch(explicit=True)
    held = [latch.hold(fault) for fault in faults]
    first = next((k for k, fault in enumerate(faults) if fault), len(faults))
    assert held == [None] * first + faults[first : first + 1] * (len(faults) - first)
    assert latch.clear() == (faults[first] if first < len(faults) else None)
    assert latch.hold(None) is None


@given(st.lists(st.sampled_from([None, "a", "b"])))
def test_with_automatic_recovery_nothing_is_kept(faults: list[str | None]) -> None:
    latch: FaultLatch[str] = FaultLatch(explicit=False)
    assert [latch.hold(fault) for fault in faults] == faults
    assert latch.clear() is None


def test_a_loss_is_said_in_words_while_it_lasts_and_once_it_is_over() -> None:
    loss, begin = Loss(), 10**12
    assert not loss.tell(None, begin)
    assert loss.words(begin) == ""
    assert loss.tell("no motion", begin)
    assert loss.words(begin) == "no force: no motion"
    assert loss.words(begin + 300 * MILLISECOND, "coasting") == "coasting for 0.30 s: no motion"
    assert loss.lasting(begin + 300 * MILLISECOND) == pytest.approx(0.3)
    # What is lost may change: there has been no force all the while.
    assert loss.tell("no state", begin + 300 * MILLISECOND)
    assert loss.words(begin + 400 * MILLISECOND) == "no force for 0.40 s: no state"
    end = begin + 500 * MILLISECOND
    assert loss.tell(None, end)
    assert loss.lasting(end) == 0.0
    assert loss.words(end + 1500 * MILLISECOND) == "no force for 0.50 s until 1.5 s ago: no state"
    assert loss.words(end + 1500 * MILLISECOND, remember=1.0) == ""
    loss.reset()
    assert loss.words(end) == ""


def test_how_long_a_loss_has_lasted_is_said_from_a_tenth_of_a_second_on() -> None:
    loss = Loss()
    loss.tell("no motion", 0)
    said = {99: "no force", 100: "no force for 0.10 s", 990: "no force for 0.99 s", 1000: "no force for 1.0 s"}
    assert {at: loss.words(at * MILLISECOND).partition(":")[0] for at in said} == said
    loss.tell(None, 1500 * MILLISECOND)
    # As long as it is to be remembered, and no longer.
    assert loss.words(2500 * MILLISECOND, remember=1.0) == "no force for 1.5 s until 1.0 s ago: no motion"
    assert loss.words(2501 * MILLISECOND, remember=1.0) == ""


@given(st.lists(st.sampled_from([None, "a", "b"]), min_size=100, max_size=300))
def test_what_comes_and_goes_is_said_five_times_a_second_and_never_for_long_otherwise(lost: list[str | None]) -> None:
    loss, said = Loss(), [(-1000, None)]
    for k, what in enumerate(lost):
        if loss.tell(what, 10 * k * MILLISECOND):
            said.append((k, what))
        # A tick is 10 ms: what is said lags behind what is so by no more than the pause.
        assert what == said[-1][1] or k - said[-1][0] < 20
    assert all(later[0] - sooner[0] >= 20 for sooner, later in itertools.pairwise(said))
    assert all(later[1] != sooner[1] for sooner, later in itertools.pairwise(said))


def test_a_sentence_is_read_as_it_is_and_a_member_by_its_name() -> None:
    assert in_words(enum.Enum("Fault", "STALE_WRENCH").STALE_WRENCH) == "stale wrench"
    assert in_words("no answer of task_sim") == "no answer of task_sim"
