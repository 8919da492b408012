"""``ros2 topic``: list and describe topics. Reading and writing them is in the modules ``topic_*``."""

from __future__ import annotations

import argparse

from ros2_fallback import topic_echo, topic_pub, topic_rate
from ros2_fallback.command import Outcome, Verb
from ros2_fallback.graph import Graph, add_graph_arguments

__all__ = ["VERBS", "arguments"]


def arguments(parser: argparse.ArgumentParser) -> None:
    """The argument that may stand before the verb."""
    parser.add_argument("--include-hidden-topics", action="store_true", help="consider hidden topics too")


def _hidden_argument(parser: argparse.ArgumentParser) -> None:
    # Not set again when it is not given here: it may have been given before the verb.
    parser.add_argument(
        "--include-hidden-topics", action="store_true", default=argparse.SUPPRESS, help="consider hidden topics too"
    )


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    _hidden_argument(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="show the types too")
    parser.add_argument("-c", "--count-topics", action="store_true", help="show only how many there are")
    parser.add_argument("-v", "--verbose", action="store_true", help="show how many publish and subscribe")


def _list(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        graph.discover()
        topics = graph.topics(args.include_hidden_topics)
        counts = {n: (graph.node.count_publishers(n), graph.node.count_subscribers(n)) for n, _ in topics}
    if args.count_topics:
        print(len(topics))
    elif args.verbose and topics:
        for title, noun, side in (("Published", "publisher", 0), ("Subscribed", "subscriber", 1)):
            print(f"{title} topics:")
            for name, types in topics:
                count = counts[name][side]
                if count:
                    print(f" * {name} [{', '.join(types)}] {count} {noun}{'s' if count > 1 else ''}")
            print()
    else:
        for name, types in topics:
            print(f"{name} [{', '.join(types)}]" if args.show_types else name)
    return None


def _info_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument("-v", "--verbose", action="store_true", help="show each endpoint with its quality of service")


def _info(args: argparse.Namespace) -> Outcome:
    end = "\n\n" if args.verbose else "\n"
    with Graph(args) as graph:
        name = graph.topic_name(args.topic_name)
        graph.discover(lambda: name in dict(graph.topics(hidden=True)))
        types = dict(graph.topics(hidden=True)).get(name)
        if types is None:
            return f"Unknown topic '{args.topic_name}'"
        publishers = graph.publishers(name)
        subscriptions = graph.node.get_subscriptions_info_by_topic(name)
    print(f"Type: {types[0] if len(types) == 1 else types}", end=end)
    for title, endpoints in (("Publisher", publishers), ("Subscription", subscriptions)):
        print(f"{title} count: {len(endpoints)}", end=end)
        if args.verbose:
            for endpoint in endpoints:
                print(endpoint, end=end)
    return None


def _type_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    _hidden_argument(parser)
    parser.add_argument("topic_name", help="name of the topic")


def _type(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        name = graph.topic_name(args.topic_name)
        graph.discover(lambda: name in dict(graph.topics(hidden=True)), quiet=0.0)
        types = dict(graph.topics(args.include_hidden_topics)).get(name, [])
    for line in types:
        print(line)
    return 0 if types else 1


def _find_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    _hidden_argument(parser)
    parser.add_argument("topic_type", help="type to look for (e.g. 'std_msgs/msg/String')")
    parser.add_argument("-c", "--count-topics", action="store_true", help="show only how many there are")


def _find(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        graph.discover()
        names = [name for name, types in graph.topics(args.include_hidden_topics) if args.topic_type in types]
    for line in [len(names)] if args.count_topics else names:
        print(line)
    return None


VERBS = {
    "bw": Verb("Show the bandwidth that a topic takes", topic_rate.bandwidth, topic_rate.bandwidth_arguments),
    "echo": Verb("Show the messages of a topic", topic_echo.run, topic_echo.arguments),
    "find": Verb("List the topics of a type", _find, _find_arguments),
    "hz": Verb("Show the rate at which a topic is published", topic_rate.rate, topic_rate.rate_arguments),
    "info": Verb("Show a topic's type and who publishes and subscribes", _info, _info_arguments),
    "list": Verb("List the topics", _list, _list_arguments),
    "pub": Verb("Publish messages on a topic", topic_pub.run, topic_pub.arguments),
    "type": Verb("Show a topic's type", _type, _type_arguments),
}
