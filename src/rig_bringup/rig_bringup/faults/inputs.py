"""Faults of what comes in: wrenches and states that are lost, late, doubled or impossible."""

from __future__ import annotations

import math
from collections.abc import Callable

from geometry_msgs.msg import WrenchStamped

from mig_interfaces.msg import TaskState
from rig_bringup.faults.account import Pushed
from rig_bringup.faults.hand import POISON, Hand, good_force
from rig_bringup.faults.live_graph import LiveGraph
from rig_bringup.faults.rows import LIMIT, Inject, Seen, expect_every_tick_once, expect_reason, in_every_mode, row
from rig_runtime import topics
from rig_runtime.ticks import to_stamp
from shared_control.filter import Reason

_SAMPLE = 10_000_000  # [ns]
_AHEAD = 10  # [ticks] how far a wrench is out of time

# -- the wrench ----------------------------------------------------------------------------------------------------


def _bad_wrench(reason: Reason, force: float, frame: str = topics.SENSOR_FRAME) -> Inject:
    """A sensor that says what cannot be, for twenty ticks."""

    def inject(graph: LiveGraph, repeats: int) -> Seen:
        hand, zero = graph.hand, []
        for _ in range(repeats):
            hand.answer = lambda stamp, tick: hand.say(stamp, force, frame)
            graph.ticks(1)
            since = hand.last_good
            zero.append(graph.zero_after(since))
            graph.ticks(10)
            expect_reason(graph, reason)
            graph.recover()
        return Seen(zero)

    return in_every_mode(inject)


_ZERO = "no force and the reason in each decision; goes on with the first good wrench"

row("wrench/nan", "the wrench is NaN", _ZERO, 0.03)(_bad_wrench(Reason.NON_FINITE_WRENCH, math.nan))
row("wrench/infinite", "the wrench is infinite", _ZERO, 0.03)(_bad_wrench(Reason.NON_FINITE_WRENCH, math.inf))
row("wrench/huge", "the wrench is 1e6 N", _ZERO, 0.03)(_bad_wrench(Reason.EXCESSIVE_WRENCH, 1e6))
row("wrench/frame", "the wrench is in another frame", _ZERO, 0.03)(_bad_wrench(Reason.UNKNOWN_FRAME, POISON, "tool"))


def _no_wrench(answer: Callable[[Hand, int], None]) -> Inject:
    """No wrench comes that is for the present, for so long that the force is zero and twenty ticks."""

    def inject(graph: LiveGraph, repeats: int) -> Seen:
        hand, zero, ticks = graph.hand, [], 0
        for _ in range(repeats):
            hand.answer = lambda stamp, tick: answer(hand, stamp)
            zero.append(graph.zero_after(hand.last_good))
            graph.ticks(10)
            ticks = expect_reason(graph, Reason.STALE_WRENCH)
            # What was said ahead would be taken for the first wrench of its tick.
            hand.answer = lambda stamp, tick: None
            graph.ticks(_AHEAD + 1)
            graph.recover()
        return Seen(zero, f"{ticks} ticks")

    return in_every_mode(inject)


row("wrench/silent", "no wrench comes", "no force, stale wrench; goes on by itself", LIMIT)(
    _no_wrench(lambda hand, stamp: None)
)
row("wrench/stale", "each wrench comes ten ticks late", "no force, stale wrench: what is late is dropped", LIMIT)(
    _no_wrench(lambda hand, stamp: hand.say(stamp - _AHEAD * _SAMPLE, POISON))
)
row("wrench/future", "each wrench is stamped ten ticks ahead", "no force, stale wrench: that is dropped", LIMIT)(
    _no_wrench(lambda hand, stamp: hand.say(stamp + _AHEAD * _SAMPLE, POISON))
)


@row(
    "wrench/out of order", "pairs of wrenches change places", "each tick is decided once, on its own wrench or on none"
)
def _out_of_order(graph: LiveGraph, _: int) -> Seen:
    kept: list[tuple[int, int]] = []

    def swap(stamp: int, tick: int) -> None:
        kept.append((stamp, tick))
        if len(kept) == 2:
            graph.hand.push(*kept.pop())
            graph.hand.push(*kept.pop())

    graph.hand.answer = swap
    graph.ticks(50)
    expect_every_tick_once(graph)
    return Seen([])


@row("wrench/duplicated", "each wrench comes twice, the second with another force", "the first counts; counted")
def _duplicated(graph: LiveGraph, _: int) -> Seen:
    def twice(stamp: int, tick: int) -> None:
        graph.hand.push(stamp, tick)
        graph.hand.say(stamp, POISON)

    return _flooded(graph, twice)


@row("wrench/10 kHz", "a hundred wrenches for each tick", "the first counts; every tick is decided once")
def _fast(graph: LiveGraph, _: int) -> Seen:
    def flood(stamp: int, tick: int) -> None:
        graph.hand.push(stamp, tick)
        for _ in range(99):
            graph.hand.say(stamp, POISON)

    return _flooded(graph, flood)


def _flooded(graph: LiveGraph, answer: Callable[[int, int], None]) -> Seen:
    graph.hand.answer = answer
    graph.ticks(50)
    expect_every_tick_once(graph)
    graph.hand.answer = graph.hand.push

    def dropped() -> int:
        return sum(graph.hand.warned("mig_filter", key) for key in ("late", "duplicates"))

    graph.wait(lambda: dropped() > 0, "what was dropped has not been counted in the diagnostics")
    return Seen([], f"{dropped()} dropped")


@row("wrench/10 Hz", "a wrench for every tenth tick only", "no force on the others; every tick is decided once")
def _slow(graph: LiveGraph, _: int) -> Seen:
    graph.hand.answer = lambda stamp, tick: graph.hand.push(stamp, tick) if tick % 10 == 0 else None
    graph.ticks(100)
    expect_every_tick_once(graph)
    return Seen([], f"{expect_reason(graph, Reason.STALE_WRENCH)} ticks without force")


@row("wrench/two publishers", "a second node pushes too", "the first of each tick counts, the other is counted")
def _two_publishers(graph: LiveGraph, _: int) -> Seen:
    second = graph.hand.create_publisher(WrenchStamped, topics.WRENCH.name, topics.WRENCH.qos)

    def both(stamp: int, tick: int) -> None:
        message = WrenchStamped()
        message.header.stamp, message.header.frame_id = to_stamp(stamp), topics.SENSOR_FRAME
        message.wrench.force.x = -2.0 * good_force(tick)
        # Each is the first in every other pair of ticks.
        if tick % 4 < 2:
            graph.hand.push(stamp, tick)
            second.publish(message)
        else:
            second.publish(message)
            graph.hand.push(stamp, tick)
            graph.hand.account.pushed[stamp] = Pushed(message.wrench.force.x, graph.hand.last_good)

    try:
        graph.wait(lambda: second.get_subscription_count() > 0, "the second publisher was not matched")
        return _flooded(graph, both)
    finally:
        graph.hand.destroy_publisher(second)


# -- the state -----------------------------------------------------------------------------------------------------


def _bad_state(graph: LiveGraph, _: int) -> Seen:
    states = graph.hand.create_publisher(TaskState, topics.TASK_STATE.name, topics.TASK_STATE.qos)
    graph.wait(lambda: states.get_subscription_count() >= 2, "the false state's publisher was not matched")
    # A false state that is published late stands behind the next true one.
    graph.out_of_turn.add(topics.TASK_STATE.name)
    false: set[int] = set()

    def disturb(stamp: int, tick: int) -> None:
        if stamp in false:
            graph.hand.say(stamp, POISON)
            return
        graph.hand.push(stamp, tick)
        message = TaskState(tick=2**40 + tick, state=[math.nan] * 4, control=[0.0])
        message.header.stamp, message.header.frame_id = to_stamp(stamp + _SAMPLE // 2), topics.TASK_FRAME
        false.add(stamp + _SAMPLE // 2)
        states.publish(message)

    graph.hand.answer = disturb
    graph.ticks(50)
    graph.hand.answer = graph.hand.push
    graph.hand.destroy_publisher(states)
    graph.ticks(20)
    return Seen([], f"{expect_reason(graph, Reason.NON_FINITE_STATE)} ticks")


row("state/not finite", "a state of NaN between two ticks, with a good wrench", "no force, non finite state")(
    in_every_mode(_bad_state)
)
