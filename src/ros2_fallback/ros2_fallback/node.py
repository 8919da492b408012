"""``ros2 node``: who is in the graph."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from rclpy.action.graph import (
    get_action_client_names_and_types_by_node,
    get_action_server_names_and_types_by_node,
)
from rclpy.node import Node

from ros2_fallback.command import CommandError, Outcome, Verb
from ros2_fallback.graph import Graph, NamesAndTypes, absolute_name, add_graph_arguments

__all__ = ["VERBS"]

#: What a node has, in the order in which it is shown.
_SECTIONS: dict[str, Callable[[Node, str, str], NamesAndTypes]] = {
    "Subscribers": Node.get_subscriber_names_and_types_by_node,
    "Publishers": Node.get_publisher_names_and_types_by_node,
    "Service Servers": Node.get_service_names_and_types_by_node,
    "Service Clients": Node.get_client_names_and_types_by_node,
    "Action Servers": get_action_server_names_and_types_by_node,
    "Action Clients": get_action_client_names_and_types_by_node,
}


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("-a", "--all", action="store_true", help="show hidden nodes too")
    parser.add_argument("-c", "--count-nodes", action="store_true", help="show only how many there are")


def _list(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        graph.discover()
        names = graph.node_names(hidden=args.all)
    if args.count_nodes:
        print(len(names))
        return None
    if len(set(names)) < len(names):
        print(
            "WARNING: Be aware that there are nodes in the graph that share an exact name, "
            "which can have unintended side effects.",
            file=sys.stderr,
        )
    for name in names:
        print(name)
    return None


def _info_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("node_name", help="full name of the node")
    parser.add_argument("--include-hidden", action="store_true", help="show hidden topics, services and actions too")


def _info(args: argparse.Namespace) -> Outcome:
    full_name = absolute_name(args.node_name)
    namespace, name = full_name.rsplit("/", 1)
    with Graph(args) as graph:
        if not graph.discover(lambda: full_name in graph.node_names(hidden=True)):
            return f"Unable to find node '{args.node_name}'"
        count = graph.node_names(hidden=True).count(full_name)
        if count > 1:
            print(
                f'There are {count} nodes in the graph with the exact name "{full_name}". '
                "You are seeing information about only one of them.",
                file=sys.stderr,
            )
        print(full_name)
        for title, names_and_types in _SECTIONS.items():
            print(f"  {title}:")
            try:
                found = names_and_types(graph.node, name, namespace or "/")
            except Exception as error:  # it has gone, or its details have not arrived
                raise CommandError(f"Unable to ask about node '{full_name}': {error}") from error
            lines = [
                f"    {entry}: {', '.join(types)}"
                for entry, types in found
                if args.include_hidden or not _is_hidden(entry)
            ]
            print("\n".join(lines))
    return None


def _is_hidden(name: str) -> bool:
    return any(part.startswith("_") for part in name.split("/"))


VERBS = {
    "info": Verb("Show what a node publishes, subscribes to and serves", _info, _info_arguments),
    "list": Verb("List the nodes", _list, _list_arguments),
}
