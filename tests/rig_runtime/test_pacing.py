"""Pacing as a state machine: wall time decides in real time, the loop and the recorder in lockstep."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rig_runtime.pacing import Advance, Pacemaker

STEP, TIMEOUT = 10, 50


def realtime() -> Pacemaker:
    pacemaker = Pacemaker(realtime=True, sample=STEP, command_timeout=TIMEOUT)
    pacemaker.start(0)
    return pacemaker


def test_realtime_goes_on_when_the_time_has_come_and_not_before() -> None:
    pacemaker = realtime()
    assert pacemaker.take(0)
    assert pacemaker.advance(STEP - 1) is None
    assert pacemaker.advance(STEP) is Advance.MOTION
    assert (pacemaker.tick, pacemaker.missed) == (1, 0)


def test_a_late_loop_holds_then_coasts_and_every_miss_is_counted() -> None:
    pacemaker = realtime()
    assert [pacemaker.advance(k * STEP) for k in range(1, 7)] == [Advance.HOLD] * 4 + [Advance.COAST] * 2
    assert pacemaker.missed == 6
    assert pacemaker.take(6)
    assert pacemaker.advance(7 * STEP) is Advance.MOTION
    assert pacemaker.advance(8 * STEP) is Advance.HOLD, "the silence is counted anew after a motion"


def test_a_motion_that_comes_late_is_counted_and_held() -> None:
    pacemaker = realtime()
    assert [pacemaker.advance(k * STEP) for k in range(1, 7)][-1] is Advance.COAST
    assert pacemaker.take(4), "it is what the robot did last"
    assert pacemaker.late == 1
    assert [pacemaker.advance(k * STEP) for k in range(7, 11)] == [Advance.HOLD] * 3 + [Advance.COAST]
    assert not pacemaker.take(3), "not the newest"
    assert not pacemaker.take(11), "of a tick that has not been"
    assert pacemaker.late == 3
    assert pacemaker.missed == 10


def test_a_stall_is_caught_up_tick_by_tick() -> None:
    pacemaker = realtime()
    pacemaker.take(0)
    advances = []
    while (advance := pacemaker.advance(3 * STEP)) is not None:
        advances.append(advance)
    assert advances == [Advance.MOTION, Advance.HOLD, Advance.HOLD]


def test_a_motion_counts_once() -> None:
    pacemaker = realtime()
    assert pacemaker.take(0)
    assert not pacemaker.take(0)


@given(st.integers(1, 5), st.lists(st.sampled_from(["close", "record", "advance"]), max_size=200))
def test_lockstep_never_runs_further_ahead_of_the_recorder_than_its_window(window: int, events: list[str]) -> None:
    pacemaker = Pacemaker(realtime=False, sample=STEP, command_timeout=TIMEOUT, recorder_window=window)
    pacemaker.start(0)
    recorded = -1
    closed = False
    for event in events:
        if event == "close":
            closed = pacemaker.take(pacemaker.tick) or closed
        elif event == "record":
            recorded = min(recorded + 1, pacemaker.tick)
            pacemaker.recorded(recorded)
        else:
            before = pacemaker.tick
            advance = pacemaker.advance(10**9)
            assert (advance is Advance.MOTION) == (closed and before - recorded <= window)
            if advance is not None:
                assert pacemaker.tick == before + 1
                closed = False
    assert pacemaker.tick - recorded <= window + 1
    assert pacemaker.missed == 0


def test_lockstep_says_what_it_waits_for() -> None:
    pacemaker = Pacemaker(realtime=False, sample=STEP, command_timeout=TIMEOUT, recorder_window=1)
    pacemaker.start(0)
    assert pacemaker.waits_for() == "loop"
    pacemaker.take(0)
    pacemaker.advance(0)
    pacemaker.take(1)
    assert pacemaker.advance(0) is None
    assert pacemaker.waits_for() == "recorder"
