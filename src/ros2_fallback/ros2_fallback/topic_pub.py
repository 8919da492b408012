"""``ros2 topic pub``: publish messages given as YAML."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.publisher import Publisher

from ros2_fallback import qos, stopping
from ros2_fallback.command import Outcome, non_negative_int, positive_float
from ros2_fallback.graph import NAME_ERRORS, Graph, add_graph_arguments
from ros2_fallback.message_text import fill_from_yaml
from ros2_fallback.message_types import message_class

__all__ = ["arguments", "run"]

#: [s] How long readers may take to say that they have what was published.
_ACKNOWLEDGEMENT = 5.0


def arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument("message_type", help="its type (e.g. 'std_msgs/msg/String')")
    values = parser.add_mutually_exclusive_group()
    values.add_argument(
        "values",
        nargs="?",
        default="{}",
        help="the message as YAML (e.g. 'data: hello'); a header may be 'auto' and a time 'now'",
    )
    values.add_argument("--stdin", action="store_true", help="read the message from stdin")
    parser.add_argument(
        "-r", "--rate", type=positive_float, default=1.0, metavar="HZ", help="rate to publish at (default: 1)"
    )
    parser.add_argument(
        "-p", "--print", type=non_negative_int, default=1, metavar="N", help="show every Nth message (default: 1)"
    )
    number = parser.add_mutually_exclusive_group()
    number.add_argument("-1", "--once", action="store_true", help="publish one message and stop")
    number.add_argument(
        "-t", "--times", type=non_negative_int, default=0, metavar="N", help="publish so many messages and stop"
    )
    parser.add_argument(
        "-w",
        "--wait-matching-subscriptions",
        type=non_negative_int,
        metavar="N",
        help="wait for so many subscriptions first (default: 1 with --once and --times, else 0)",
    )
    parser.add_argument(
        "--max-wait-time-secs", type=positive_float, metavar="S", help="give up waiting after so long (default: never)"
    )
    parser.add_argument(
        "--keep-alive",
        type=positive_float,
        default=0.1,
        metavar="S",
        help="stay so long after the last message, for it to leave (default: 0.1)",
    )
    parser.add_argument("-n", "--node-name", help="name of the node that publishes")
    qos.add_qos_arguments(parser, "default")


def run(args: argparse.Namespace) -> Outcome:
    """Publish as often as asked."""
    times = 1 if args.once else args.times
    wanted = args.wait_matching_subscriptions
    if wanted is None:
        wanted = 1 if times else 0
    if wanted == 0 and args.max_wait_time_secs is not None:
        return "--max-wait-time-secs needs --wait-matching-subscriptions, --once or --times"
    message = message_class(args.message_type)()
    values = args.values
    if args.stdin:
        with stopping.immediate():
            values = sys.stdin.buffer.read()
    stamp_setters = fill_from_yaml(message, values, stamps=True)

    with Graph(args, node_name=args.node_name) as graph:
        try:
            publisher = graph.node.create_publisher(type(message), args.topic_name, qos.profile_from_arguments(args))
        except NAME_ERRORS as error:
            return str(error)
        if not _wait_for_subscriptions(graph, publisher.get_subscription_count, wanted, args.max_wait_time_secs):
            return (
                f"Timed out waiting for subscribers: Expected {wanted} subscribers "
                f"but only got {publisher.get_subscription_count()} subscribers"
            )
        print("publisher: beginning loop")
        count = 0

        def publish() -> None:
            nonlocal count
            if times and count >= times:
                return
            now = graph.node.get_clock().now().to_msg()
            for set_stamp in stamp_setters:
                set_stamp(now)
            count += 1
            if args.print and count % args.print == 0:
                print(f"publishing #{count}: {message!r}\n")
            publisher.publish(message)

        publish()
        if times != 1:
            # A clock that nobody steps, unless time itself is simulated.
            clock = graph.node.get_clock() if args.use_sim_time else Clock(clock_type=ClockType.STEADY_TIME)
            graph.node.create_timer(1.0 / args.rate, publish, clock=clock)
            graph.spin_until(lambda: bool(times) and count >= times, period=stopping.SLICE)
        if times:
            _wait_for_acknowledgement(publisher)
        graph.spin_until(lambda: False, timeout=args.keep_alive)
    return None


def _wait_for_acknowledgement(publisher: Publisher[Any]) -> None:
    """Wait until reliable readers have what was published; one that has not found this writer yet would get nothing."""
    limit = time.monotonic() + _ACKNOWLEDGEMENT
    while time.monotonic() < limit and not publisher.wait_for_all_acked(Duration(seconds=stopping.SLICE)):
        stopping.check()


def _wait_for_subscriptions(graph: Graph, count: Callable[[], int], wanted: int, limit: float | None) -> bool:
    """Wait until as many subscriptions are matched, saying so once a second; return whether they are."""
    start = time.monotonic()
    while count() < wanted:
        left = 1.0 if limit is None else min(1.0, start + limit - time.monotonic())
        if left <= 0.0:
            return False
        print(f"Waiting for at least {wanted} matching subscription(s)...")
        graph.spin_until(lambda: count() >= wanted, timeout=left)
    return True
