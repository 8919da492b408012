"""A display node on a graph of its own, a pacemaker made of messages, and pages without a browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from loop_messages import state
from page_client import Web

from rig_display.node import DisplayNode
from rig_runtime import topics


@pytest.fixture
def web() -> Iterator[Web]:
    """Pages."""
    with Web() as made:
        yield made


class Bench:
    """A display node, and the topics on both of its sides."""

    def __init__(self, graph: Any, *parameters: str) -> None:
        self.graph = graph
        self.until = graph.until
        # A machine that stalls must not look like a hand that has fallen silent, unless a test says so.
        self.node = graph.make(DisplayNode, "port:=0", "stale_after:=5.0", *parameters)
        self.states = graph.publisher(topics.TASK_STATE)
        self.decisions = graph.publisher(topics.DECISION)
        self.trials = graph.publisher(topics.TRIAL_STATE)
        self.wrenches: list[WrenchStamped] = graph.collect(topics.WRENCH)
        self._tick = -1
        graph.until(lambda: self.states.get_subscription_count() >= 1 and self.trials.get_subscription_count() >= 1)
        graph.until(lambda: all(self.node.make_report().matched_subscriptions))

    def tick(self) -> WrenchStamped:
        """One more tick: publish its state and return the wrench that answers it."""
        self._tick += 1
        message = state(self._tick)
        self.states.publish(message)
        self.until(lambda: bool(self.wrenches) and self.wrenches[-1].header.stamp == message.header.stamp)
        return self.wrenches[-1]

    def until_force(self, x: float, z: float = 0.0) -> None:
        """Tick until the wrench is this one."""
        for _ in range(3000):
            force = self.tick().wrench.force
            if (force.x, force.y, force.z) == (x, 0.0, z):
                return
        pytest.fail(f"the force did not become {x}, {z}; it is zero because: {self.reason!r}")

    @property
    def reason(self) -> str:
        """Why the hand pushes nothing."""
        return self.node.seat.status(2**62)["hand"]["reason"]


@pytest.fixture
def bench(single_graph: Any) -> Callable[..., Bench]:
    """Makes a bench with ROS parameters."""
    return lambda *parameters: Bench(single_graph, *parameters)
