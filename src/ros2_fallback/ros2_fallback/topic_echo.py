"""``ros2 topic echo``: show the messages of a topic as YAML, CSV or bytes."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable
from typing import Any

import yaml
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError

from ros2_fallback import qos
from ros2_fallback.command import CommandError, Outcome, non_negative_int, positive_float
from ros2_fallback.filter_expression import FUNCTIONS, message_test
from ros2_fallback.graph import QUIET_TOPIC, Graph, add_graph_arguments
from ros2_fallback.message_text import to_csv, to_yaml
from ros2_fallback.message_types import message_class

__all__ = ["arguments", "run"]

#: elements of arrays and characters of strings that are shown
TRUNCATE_LENGTH = 128
#: messages that may wait to be printed: a second's worth of a topic at 100 Hz
DEPTH = 100

_STEP = re.compile(r"(?P<name>[A-Za-z]\w*)(?P<indices>(?:\[-?\d+\])*)")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument("message_type", nargs="?", help="its type (default: as discovered)")
    qos.add_qos_arguments(parser, "sensor_data")
    parser.add_argument("--csv", action="store_true", help="all fields in one line, separated by commas")
    parser.add_argument("--field", help="show only this field (e.g. 'pose.position' or 'state[0]')")
    parser.add_argument("-f", "--full-length", action="store_true", help="show arrays, bytes and strings in full")
    parser.add_argument(
        "-l",
        "--truncate-length",
        type=non_negative_int,
        default=TRUNCATE_LENGTH,
        metavar="N",
        help=f"show no more than this of arrays, bytes and strings (default: {TRUNCATE_LENGTH})",
    )
    parser.add_argument("--no-arr", action="store_true", help="do not show what is in arrays")
    parser.add_argument("--no-str", action="store_true", help="do not show what is in strings")
    parser.add_argument("--flow-style", action="store_true", help="show lists on one line, in brackets")
    parser.add_argument("--no-lost-messages", action="store_true", help="do not report lost messages")
    parser.add_argument("--raw", action="store_true", help="show the serialised bytes")
    parser.add_argument(
        "--filter",
        dest="filter_expr",
        metavar="EXPR",
        help="show only messages m for which this is true, as in 'm.tick > 5 and abs(m.wrench.force.x) < 2': fields, "
        f"indices, numbers, texts, arithmetic, comparisons, and {', '.join(FUNCTIONS)}; nothing else is run",
    )
    parser.add_argument("--once", action="store_true", help="stop after the first message")
    parser.add_argument("--timeout", type=positive_float, metavar="S", help="stop after so many seconds")
    parser.add_argument("-i", "--include-message-info", action="store_true", help="show time stamps and numbers too")


def run(args: argparse.Namespace) -> Outcome:
    """Subscribe and print until told to stop."""
    select = _selector(args.field)
    accept = message_test(args.filter_expr)
    finished = False

    def receive(message: Any, info: dict[str, Any]) -> None:
        nonlocal finished
        # What has queued up behind the one that was asked for is not shown.
        if finished:
            return
        value = select(message)
        if accept(value):
            _show(value, info, args)
            finished = args.once

    with Graph(args) as graph:
        topic = graph.topic_name(args.topic_name)
        # Not only somebody who listens: what is subscribed without its publishers in sight asks for too little of them,
        # and never gets what they have kept for late comers.
        graph.discover(lambda: bool(graph.publishers(topic)), quiet=QUIET_TOPIC)
        if args.message_type is None:
            name = graph.topic_type(topic)
            if name is None:
                print(f"WARNING: topic [{args.topic_name}] does not appear to be published yet")
                return "Could not determine the type for the passed topic"
            message_type = message_class(name)
        else:
            message_type = message_class(args.message_type)
        if qos.is_given(args):
            profile = qos.profile_from_arguments(args)
        else:
            profile = qos.matching_profile(graph.publishers(topic), args.qos_profile, DEPTH)
        _subscribe(graph, message_type, topic, receive, profile, args)
        deadline = None if args.timeout is None else time.monotonic() + args.timeout
        while not finished and (deadline is None or time.monotonic() < deadline):
            graph.spin_once()
    return None


def _subscribe(
    graph: Graph,
    message_type: Any,
    topic: str,
    receive: Callable[[Any, dict[str, Any]], None],
    profile: Any,
    args: argparse.Namespace,
) -> None:
    reports = None if args.no_lost_messages else SubscriptionEventCallbacks(message_lost=_report_lost)
    try:
        graph.node.create_subscription(message_type, topic, receive, profile, event_callbacks=reports, raw=args.raw)
    except UnsupportedEventTypeError:
        graph.node.create_subscription(message_type, topic, receive, profile, raw=args.raw)


def _report_lost(status: Any) -> None:
    print(
        f"A message was lost!!!\n\ttotal count change:{status.total_count_change}\n\ttotal count: {status.total_count}",
        end="---\n",
    )


def _selector(field: str | None) -> Callable[[Any], Any]:
    """What takes the wanted field out of a message."""
    if field is None:
        return lambda message: message
    steps: list[str | int] = []
    for part in filter(None, field.split(".")):
        match = _STEP.fullmatch(part)
        if match is None:
            raise CommandError(f"Invalid field value '{field}'")
        steps.append(match["name"])
        steps += [int(index) for index in re.findall(r"-?\d+", match["indices"])]
    if not steps:
        raise CommandError(f"Invalid field value '{field}'")

    def select(message: Any) -> Any:
        value = message
        try:
            for step in steps:
                value = value[step] if isinstance(step, int) else getattr(value, step)
        except (AttributeError, IndexError, TypeError) as error:
            raise CommandError(f"Invalid field '{field}': {error}") from None
        return value

    return select


def _show(value: Any, info: dict[str, Any], args: argparse.Namespace) -> None:
    length = None if args.full_length else args.truncate_length
    if not hasattr(value, "SLOT_TYPES"):  # bytes, a number, an array: no message
        if args.include_message_info:
            print(f"---Got new message, message info:---\n{info}\n---Message data:---")
        print(value, end="\n---\n")
    elif args.csv:
        text = to_csv(value, truncate_length=length, no_arr=args.no_arr, no_str=args.no_str)
        print(",".join([*map(str, info.values()), text]) if args.include_message_info else text)
    else:
        head = f"{yaml.dump(info)}---\n" if args.include_message_info else ""
        text = to_yaml(
            value, truncate_length=length, no_arr=args.no_arr, no_str=args.no_str, flow_style=args.flow_style
        )
        print(f"{head}{text}", end="---\n")
