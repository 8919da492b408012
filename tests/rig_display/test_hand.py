"""The hand as a force sensor: clipped, zero with a reason, never in force after a stop until it has let go."""

from __future__ import annotations

import contextlib
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_display.hand import LET_GO, NO_DRIVER, STALLED, STOPPED, Hand
from rig_display.latency import LinkClock
from rig_display.protocol import ProtocolError, parse

MS = 1_000_000
LIMITS = (40.0, 0.0, 20.0)


def hand() -> Hand:
    return Hand(LIMITS, 100 * MS)


@given(st.tuples(*(st.floats(-1e6, 1e6),) * 3))
def test_no_component_is_larger_than_its_limit(force: tuple[float, float, float]) -> None:
    made = hand()
    made.put(force, 0)
    got = made.take(0).force
    for given_, taken, limit in zip(force, got, LIMITS, strict=True):
        assert abs(taken) <= limit
        assert taken == given_ or abs(given_) > limit
    assert made.clipped == (got != force)


def test_it_lasts_as_long_as_it_is_fresh() -> None:
    made = hand()
    assert made.take(0).reason == NO_DRIVER
    made.put((5.0, 0.0, 0.0), 1000 * MS)
    assert made.take(1100 * MS).force == (5.0, 0.0, 0.0)
    stale = made.take(1101 * MS)
    assert (stale.force, stale.reason) == ((0.0, 0.0, 0.0), STALLED)
    made.put((6.0, 0.0, 0.0), 1200 * MS)
    assert made.take(1200 * MS).force == (6.0, 0.0, 0.0)


def test_every_event_is_told_once() -> None:
    made = hand()
    made.put((1.0, 0.0, 0.0), 10, event=5)
    made.put((2.0, 0.0, 0.0), 20, event=15)
    made.put((2.0, 0.0, 0.0), 30)
    assert made.take(30) == ((2.0, 0.0, 0.0), "", (5, 15))
    assert made.take(40).events == ()


def test_after_a_stop_the_hand_must_let_go_first() -> None:
    made = hand()
    made.put((5.0, 0.0, 0.0), 0)
    made.stop("the driver")
    made.put((5.0, 0.0, 0.0), 1)
    assert made.take(1) == ((0.0, 0.0, 0.0), STOPPED, ())
    made.release()
    made.put((5.0, 0.0, 0.0), 2)
    assert made.take(2).reason == LET_GO
    made.put((0.0, 0.0, 0.0), 3)
    made.put((5.0, 0.0, 0.0), 4)
    assert made.take(4).force == (5.0, 0.0, 0.0)


@given(st.integers(0, 10**12), st.lists(st.integers(0, 500 * MS), min_size=2, max_size=50))
def test_queueing_is_what_a_message_takes_longer_than_the_fastest(offset: int, delays: list[int]) -> None:
    clock = LinkClock()
    fastest = delays[0]
    for index, delay in enumerate(delays):
        sent = index * 10 * MS
        fastest = min(fastest, delay)
        assert clock.queueing(sent, offset + sent + delay) == delay - fastest


def test_an_offset_that_has_drifted_away_is_forgotten() -> None:
    clock = LinkClock()
    clock.queueing(0, 0)
    for second in range(1, 40):
        last = clock.queueing(second * 1000 * MS, second * 1000 * MS + 7 * MS)
    assert last == 0


GOOD = {"type": "force", "x": 1.5, "y": 0, "z": -2.0, "t": 10.0, "age": None}


def test_a_good_message_comes_through_as_numbers() -> None:
    assert parse(json.dumps(GOOD)) == GOOD
    assert parse('{"type": "drive"}') == {"type": "drive"}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "1",
        "null",
        '{"type": "launch"}',
        '{"type": ["force"]}',
        '{"x": 1}',
        '{"type": "drive", "more": 1}',
        '{"type": "mode", "mode": "hard"}',
        '{"type": "mode", "mode": []}',
        '{"type": "choose", "protocol": "demo"}',
        '{"type": "choose", "protocol": "demo", "subject": 7}',
        '{"type": "abort", "reason": "' + 300 * "x" + '"}',
        '{"type": "abort", "reason": "a\\u0000b"}',
        '{"type": "feedback", "on": 1}',
        "[" * 1500,
        *(
            json.dumps(GOOD).replace("1.5", bad)
            for bad in ("NaN", "Infinity", "-Infinity", "1e400", "1e7", "true", '"1"', "null", "9" * 400, "[1]")
        ),
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ProtocolError):
        parse(text)


@given(st.text(max_size=200))
def test_no_text_does_worse_than_be_refused(text: str) -> None:
    with contextlib.suppress(ProtocolError):
        assert isinstance(parse(text), dict)


@given(st.floats(), st.floats())
def test_only_finite_bounded_forces_pass(x: float, t: float) -> None:
    text = json.dumps({**GOOD, "x": x, "t": t})
    try:
        message = parse(text)
    except ProtocolError:
        assert not (math.isfinite(x) and abs(x) <= 1e6 and 0.0 <= t <= 1e12)
    else:
        assert abs(message["x"]) <= 1e6
