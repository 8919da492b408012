"""A short-lived node that looks at the graph, and what a command may ask it.

There is no daemon that has been watching, so each command discovers the graph afresh: it looks until the graph has not
changed for a while, at most for :data:`LIMIT`; a graph in which nobody else has been seen is given all of that time.
The while is :data:`QUIET`, and up to :data:`QUIET_MOST` where the machine is busy, where the nodes turned up one by
one, or where something is known to be missing. ``--spin-time`` replaces this by a fixed time, as in ros2cli without its
daemon.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import NodeNameNonExistentError
from rclpy.parameter import Parameter
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden
from rclpy.validate_full_topic_name import validate_full_topic_name

from ros2_fallback import stopping
from ros2_fallback.command import CommandError, positive_float

__all__ = [
    "LIMIT",
    "NAME_ERRORS",
    "QUIET",
    "QUIET_TOPIC",
    "Graph",
    "NamesAndTypes",
    "absolute_name",
    "add_graph_arguments",
]

#: [s] the graph counts as discovered when it has not changed for so long
QUIET = 0.5
#: [s] likewise for one topic that has been found, whose other publishers may still be missing
QUIET_TOPIC = 0.2
#: [s] and for no longer than that, however busy the machine, and whatever seems to be missing
QUIET_MOST = 2.5
#: so many times the longest pause between two changes must have passed since the last
PAUSES = 2.0
#: [s] and in any case after so long: more than the 3 s after which a participant of Fast DDS announces itself again
LIMIT = 5.0
#: [s] between two looks at the graph
PERIOD = 0.1

_parameter: Any = Parameter  # untyped in rclpy

#: Of an endpoint whose participant is a ROS node's that has not introduced itself yet (rmw_dds_common).
NODE_UNKNOWN = "_NODE_NAME_UNKNOWN_"

#: What rclpy raises for a name of a topic or a service that is none.
NAME_ERRORS = (ValueError, NameValidationException)
NamesAndTypes = list[tuple[str, list[str]]]


def add_graph_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of every verb that looks at the graph."""
    parser.add_argument(
        "--spin-time",
        type=positive_float,
        metavar="S",
        help=f"seconds to wait for discovery (default: until the graph has been quiet, at most {LIMIT} s)",
    )
    parser.add_argument("-s", "--use-sim-time", action="store_true", help="use ROS simulation time")
    parser.add_argument("--no-daemon", action="store_true", help="accepted for compatibility: there is no daemon")


def absolute_name(name: str) -> str:
    """The name with a slash in front."""
    return name if name.startswith("/") else "/" + name


class Graph:
    """A hidden node in its own context, with its executor; use it as a context manager.

    Raises:
        CommandError: on entry, if the node cannot be created.
    """

    def __init__(self, args: argparse.Namespace, node_name: str | None = None) -> None:
        self._spin_time: float | None = getattr(args, "spin_time", None)
        self._use_sim_time: bool = getattr(args, "use_sim_time", False)
        self._node_name = node_name or f"_ros2cli_{os.getpid()}"
        self._context = Context()
        self.node: Any = None  #: of rclpy, there between entry and exit

    def __enter__(self) -> Graph:
        stopping.check()
        try:
            overrides = {"use_sim_time": self._use_sim_time, "start_type_description_service": False}
            # Signals are handled by `stopping`; those of rclpy would shut the context down under our feet.
            rclpy.init(args=[], context=self._context)
            self.node = rclpy.create_node(
                self._node_name,
                context=self._context,
                start_parameter_services=False,
                parameter_overrides=[_parameter(name, value=value) for name, value in overrides.items()],
                automatically_declare_parameters_from_overrides=True,
            )
        except Exception as error:
            self._context.try_shutdown()
            raise CommandError(f"Cannot take part in the ROS graph: {error}") from error
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        self._context.try_shutdown()

    # -- waiting ------------------------------------------------------------------------------------------------------

    def spin_once(self, timeout: float = stopping.SLICE) -> None:
        """Serve at most one callback, waiting for it no longer than `timeout` [s]. Raises Stopped."""
        stopping.check()
        self._executor.spin_once(timeout_sec=min(timeout, stopping.SLICE))
        stopping.check()

    def spin_until(self, done: Callable[[], bool], timeout: float | None = None, period: float = PERIOD) -> bool:
        """Serve callbacks until `done()` or until `timeout` [s] has passed; return whether it is done."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while not done():
            if deadline is not None and time.monotonic() >= deadline:
                return False
            self.spin_once(period)
        return True

    def discover(self, found: Callable[[], bool] | None = None, *, quiet: float = QUIET, extra: float = 0.0) -> bool:
        """Wait until the graph is discovered, and holds what is looked for.

        Args:
            found: whether what is looked for is there; None: nothing in particular.
            quiet: [s] how long the graph must not have changed; zero if only what is looked for matters.
            extra: [s] how much longer than LIMIT to look for it.

        Returns:
            Whether it was found.
        """
        # Time counts only as far as this process gets to look, so that a busy machine is given longer.
        elapsed = changed = pause = 0.0
        last = time.monotonic()
        seen: object = None
        while True:
            now = time.monotonic()
            elapsed += min(now - last, 2.0 * PERIOD)
            last = now
            if self._spin_time is not None:
                there = found is None or found()
                if elapsed >= self._spin_time + (0.0 if there else extra):
                    return there
            else:
                current = self._snapshot()
                if current != seen:
                    pause = max(pause, elapsed - changed)
                    seen, changed = current, elapsed
                there = self._others() if found is None else found()
                if there and elapsed - changed >= self._quiet(quiet, pause):
                    return True
                if elapsed >= LIMIT + (0.0 if there else extra):
                    return found is None or there
            stopping.pause(PERIOD)

    def _snapshot(self) -> object:
        topics = self.node.get_topic_names_and_types()
        return (
            sorted(self.node.get_node_names_and_namespaces()),
            sorted((n, t, self.node.count_publishers(n), self.node.count_subscribers(n)) for n, t in topics),
            sorted(self.node.get_service_names_and_types()),
        )

    def _quiet(self, quiet: float, pause: float) -> float:
        """How long [s] the graph must be quiet that on an idle machine must be so for `quiet`."""
        if quiet == 0.0:
            return 0.0
        if not self._whole():
            return QUIET_MOST
        # Where several want each processor, the nodes too answer so much later.
        crowd = os.getloadavg()[0] / len(os.sched_getaffinity(0))
        return min(max(quiet * max(crowd, 1.0), PAUSES * pause), QUIET_MOST)

    def _whole(self) -> bool:
        """Whether each node has endpoints (it publishes its log at least) and each endpoint a node."""
        nodes = self.node.get_node_names_and_namespaces()
        try:
            if not all(self.node.get_publisher_names_and_types_by_node(*node) for node in nodes):
                return False
        except NodeNameNonExistentError:  # gone meanwhile
            return False
        topics = self.node.get_topic_names_and_types()
        look = (self.node.get_publishers_info_by_topic, self.node.get_subscriptions_info_by_topic)
        return not any(
            endpoint.node_name == NODE_UNKNOWN for topic, _ in topics for ask in look for endpoint in ask(topic)
        )

    def _others(self) -> bool:
        return len(self.node.get_node_names_and_namespaces()) > 1

    # -- questions ----------------------------------------------------------------------------------------------------

    def node_names(self, hidden: bool = False) -> list[str]:
        """Full names of the nodes, sorted; a name that is there twice is listed twice."""
        names = [
            (f"{namespace.rstrip('/')}/{name}", name) for name, namespace in self.node.get_node_names_and_namespaces()
        ]
        return sorted(full for full, name in names if hidden or not name.startswith("_"))

    def wait_for_node(self, name: str, hidden: bool = False, timeout: float = 1.0) -> None:
        """Raises CommandError if no node of that full name turns up within discovery and `timeout` [s] on top."""
        if not self.discover(lambda: name in self.node_names(hidden), quiet=0.0, extra=timeout):
            raise CommandError("Node not found")

    def topics(self, hidden: bool = False) -> NamesAndTypes:
        """Names and types of the topics."""
        return _shown(self.node.get_topic_names_and_types(), hidden)

    def services(self, hidden: bool = False) -> NamesAndTypes:
        """Names and types of the services."""
        return _shown(self.node.get_service_names_and_types(), hidden)

    def topic_name(self, name: str) -> str:
        """The topic's absolute name. Raises CommandError if it is not a name."""
        try:
            full_name: str = expand_topic_name(name, self.node.get_name(), self.node.get_namespace())
            validate_full_topic_name(full_name)
        except NAME_ERRORS as error:
            raise CommandError(str(error)) from None
        return full_name

    def topic_type(self, name: str) -> str | None:
        """The type of a topic, None if nobody knows it. Raises CommandError if there is more than one."""
        types = dict(self.topics(hidden=True)).get(name, [])
        if len(types) > 1:
            raise CommandError(f"Topic '{name}' has more than one type: [{', '.join(types)}]")
        return types[0] if types else None

    def publishers(self, topic: str) -> list[Any]:
        """Who publishes on a topic, as rclpy's TopicEndpointInfo."""
        return list(self.node.get_publishers_info_by_topic(topic))


def _shown(names_and_types: NamesAndTypes, hidden: bool) -> NamesAndTypes:
    return [(name, types) for name, types in names_and_types if hidden or not topic_or_service_is_hidden(name)]
