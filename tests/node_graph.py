"""A graph of nodes on one executor, with a context and a domain of its own: what tests of nodes are made of."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.task import Future

from rig_runtime.run import make_executor

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

#: Another one for each graph, and another row of them for each run of the tests on this machine.
_domains = itertools.cycle(range(1 + 20 * (os.getpid() % 3), 20 + 20 * (os.getpid() % 3)))


class Said(NamedTuple):
    """What a node has said in `/diagnostics`."""

    level: bytes
    message: str
    values: dict[str, str]


class Graph:
    """Nodes of one test on one executor."""

    def __init__(self, kind: str) -> None:
        self.domain = next(_domains)
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=self.domain)
        self.executor = make_executor(self.context, kind)
        self._nodes: list[Node] = []
        self.node = self.add(rclpy.create_node("probe", namespace="/rig", context=self.context))

    def add(self, node: Any) -> Any:
        """Serve a node with the others."""
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def make(self, factory: Callable[..., Any], *parameters: str, params_file: Path | None = None) -> Any:
        """Make a node of the rig in this graph, with ROS parameters as `name:=value` or from a file."""
        arguments = ["--ros-args", "-r", "__ns:=/rig"]
        if params_file is not None:
            arguments += ["--params-file", str(params_file)]
        for parameter in parameters:
            arguments += ["-p", parameter]
        node = factory(context=self.context, cli_args=arguments, use_global_arguments=False)
        if hasattr(node, "prepare"):
            node.prepare()
        return self.add(node)

    def remove(self, node: Node) -> None:
        """Stop serving a node and destroy it."""
        self._nodes.remove(node)
        self.executor.remove_node(node)
        node.destroy_node()

    def until(self, condition: Callable[[], bool], limit: float = 60.0) -> None:
        """Serve the nodes until the condition holds; fails after `limit` seconds."""
        future: Future[None] = Future(executor=self.executor)

        def look() -> None:
            if condition() and not future.done():
                future.set_result(None)

        timer = self.node.create_timer(0.005, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.executor.spin_until_future_complete(future, timeout_sec=limit)
        self.node.destroy_timer(timer)
        assert future.done(), "the condition did not come true in time"

    def collect(self, topic: Any) -> list[Any]:
        """A list that fills with the messages of a topic of the loop, in the order of their arrival."""
        messages: list[Any] = []
        self.node.create_subscription(topic.type, topic.name, messages.append, topic.qos)
        return messages

    def diagnostics(self, name: str) -> list[Said]:
        """A list that fills with what the node of this name says in `/diagnostics`."""
        said: list[Said] = []

        def take(array: DiagnosticArray) -> None:
            for status in array.status:
                if status.name == f"/rig/{name}":
                    said.append(Said(status.level, status.message, {pair.key: pair.value for pair in status.values}))

        self.node.create_subscription(DiagnosticArray, "/diagnostics", take, 100)
        return said

    def publisher(self, topic: Any) -> Any:
        """A publisher on a topic of the loop."""
        return self.node.create_publisher(topic.type, topic.name, topic.qos)

    def call(self, service: Any, name: str, request: Any) -> Any:
        """Call a service of the graph and return its response."""
        client = self.node.create_client(service, name)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def close(self) -> None:
        """Destroy everything."""
        for node in list(self._nodes):
            self.remove(node)
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)
