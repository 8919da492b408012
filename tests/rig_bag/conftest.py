"""What the tests of rig_bag share: a graph on a context and a domain of its own, and messages to put into bags."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future

from mig_interfaces.msg import TaskState, TrialState

_domains = itertools.cycle(range(80, 100))

EPOCH = 1_000_000_000_000
STEP = 10_000_000


class Graph:
    """Nodes of one test on one executor."""

    def __init__(self, kind: str) -> None:
        self.domain = next(_domains)
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=self.domain)
        make = EventsExecutor if kind == "events" else SingleThreadedExecutor
        self.executor = make(context=self.context)
        self._nodes: list[Node] = []
        self.node = self.add(rclpy.create_node("probe", namespace="/rig", context=self.context))

    def add(self, node: Any) -> Any:
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def remove(self, node: Node) -> None:
        self._nodes.remove(node)
        self.executor.remove_node(node)
        node.destroy_node()

    def until(self, condition: Callable[[], bool], limit: float = 30.0) -> None:
        """Serve the nodes until the condition holds; fails after ``limit`` seconds."""
        future = Future(executor=self.executor)

        def look() -> None:
            if condition() and not future.done():
                future.set_result(None)

        timer = self.node.create_timer(0.005, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.executor.spin_until_future_complete(future, timeout_sec=limit)
        self.node.destroy_timer(timer)
        assert future.done(), "the condition did not come true in time"

    def close(self) -> None:
        for node in list(self._nodes):
            self.remove(node)
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)


@pytest.fixture(params=["events", "single"])
def graph(request: pytest.FixtureRequest) -> Iterator[Graph]:
    made = Graph(request.param)
    yield made
    made.close()


@pytest.fixture
def single_graph() -> Iterator[Graph]:
    made = Graph("single")
    yield made
    made.close()


@pytest.fixture
def task_state() -> Callable[[int], TaskState]:
    """Makes the task's state of a tick."""

    def make(tick: int) -> TaskState:
        message = TaskState(tick=tick, time=tick * 0.01, state=[tick + 0.5, -1.0, 2.0, 3.0], control=[tick * 0.25])
        message.header.frame_id = "task"
        _stamp(message, EPOCH + tick * STEP)
        return message

    return make


def _stamp(message: Any, nanoseconds: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)
    return message


@pytest.fixture
def trial_state() -> Callable[..., TrialState]:
    """Makes the state of a trial."""
    return _trial_state


def _trial_state(phase: int, ticks: int = 0, uid: int = 1) -> TrialState:
    message = TrialState(
        uid=uid,
        phase=phase,
        subject="s07",
        group="training",
        set="b",
        trial=3,
        scenario="cart",
        seed=11,
        ticks_published=ticks,
    )
    message.configuration_hash = "ab" * 32
    message.sample_time.nanosec = STEP
    message.epoch.sec, message.epoch.nanosec = divmod(EPOCH, 1_000_000_000)
    return _stamp(message, EPOCH + max(0, ticks - 1) * STEP)
