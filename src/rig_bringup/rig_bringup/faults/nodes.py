"""Faults of nodes: stopped, killed, started again, interrupted, reconfigured while they work."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable

from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.rows import LIMIT, Inject, Seen, expect_every_tick_once, in_every_mode, row
from rig_runtime import topics
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


def _without_robot(graph: LiveGraph, lose: Callable[[], float], restore: Callable[[], None]) -> Seen:
    """The task goes on under zero force: held states whose control is zero."""
    graph.hand.states.clear()
    lose()
    graph.wait(
        lambda: any(state.held and not any(state.control) for state in graph.hand.states),
        "the task has not gone over to zero force",
        limit=10.0,
    )
    restore()
    graph.hand.motions.clear()
    graph.recover()
    held = sum(state.held for state in graph.hand.states)
    return Seen([], f"{held} ticks held or without force")


@row("robot/stopped", "the robot is stopped (SIGSTOP)", "the task holds the motion, then goes on under zero force")
def _robot_stopped(graph: LiveGraph, _: int) -> Seen:
    return _without_robot(graph, lambda: graph.stop("admittance_sim"), lambda: graph.resume("admittance_sim"))


@row("robot/killed", "the robot is killed (-9) and started again", "as stopped; from rest when it is back")
def _robot_killed(graph: LiveGraph, _: int) -> Seen:
    return _without_robot(graph, lambda: graph.kill("admittance_sim"), lambda: graph.start("admittance_sim"))


@row("recorder/stopped", "the recorder is stopped (SIGSTOP) for a second", "the loop does not notice, nothing is lost")
def _recorder_stopped(graph: LiveGraph, _: int) -> Seen:
    graph.stop("recorder")
    try:
        graph.ticks(100)
    finally:
        graph.resume("recorder")
    expect_every_tick_once(graph)
    return Seen([])


@row("recorder/killed", "the recorder is killed (-9) and started again", "the loop goes on; its bag is repaired")
def _recorder_killed(graph: LiveGraph, repeats: int) -> Seen:
    remark = ""
    for _ in range(min(repeats, MOST_STARTS)):
        graph.hand.forget()
        graph.kill("recorder")
        graph.ticks(100)
        try:
            expect_every_tick_once(graph)
            remark = graph.repair()
        finally:
            graph.new_bag()
    return Seen([], f"{min(repeats, MOST_STARTS)} of {min(repeats, MOST_STARTS)} bags repaired; the last: {remark}")


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


@row("filter/overruns", "a controller that needs a hundred ticks for one", "what comes late is dropped: no force")
def _filter_slow(graph: LiveGraph, _: int) -> Seen:
    graph.replace_filter(
        mode="assistance",
        horizon=60.0,
        controller_iterations=1000,
        controller_tolerance=0.0,
        threshold=-1e9,
    )
    graph.hand.forget()
    try:
        graph.wait(lambda: graph.hand.slowest > 10.0 * LIMIT, "the slow filter has not taken long over a decision")
        slowest = graph.hand.slowest
        graph.hand.forget()
        graph.ticks(150)
        forces = {heard.force for heard in graph.hand.motions}
        if len(graph.hand.motions) < 100 or forces - {0.0}:
            raise FaultError(f"{len(graph.hand.motions)} motions under {sorted(forces)} N; each should be under none")
    finally:
        graph.replace_filter()
    graph.recover()
    return Seen([], f"a decision took {slowest:.1f} s")


@row(
    "state/stale",
    "the states come late by 0.3 s, with state_timeout at 0.05",
    "no force, stale state; goes on by itself",
)
def _stale_states(graph: LiveGraph, _: int) -> Seen:
    graph.replace_filter(state_timeout=0.05)
    graph.recover()
    graph.stop("task_sim")
    time.sleep(0.3)
    graph.resume("task_sim")
    graph.ticks(40)
    count = sum(decided.reason is Reason.STALE_STATE for decided in graph.hand.account.decided.values())
    if not count:
        raise FaultError("no decision gave the reason stale_state")
    graph.replace_filter()
    return Seen([], f"{count} ticks")


@row(
    "parameters/changed",
    "a hundred changes at random moments, one in three not allowed",
    "refused or in force; each tick once",
)
def _parameters(graph: LiveGraph, _: int) -> Seen:
    client = AsyncParameterClient(graph.hand, "mig_filter")
    graph.wait(client.services_are_ready, "the filter's parameters are not served")
    graph.hand.forget()
    moments, refused = random.Random(3), 0
    for k in range(100):
        wrong = [
            Parameter("dead_zone", value=-1.0),
            Parameter("threshold", value=math.nan),
            Parameter("contraction", value="much"),
            Parameter("horizon", value=2.0),  # not one that changes in flight
        ]
        good = [Parameter("threshold", value=float(k % 7)), Parameter("dead_zone", value=0.0)]
        bad = k % 3 == 0
        future = client.set_parameters([moments.choice(wrong)] if bad else good)
        graph.wait(future.done, "the filter did not answer a change of its parameters")
        taken = all(result.successful for result in future.result().results)
        if taken == bad:
            raise FaultError(f"change {k} was {'taken' if taken else 'refused'}, and should not have been")
        refused += bad
        graph.ticks(moments.randrange(3))
    expect_every_tick_once(graph)
    return Seen([], f"{refused} refused")
