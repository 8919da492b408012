"""``ros2 topic hz`` and ``bw``: how often a topic is published and how much it takes.

Messages are taken as bytes, and the time of a message is when the middleware received it, not when this process got
round to it: a busy machine delays the process more than the middleware. The queue holds seconds' worth of messages, and
the topic is subscribed to as reliably as it is published, so that none is missed.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from ros2_fallback import qos
from ros2_fallback.command import Outcome, positive_int
from ros2_fallback.filter_expression import message_test
from ros2_fallback.graph import QUIET_TOPIC, Graph, add_graph_arguments
from ros2_fallback.message_types import message_class

__all__ = ["Bandwidth", "Rate", "bandwidth", "bandwidth_arguments", "rate", "rate_arguments"]

RATE_WINDOW = 10000
BANDWIDTH_WINDOW = 100
#: messages that may wait to be counted
DEPTH = 500
#: [ns] between two reports
REPORT_PERIOD = 1_000_000_000


class Rate:
    """Statistics of the intervals between messages.

    Args:
        window: how many intervals are taken into account.
    """

    def __init__(self, window: int) -> None:
        self._intervals: deque[int] = deque(maxlen=window)
        self._last: int | None = None
        self._reported: int | None = None

    def add(self, stamp: int) -> None:
        """Count a message that came at `stamp` [ns]; a clock that went back starts afresh."""
        if self._last is not None and stamp < self._last:
            self._intervals.clear()
            self._reported = None
        elif self._last is not None:
            self._intervals.append(stamp - self._last)
        self._last = stamp

    def report(self) -> str | None:
        """The statistics as text; None within a second of the last report and before the first second is over."""
        if self._last is None or not self._intervals:
            return None
        if self._reported is None:
            self._reported = self._last
        if self._last < self._reported + REPORT_PERIOD:
            return None
        self._reported = self._last
        count = len(self._intervals)
        mean = sum(self._intervals) / count
        deviation = math.sqrt(sum((interval - mean) ** 2 for interval in self._intervals) / count)
        rate = 1e9 / mean if mean > 0.0 else 0.0
        return (
            f"average rate: {rate:.3f}\n"
            f"\tmin: {min(self._intervals) * 1e-9:.3f}s max: {max(self._intervals) * 1e-9:.3f}s "
            f"std dev: {deviation * 1e-9:.5f}s window: {count}"
        )


class Bandwidth:
    """Bytes a second over the last messages.

    Args:
        window: how many messages are taken into account.
    """

    def __init__(self, window: int) -> None:
        self._messages: deque[tuple[int, int]] = deque(maxlen=window)

    def add(self, stamp: int, size: int) -> None:
        """Count a message of `size` bytes that came at `stamp` [ns]."""
        self._messages.append((stamp, size))

    def report(self, now: int) -> str | None:
        """The statistics at `now` [ns] as text; None before two messages have come."""
        if len(self._messages) < 2 or now <= self._messages[0][0]:
            return None
        sizes = [size for _, size in self._messages]
        each_second = sum(sizes) / ((now - self._messages[0][0]) * 1e-9)
        show = _in_unit_of(each_second)
        return (
            f"{show(each_second)}/s from {len(sizes)} messages\n"
            f"\tMessage size mean: {show(sum(sizes) / len(sizes))} min: {show(min(sizes))} max: {show(max(sizes))}"
        )


def _in_unit_of(value: float) -> Callable[[float], str]:
    """How to show sizes [bytes] in the unit that suits `value`."""
    if value < 1e3:
        return lambda size: f"{size:.0f} B"
    if value < 1e6:
        return lambda size: f"{size / 1e3:.2f} KB"
    return lambda size: f"{size / 1e6:.2f} MB"


def rate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``hz``."""
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument(
        "-w",
        "--window",
        type=positive_int,
        default=RATE_WINDOW,
        metavar="N",
        help=f"number of messages to take into account (default: {RATE_WINDOW})",
    )
    parser.add_argument(
        "--filter",
        dest="filter_expr",
        metavar="EXPR",
        help="count only messages m for which this is true, as for `topic echo`",
    )
    parser.add_argument("--wall-time", action="store_true", help="measure in wall time even with --use-sim-time")


def rate(args: argparse.Namespace) -> Outcome:
    """Print the rate of a topic once a second, until told to stop."""
    accept = message_test(args.filter_expr)
    statistics = Rate(args.window)
    simulated = args.use_sim_time and not args.wall_time

    with Graph(args) as graph:

        def receive(message: Any, info: dict[str, Any]) -> None:
            if accept(message):
                statistics.add(graph.node.get_clock().now().nanoseconds if simulated else _received(info))

        _subscribe(graph, args.topic_name, receive, raw=args.filter_expr is None)
        while True:
            graph.spin_once()
            text = statistics.report()
            if text is not None:
                print(text)


def bandwidth_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bw``."""
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument(
        "-w",
        "--window",
        type=positive_int,
        default=BANDWIDTH_WINDOW,
        metavar="N",
        help=f"number of messages to take into account (default: {BANDWIDTH_WINDOW})",
    )


def bandwidth(args: argparse.Namespace) -> Outcome:
    """Print the bandwidth of a topic once a second, until told to stop."""
    statistics = Bandwidth(args.window)
    with Graph(args) as graph:
        _subscribe(
            graph,
            args.topic_name,
            lambda message, info: statistics.add(_received(info), len(message)),
            raw=True,
        )
        print(f"Subscribed to [{args.topic_name}]")
        due = time.monotonic_ns() + REPORT_PERIOD
        while True:
            graph.spin_once()
            if time.monotonic_ns() >= due:
                due += REPORT_PERIOD
                text = statistics.report(time.time_ns())
                if text is not None:
                    print(text)


def _received(info: dict[str, Any]) -> int:
    """[ns] when the middleware received the message; now, for a middleware that does not say."""
    return int(info["received_timestamp"]) or time.time_ns()


def _subscribe(graph: Graph, name: str, receive: Callable[[Any, dict[str, Any]], None], raw: bool) -> None:
    """Subscribe to a topic as soon as somebody publishes it."""
    topic = graph.topic_name(name)

    def is_published() -> bool:
        return bool(graph.publishers(topic)) and graph.topic_type(topic) is not None

    if not graph.discover(is_published, quiet=QUIET_TOPIC):
        print(f"WARNING: topic [{name}] does not appear to be published yet")
        graph.spin_until(is_published)
    message_type = message_class(graph.topic_type(topic) or "")
    profile = qos.matching_profile(graph.publishers(topic), depth=DEPTH)
    graph.node.create_subscription(message_type, topic, receive, profile, raw=raw)
