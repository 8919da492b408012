"""Faults of time: commands that come, and each of them late."""

from __future__ import annotations

import time
from collections import deque

from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.rows import LIMIT, Seen, row
from rig_runtime import topics

#: [s] By how much, and how often what is due is passed on.
_DELAY, _OFTEN = 0.3, 1e-3

#: Where the filter speaks to this instead of to the robot.
_HERE = "late/command"


class Relay:
    """Passes the filter's commands on to the robot, after a delay. Context manager."""

    def __init__(self, graph: LiveGraph) -> None:
        self._graph, self._waiting = graph, deque[tuple[float, bytes]]()
        self._over = False
        #: [s]
        self.delay = 0.0

    def __enter__(self) -> Relay:
        hand, topic = self._graph.hand, topics.COMMAND
        self._out = hand.create_publisher(topic.type, topic.name, topic.qos)
        self._in = hand.create_subscription(topic.type, _HERE, self._take, topic.qos, raw=True)
        self._timer = hand.create_timer(_OFTEN, self._pass_on, clock=hand.steady)
        return self

    def __exit__(self, *_: object) -> None:
        hand, self._over = self._graph.hand, True
        hand.destroy_timer(self._timer)
        hand.destroy_subscription(self._in)
        hand.destroy_publisher(self._out)

    def _take(self, data: bytes) -> None:
        # What was received before the end may be handed over after it.
        if not self._over:
            self._waiting.append((time.monotonic(), data))
            self._pass_on()

    def _pass_on(self) -> None:
        while self._waiting and time.monotonic() - self._waiting[0][0] >= self.delay:
            self._out.publish(self._waiting.popleft()[1])


@row("command/late", "the commands come to the robot late by 0.3 s, one after another", "no force; goes on", LIMIT)
def _late_commands(graph: LiveGraph, repeats: int) -> Seen:
    zero = []
    with Relay(graph) as relay:
        graph.replace_filter(remap={topics.COMMAND.name: _HERE})
        try:
            for _ in range(repeats):
                graph.recover()
                since, relay.delay = time.monotonic(), _DELAY
                zero.append(graph.zero_after(since))
                graph.hand.motions.clear()
                # Long after the first of them has come, and the robot has gone past its tick.
                graph.ticks(round(3 * _DELAY / 0.01))
                if through := {heard.force for heard in graph.hand.motions} - {0.0}:
                    raise FaultError(f"the robot followed commands that were late: {sorted(through)} N")
                relay.delay = 0.0
        finally:
            graph.replace_filter()
    graph.recover()
    return Seen(zero)
