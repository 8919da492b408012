"""One tick of the filter node, from message to message, beside a bare node that sends back what it gets."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from live import Live
from rows import Row, alternate, percentile

from mig_filter_node.node import MigFilterNode
from rig_runtime import topics
from shared_control import tasks

_TICKS = 500
_PERIOD = 10_000_000  # [ns]


def _inputs() -> list[tuple[bytes, bytes]]:
    """A state and a wrench for each tick: noise pushes, so that about half of it is replaced."""
    task, random = tasks.get("cart_pendulum"), np.random.default_rng(0)
    state, wrench = topics.TASK_STATE.wire(state=task.n, control=task.m), topics.WRENCH.wire()
    found = []
    for tick in range(_TICKS):
        state.stamp = wrench.stamp = (tick + 1) * _PERIOD
        state["tick"] = tick
        state["state"] = random.normal([1.0, 0.2, 0.3, 0.4], 0.1)
        wrench["wrench.force"] = random.normal([0.0, 0.0, 0.0], [20.0, 0.0, 0.0])
        found.append((state.data, wrench.data))
    return found


def _times(make: Callable[[Live], None]) -> list[float]:
    """Times [s] from the wrench's publication to the command's arrival."""
    inputs, times = _inputs(), []
    with Live() as live:
        probe = live.node("probe", "/rig")
        states, wrenches = (probe.create_publisher(t.type, t.name, t.qos) for t in (topics.TASK_STATE, topics.WRENCH))
        done = live.future()
        begun = 0.0

        def send() -> None:
            nonlocal begun
            state, wrench = inputs[len(times)]
            states.publish(state)
            begun = time.perf_counter()
            wrenches.publish(wrench)

        def take(_: bytes) -> None:
            times.append(time.perf_counter() - begun)
            if len(times) < _TICKS:
                send()
            else:
                done.set_result(None)

        command = topics.COMMAND
        answers = probe.create_subscription(command.type, command.name, take, command.qos, raw=True)
        make(live)
        outputs = (states.get_subscription_count, wrenches.get_subscription_count, answers.get_publisher_count)
        live.settle(lambda: all(count() for count in outputs))
        send()
        live.serve(done)
    return times


def _echo(live: Live) -> None:
    node = live.node("echo", "/rig")
    back = node.create_publisher(topics.COMMAND.type, topics.COMMAND.name, topics.COMMAND.qos)
    node.create_subscription(topics.TASK_STATE.type, topics.TASK_STATE.name, _ignore, topics.TASK_STATE.qos)
    node.create_subscription(topics.WRENCH.type, topics.WRENCH.name, back.publish, topics.WRENCH.qos)


def _ignore(_: object) -> None:
    """A state that nobody looks at."""


def rows(runs: int) -> list[Row]:
    """The filter node's tick."""
    node, echo = alternate(
        runs,
        lambda: _times(lambda live: live.make(MigFilterNode, (), "mode:=assistance", "pacing:=lockstep")),
        lambda: _times(_echo),
    )
    what = "wrench out to command in, through the filter node, work included"
    baseline = "a bare rclpy node that sends the message object back"
    return [
        Row(
            *(f"node.tick.{name}", f"{what}, {name}", "us", tuple(1e6 * percentile(times, share) for times in node)),
            *(baseline, tuple(1e6 * percentile(times, share) for times in echo)),
        )
        for name, share in (("p50", 0.5), ("p99", 0.99))
    ]
