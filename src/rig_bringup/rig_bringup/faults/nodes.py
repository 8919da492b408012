"""Faults of nodes: stopped, killed, started again, interrupted, reconfigured while they work."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable
from typing import Any

from mig_interfaces.msg import TrialState
from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.rows import LIMIT, Inject, Seen, expect_every_tick_once, in_every_mode, row
from rig_runtime import topics
from rig_runtime.run import wait_until
from shared_control.filter import Reason

#: Most injections of a fault after which a process has to be started again, which takes a second or two.
MOST_STARTS = 50


def _stopped(node: str) -> Inject:
    """Stopped in the middle of whatever it does, and let go on after the force is zero."""

    def inject(graph: LiveGraph, repeats: int) -> Seen:
        zero = []
        for _ in range(repeats):
            since = graph.stop(node)
            try:
                zero.append(graph.zero_after(since))
            finally:
                graph.resume(node)
            graph.recover()
        return Seen(zero)

    return inject


def _killed(node: str) -> Inject:
    """Killed, and started again in the middle of the trial."""

    def inject(graph: LiveGraph, repeats: int) -> Seen:
        zero = []
        for _ in range(min(repeats, MOST_STARTS)):
            since = graph.kill(node)
            zero.append(graph.zero_after(since))
            graph.start(node)
            # What moved before it was killed says nothing of whether it moves again.
            graph.hand.motions.clear()
            graph.recover()
        return Seen(zero)

    return inject


row("filter/stopped", "the filter is stopped (SIGSTOP)", "the robot under no force; goes on by itself", LIMIT)(
    in_every_mode(_stopped("mig_filter"))
)
row("filter/killed", "the filter is killed (-9) and started again", "the robot under no force until then", LIMIT)(
    _killed("mig_filter")
)
row("task/stopped", "the task is stopped (SIGSTOP)", "no commands, the robot under no force; goes on", LIMIT)(
    in_every_mode(_stopped("task_sim"))
)
row("task/killed", "the task is killed (-9) and started again", "the robot under no force; a new trial", LIMIT)(
    _killed("task_sim")
)


def _without_robot(restart: bool) -> Inject:
    """The task holds the last motion and then goes on under zero force, until the robot is back."""

    def inject(graph: LiveGraph, repeats: int) -> Seen:
        zero, hand = [], graph.hand
        for _ in range(min(repeats, MOST_STARTS) if restart else repeats):
            hand.states.clear()
            since = graph.kill("admittance_sim") if restart else graph.stop("admittance_sim")
            try:
                zero.append(graph.coasting_after(since))
                hand.states.clear()
                graph.ticks(10)
                if any(any(state.control) for state in hand.states):
                    raise FaultError("the task went on under a force before the robot was back")
            finally:
                graph.start("admittance_sim") if restart else graph.resume("admittance_sim")
            hand.motions.clear()
            graph.recover()
        return Seen(zero)

    return inject


row("robot/stopped", "the robot is stopped (SIGSTOP)", "the task holds the motion, then zero force; goes on", LIMIT)(
    _without_robot(restart=False)
)
row("robot/killed", "the robot is killed (-9) and started again", "as stopped; from rest when it is back", LIMIT)(
    _without_robot(restart=True)
)


@row("recorder/stopped", "the recorder is stopped (SIGSTOP) for a second", "the loop does not notice, nothing is lost")
def _recorder_stopped(graph: LiveGraph, _: int) -> Seen:
    graph.stop("recorder")
    try:
        graph.ticks(100)
    finally:
        graph.resume("recorder")
    expect_every_tick_once(graph)
    return Seen([])


def recorder_killed(seed: int, follows: Callable[[Any], None] = lambda graph: None) -> Inject:
    """The recorder is killed at random moments, and started again; what else must follow each time is looked at."""

    def inject(graph: LiveGraph, repeats: int) -> Seen:
        moments, remark, count = random.Random(seed), "", min(repeats, MOST_STARTS)
        for _ in range(count):
            # In any phase of the second between two flushes.
            graph.ticks(moments.randrange(1, 200))
            graph.hand.forget()
            graph.kill("recorder")
            graph.ticks(100)
            try:
                expect_every_tick_once(graph)
                follows(graph)
                remark = graph.repair()
            finally:
                graph.new_bag()
            # To repair and to start again is work beside the loop, and where processors are short a fault of its own.
            graph.ready()
        return Seen([], f"{count} of {count} bags repaired; the last: {remark}")

    return inject


row(
    "recorder/killed",
    "the recorder is killed (-9) at a random moment and started again",
    "the loop goes on; its bag is repaired, and holds every decision up to its end or says that it lacks it",
)(recorder_killed(seed=9))


@row(
    "queue/recorder",
    "the recorder is stopped for so long that its queues overflow",
    "the loop does not notice; counted",
)
def _recorder_overrun(graph: LiveGraph, _: int) -> Seen:
    def lost() -> int:
        return graph.recorded().lost

    before = lost()
    graph.hand.forget()
    graph.stop("recorder")
    try:
        graph.ticks(8 * topics.DEPTH)
    finally:
        graph.resume("recorder")
    expect_every_tick_once(graph)
    graph.wait(lambda: lost() > before, "what was lost has not been counted on recorder/state", limit=30.0)
    return Seen([], f"{lost() - before} ticks of its topics counted as lost")


@row(
    "queue/filter",
    "the filter is stopped for so long that its queues overflow",
    "no force; what is left is late",
    LIMIT,
)
def _filter_overrun(graph: LiveGraph, _: int) -> Seen:
    since = graph.stop("mig_filter")
    try:
        zero = graph.zero_after(since)
        graph.ticks(2 * topics.DEPTH)
        moved = [heard for heard in graph.hand.motions if heard.at > since + zero]
        if any(heard.force for heard in moved):
            raise FaultError("the robot moved under a force while the filter stood still")
    finally:
        graph.resume("mig_filter")
    graph.hand.motions.clear()
    graph.recover()
    twice = [tick for tick, count in graph.hand.decided.items() if count > 1]
    if twice:
        raise FaultError(f"{len(twice)} ticks were decided twice")
    return Seen([zero], f"{2 * topics.DEPTH} ticks without a filter")


@row("filter/overruns", "a controller that needs a hundred ticks for one", "what is late is dropped: no force", LIMIT)
def _filter_slow(graph: LiveGraph, _: int) -> Seen:
    hand = graph.hand
    # Off, it is as fast as any other.
    graph.replace_filter(horizon=60.0, controller_iterations=1000, controller_tolerance=0.0)
    try:
        graph.recover()
        hand.forget()
        graph.ticks(5)
        graph.change("mig_filter", mode="assistance", threshold=-1e9)
        graph.still()
        followed = [heard for heard in hand.motions if heard.force]
        zero = hand.first_still - hand.account.pushed[followed[-1].stamp].at
        graph.wait(lambda: hand.slowest > 10.0 * LIMIT, "the slow filter has not taken long over a decision")
        slowest = hand.slowest
        hand.forget()
        graph.ticks(150)
        forces = {heard.force for heard in hand.motions}
        if len(hand.motions) < 100 or forces - {0.0}:
            raise FaultError(f"{len(hand.motions)} motions under {sorted(forces)} N; each should be under none")
    finally:
        graph.replace_filter()
    graph.recover()
    return Seen([zero], f"a decision took {slowest:.1f} s")


def _late_states(graph: LiveGraph, repeats: int) -> Seen:
    """Of a task that was stopped for longer than `state_timeout` and catches up."""
    zero, count = [], 0
    for _ in range(repeats):
        since = graph.stop("task_sim")
        try:
            zero.append(graph.zero_after(since))
            time.sleep(0.2)
        finally:
            graph.resume("task_sim")
        graph.ticks(40)
        reasons = [decided.reason for decided in graph.hand.account.decided.values()]
        count = reasons.count(Reason.STALE_STATE)
        if not count:
            raise FaultError("no decision gave the reason stale_state")
        graph.recover()
    return Seen(zero, f"{count} ticks")


@row(
    "state/stale",
    "the states come late by 0.3 s, with state_timeout at 0.05",
    "no force, stale state; goes on by itself",
    LIMIT,
)
def _stale_states(graph: LiveGraph, repeats: int) -> Seen:
    graph.replace_filter(state_timeout=0.05)
    try:
        graph.recover()
        return in_every_mode(_late_states)(graph, repeats)
    finally:
        graph.replace_filter()


#: Changes of the filter's parameters that must be refused: each is too small, no number, of another type, or not one
#: that changes in flight.
_WRONG: tuple[dict[str, object], ...] = (
    {"dead_zone": -1.0},
    {"threshold": math.nan},
    {"contraction": "much"},
    {"mode": "fast"},
    {"max_force": -1.0},
    {"max_force": math.nan},
    {"horizon": 2.0},
)


@row(
    "parameters/changed",
    "a hundred changes at random moments, one in three not allowed; more while a trial is armed",
    "refused, or in force from a tick on; each tick once",
)
def _parameters(graph: LiveGraph, _: int) -> Seen:
    hand, moments, refused = graph.hand, random.Random(3), 0

    def good(k: int) -> dict[str, Any]:
        forces = moments.choice([50.0, 10_000.0])
        mode = moments.choice(["off", "training", "assistance"])
        return {"mode": mode, "threshold": float(k % 7), "dead_zone": 0.0, "max_force": forces}

    def wrong() -> None:
        parameters = moments.choice(_WRONG)
        if not graph.change("mig_filter", **parameters):
            raise FaultError(f"a change to {parameters} was taken")

    hand.forget()
    for k in range(100):
        if k % 3 == 0:
            wrong()
            refused += 1
        else:
            graph.judge(**good(k))
        graph.ticks(moments.randrange(3))
    expect_every_tick_once(graph)
    uid, armed, changed = hand.trial.uid, 0, good(0)
    graph.kill("task_sim")
    graph.start("task_sim")
    while hand.trial.uid == uid or hand.trial.phase != TrialState.PHASE_RUNNING:
        wrong()
        changed = good(armed)
        if refusals := graph.change("mig_filter", **changed):
            raise FaultError(f"while a trial was armed {changed} was refused: {refusals[0]}")
        armed += 1
        wait_until(lambda: False, graph.executor, 0.02)
    graph.wait(lambda: hand.judged(changed["mode"], changed["threshold"]), "what was changed is not in force")
    graph.judge("off", dead_zone=0.0, max_force=10_000.0)
    graph.recover()
    expect_every_tick_once(graph)
    return Seen([], f"{refused} of 100 refused; {armed} while a trial was armed")
