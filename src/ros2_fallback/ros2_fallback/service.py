"""``ros2 service``: list and call services."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

from ros2_fallback import stopping
from ros2_fallback.command import CommandError, Outcome, Verb, positive_float
from ros2_fallback.graph import LIMIT, NAME_ERRORS, Graph, add_graph_arguments
from ros2_fallback.message_text import fill_from_yaml
from ros2_fallback.message_types import service_class

__all__ = ["VERBS", "arguments"]


def arguments(parser: argparse.ArgumentParser) -> None:
    """The argument that may stand before the verb."""
    parser.add_argument("--include-hidden-services", action="store_true", help="consider hidden services too")


def _hidden_argument(parser: argparse.ArgumentParser) -> None:
    # Not set again when it is not given here: it may have been given before the verb.
    parser.add_argument(
        "--include-hidden-services",
        action="store_true",
        default=argparse.SUPPRESS,
        help="consider hidden services too",
    )


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    _hidden_argument(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="show the types too")
    parser.add_argument("-c", "--count-services", action="store_true", help="show only how many there are")


def _list(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        graph.discover()
        services = graph.services(args.include_hidden_services)
    if args.count_services:
        print(len(services))
        return None
    for name, types in services:
        print(f"{name} [{', '.join(types)}]" if args.show_types else name)
    return None


def _name_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    _hidden_argument(parser)
    parser.add_argument("service_name", help="name of the service")


def _type(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        graph.discover(lambda: args.service_name in dict(graph.services(hidden=True)), quiet=0.0)
        types = dict(graph.services(args.include_hidden_services)).get(args.service_name, [])
    for name in types:
        print(name)
    return 0 if types else 1


def _info(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        graph.discover(lambda: args.service_name in dict(graph.services(hidden=True)))
        types = dict(graph.services(args.include_hidden_services)).get(args.service_name)
        if types is None:
            return f"Unknown service '{args.service_name}'"
        print(f"Type: {types[0] if len(types) == 1 else types}")
        print(f"Clients count: {graph.node.count_clients(args.service_name)}")
        print(f"Services count: {graph.node.count_services(args.service_name)}")
    return None


def _find_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    _hidden_argument(parser)
    parser.add_argument("service_type", help="type to look for (e.g. 'std_srvs/srv/Trigger')")
    parser.add_argument("-c", "--count-services", action="store_true", help="show only how many there are")


def _find(args: argparse.Namespace) -> Outcome:
    with Graph(args) as graph:
        graph.discover()
        names = [name for name, types in graph.services(args.include_hidden_services) if args.service_type in types]
    for line in [len(names)] if args.count_services else names:
        print(line)
    return None


def _call_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("service_name", help="name of the service")
    parser.add_argument("service_type", help="type of the service (e.g. 'std_srvs/srv/SetBool')")
    group = parser.add_mutually_exclusive_group()
    group.add_argument("values", nargs="?", default="{}", help="the request as YAML (e.g. 'data: true')")
    group.add_argument("--stdin", action="store_true", help="read the request from stdin")
    parser.add_argument("-r", "--rate", type=positive_float, metavar="HZ", help="repeat the call at this rate")


def _call(args: argparse.Namespace) -> Outcome:
    service = service_class(args.service_type)
    if not (hasattr(service, "Request") and hasattr(service, "Response")):
        return "The passed type is not a service"
    request = service.Request()
    values = args.values
    if args.stdin:
        with stopping.immediate():
            values = sys.stdin.buffer.read()
    fill_from_yaml(request, values)

    package, name = service.__module__.split(".")[0], service.__name__
    with Graph(args, node_name=f"_ros2cli_requester_{package}_{name}") as graph:
        try:
            client = graph.node.create_client(service, args.service_name)
        except NAME_ERRORS as error:
            return str(error)
        if not graph.spin_until(client.service_is_ready, timeout=LIMIT):
            print("waiting for service to become available...")
            graph.spin_until(client.service_is_ready)
        due = time.monotonic()
        while True:
            print(f"requester: making request: {request!r}\n")
            future: Any = client.call_async(request)
            graph.spin_until(future.done, period=stopping.SLICE)
            if future.exception() is not None:
                raise CommandError(f"Exception while calling service: {future.exception()!r}")
            print(f"response:\n{future.result()!r}\n")
            if args.rate is None:
                return None
            due = max(due + 1.0 / args.rate, time.monotonic())
            graph.spin_until(lambda: False, timeout=due - time.monotonic())


VERBS = {
    "call": Verb("Call a service", _call, _call_arguments),
    "find": Verb("List the services of a type", _find, _find_arguments),
    "info": Verb("Show a service's type and how many serve and call it", _info, _name_arguments),
    "list": Verb("List the services", _list, _list_arguments),
    "type": Verb("Show a service's type", _type, _name_arguments),
}
