"""Faults of nodes: stopped, killed, started again, interrupted, reconfigured while they work."""

from __future__ import annotations

import random
from collections.abc import Callable

from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.rows import LIMIT, Inject, Seen, expect_every_tick_once, row

# -- nodes ---------------------------------------------------------------------------------------------------------


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

    def inject(graph: LiveGraph, _: int) -> Seen:
        since = graph.kill(node)
        zero = graph.zero_after(since)
        graph.start(node)
        # What moved before it was killed says nothing of whether it moves again.
        graph.hand.motions.clear()
        graph.recover()
        return Seen([zero])

    return inject


row("filter/stopped", "the filter is stopped (SIGSTOP)", "the robot under no force; goes on by itself", LIMIT)(
    _stopped("mig_filter")
)
row("filter/killed", "the filter is killed (-9) and started again", "the robot under no force until then", LIMIT)(
    _killed("mig_filter")
)
row("task/stopped", "the task is stopped (SIGSTOP)", "no commands, the robot under no force; goes on", LIMIT)(
    _stopped("task_sim")
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


@row("recorder/stopped", "the recorder is stopped (SIGSTOP) for a second", "the loop does not notice")
def _recorder_stopped(graph: LiveGraph, _: int) -> Seen:
    graph.stop("recorder")
    try:
        graph.ticks(100)
    finally:
        graph.resume("recorder")
    expect_every_tick_once(graph)
    return Seen([])


@row("parameters/changed", "fifty changes of live parameters in flight", "every tick is decided once")
def _parameters(graph: LiveGraph, _: int) -> Seen:
    client = AsyncParameterClient(graph.hand, "mig_filter")
    graph.wait(client.services_are_ready, "the filter's parameters are not served")
    for k in range(50):
        values = [Parameter("threshold", value=float(k % 7)), Parameter("dead_zone", value=0.0)]
        future = client.set_parameters(values)
        graph.wait(future.done, "the filter did not answer a change of its parameters")
    expect_every_tick_once(graph)
    return Seen([])


@row("start/interrupted", "SIGINT at a random moment of a node's start, five times", "it ends, and leaves nothing")
def _interrupted_start(graph: LiveGraph, _: int) -> Seen:
    moments = random.Random(7)
    for node in moments.choices(["task_sim", "mig_filter", "admittance_sim"], k=5):
        process = graph.start_elsewhere(node)
        graph.ticks(moments.randrange(1, 200))
        process.stop()
        if left := process.left():
            raise FaultError(f"{node} has left processes behind: {left}")
    return Seen([])


# The last: there is no recorder after it.
@row("recorder/killed", "the recorder is killed (-9)", "the loop does not notice; the bag can be repaired")
def _recorder_killed(graph: LiveGraph, _: int) -> Seen:
    graph.kill("recorder")
    graph.ticks(100)
    expect_every_tick_once(graph)
    return Seen([], graph.repair())
