"""``ros2 param``: read and change the parameters of nodes."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rclpy.parameter import Parameter as RclpyParameter
from rclpy.parameter import get_parameter_value, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from ros2_fallback import stopping
from ros2_fallback.command import CommandError, Outcome, Verb, non_negative_int
from ros2_fallback.graph import Graph, absolute_name, add_graph_arguments

__all__ = ["VERBS", "values_for"]

_parameter: Any = RclpyParameter  # untyped in rclpy

#: [s] how long the parameter services of a node that is there may take to turn up
SERVICE_TIMEOUT = 5.0

#: Of each type: what `describe` calls it and what `get` puts before the value.
_TYPES: dict[int, tuple[str, str]] = {
    ParameterType.PARAMETER_NOT_SET: ("not set", "Parameter not set."),
    ParameterType.PARAMETER_BOOL: ("boolean", "Boolean value is:"),
    ParameterType.PARAMETER_INTEGER: ("integer", "Integer value is:"),
    ParameterType.PARAMETER_DOUBLE: ("double", "Double value is:"),
    ParameterType.PARAMETER_STRING: ("string", "String value is:"),
    ParameterType.PARAMETER_BYTE_ARRAY: ("byte array", "Byte values are:"),
    ParameterType.PARAMETER_BOOL_ARRAY: ("boolean array", "Boolean values are:"),
    ParameterType.PARAMETER_INTEGER_ARRAY: ("integer array", "Integer values are:"),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("double array", "Double values are:"),
    ParameterType.PARAMETER_STRING_ARRAY: ("string array", "String values are:"),
}


class _Parameters:
    """The parameter services of one node, each call waited for.

    Raises:
        CommandError: if they do not turn up, go away during a call, or fail.
    """

    def __init__(self, graph: Graph, node_name: str) -> None:
        self._graph = graph
        self._node_name = node_name
        self._client = AsyncParameterClient(graph.node, node_name)
        if not graph.spin_until(self._client.services_are_ready, timeout=SERVICE_TIMEOUT):
            raise CommandError(f"Wait for service timed out waiting for parameter services for node {node_name}")

    def _result(self, future: Any) -> Any:
        self._graph.spin_until(lambda: future.done() or not self._client.services_are_ready(), period=stopping.SLICE)
        if not future.done() or future.exception() is not None:
            reason = future.exception() if future.done() else "it has gone"
            raise CommandError(f"Exception while calling service of node {self._node_name}: {reason}")
        return future.result()

    def names(self, prefixes: list[str] | None = None) -> list[str]:
        """Names of the parameters, sorted; only those below the prefixes, if there are any."""
        return sorted(self._result(self._client.list_parameters(prefixes=prefixes)).result.names)

    def values(self, names: list[str]) -> list[Any]:
        """Their values, as rcl_interfaces/msg/ParameterValue."""
        return list(self._result(self._client.get_parameters(names)).values)

    def descriptors(self, names: list[str]) -> list[Any]:
        """Their descriptors, as rcl_interfaces/msg/ParameterDescriptor."""
        return list(self._result(self._client.describe_parameters(names)).descriptors)

    def set(self, parameters: list[Any]) -> list[Any]:
        """Set parameters; a rcl_interfaces/msg/SetParametersResult for each."""
        return list(self._result(self._client.set_parameters(parameters)).results)


def _node_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("node_name", help="name of the node")
    parser.add_argument("--include-hidden-nodes", action="store_true", help="consider hidden nodes too")
    parser.add_argument(
        "--timeout",
        type=non_negative_int,
        default=1,
        metavar="S",
        help="seconds to wait for the node beyond discovery (default: 1)",
    )


def _with_node(
    act: Callable[[argparse.Namespace, _Parameters], Outcome],
) -> Callable[[argparse.Namespace], Outcome]:
    """Make a verb out of what is done with the parameters of the node that was named."""

    def run(args: argparse.Namespace) -> Outcome:
        name = absolute_name(args.node_name)
        with Graph(args) as graph:
            graph.wait_for_node(name, args.include_hidden_nodes, args.timeout)
            return act(args, _Parameters(graph, name))

    return run


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("node_name", nargs="?", help="name of the node (default: all nodes)")
    parser.add_argument("--include-hidden-nodes", action="store_true", help="consider hidden nodes too")
    parser.add_argument("--filter", metavar="REGEX", help="show only names that begin with a match of this")
    parser.add_argument("--param-prefixes", nargs="+", default=[], metavar="P", help="show only names below these")
    parser.add_argument("--param-type", action="store_true", help="show the types too")


def _list(args: argparse.Namespace) -> Outcome:
    try:
        pattern = re.compile(args.filter or "")
    except re.error as error:
        return f"--filter '{args.filter}': {error}"
    with Graph(args) as graph:
        if args.node_name is None:
            graph.discover()
            nodes = sorted(set(graph.node_names(args.include_hidden_nodes)))
        else:
            nodes = [absolute_name(args.node_name)]
            graph.wait_for_node(nodes[0], args.include_hidden_nodes, timeout=0.0)
        failed = False
        for node in nodes:
            try:
                parameters = _Parameters(graph, node)
                names = [name for name in parameters.names(args.param_prefixes) if pattern.match(name)]
                types = {d.name: d.type for d in parameters.descriptors(names)} if args.param_type and names else {}
            except CommandError as error:
                print(error, file=sys.stderr)
                failed = True
                continue
            if args.node_name is None and names:
                print(f"{node}:")
            for name in names:
                print(f"  {name} (type: {_TYPES[types[name]][0]})" if name in types else f"  {name}")
    return 1 if failed and args.node_name is not None else 0


def _get_arguments(parser: argparse.ArgumentParser) -> None:
    _node_arguments(parser)
    parser.add_argument("parameter_name", help="name of the parameter")
    parser.add_argument("--hide-type", action="store_true", help="show the value without its type")


def _get(args: argparse.Namespace, parameters: _Parameters) -> Outcome:
    values = parameters.values([args.parameter_name])
    if not values:
        return "Parameter not set"
    value = parameter_value_to_python(values[0])
    label = _TYPES[values[0].type][1]
    if args.hide_type:
        print(value)
    elif value is None:
        print(label)
    else:
        print(label, value)
    return None


def _set_arguments(parser: argparse.ArgumentParser) -> None:
    _node_arguments(parser)
    parser.add_argument("parameter_name", help="name of the parameter")
    parser.add_argument("value", help="its value, as YAML")


def _set(args: argparse.Namespace, parameters: _Parameters) -> Outcome:
    parameter = Parameter(name=args.parameter_name, value=get_parameter_value(string_value=args.value))
    (result,) = parameters.set([parameter])
    return _tell(result, "Set parameter successful", "Setting parameter failed")


def _delete_arguments(parser: argparse.ArgumentParser) -> None:
    _node_arguments(parser)
    parser.add_argument("parameter_name", help="name of the parameter")


def _delete(args: argparse.Namespace, parameters: _Parameters) -> Outcome:
    nothing = ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
    (result,) = parameters.set([Parameter(name=args.parameter_name, value=nothing)])
    return _tell(result, "Deleted parameter successfully", "Deleting parameter failed")


def _tell(result: Any, success: str, failure: str) -> Outcome:
    """Print what became of a parameter; the exit code."""
    text = success if result.successful else failure
    if result.reason:
        text += f": {result.reason}"
    print(text, file=sys.stdout if result.successful else sys.stderr)
    return 0 if result.successful else 1


def _dump(args: argparse.Namespace, parameters: _Parameters) -> Outcome:
    names = parameters.names()
    values = parameters.values(names) if names else []
    # One parameter without a value empties the whole answer: then each is asked for alone, and that one left out.
    found = zip(names, values, strict=True) if values else ((n, v) for n in names for v in parameters.values([n]))
    tree: dict[str, Any] = {}
    for name, value in found:
        branch = tree
        *folders, leaf = name.split(".")
        for folder in folders:
            branch = branch.setdefault(folder, {})
        branch[leaf] = parameter_value_to_python(value)
    print(yaml.dump({absolute_name(args.node_name): {"ros__parameters": tree}}, default_flow_style=False))
    return None


def _load_arguments(parser: argparse.ArgumentParser) -> None:
    _node_arguments(parser)
    parser.add_argument("parameter_file", help="a ROS parameter file")
    parser.add_argument("--no-use-wildcard", action="store_true", help="leave out the file's '/**' sections")


def _load(args: argparse.Namespace, parameters: _Parameters) -> Outcome:
    try:
        with Path(args.parameter_file).open(encoding="utf-8") as file:
            sections = yaml.safe_load(file)
        values = values_for(absolute_name(args.node_name), sections, use_wildcard=not args.no_use_wildcard)
        messages = [_parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    except (CommandError, OSError, TypeError, ValueError, yaml.YAMLError) as error:
        return f"Cannot load '{args.parameter_file}': {error}"
    codes = [
        _tell(result, f"Set parameter {message.name} successful", f"Set parameter {message.name} failed")
        for message, result in zip(messages, parameters.set(messages), strict=True)
    ]
    return 1 if any(codes) else 0


def values_for(node: str, sections: Any, use_wildcard: bool = True) -> dict[str, Any]:
    """What a parameter file has for a node, by the parameters' full names; later sections override earlier ones.

    Args:
        node: full name of the node.
        sections: the file's content. A section's name may hold ``*`` for one and ``**`` for any number of parts.
        use_wildcard: whether the section ``/**`` counts.

    Raises:
        CommandError: if it is no parameter file, or has nothing for the node; the text says what it has.
    """
    if not isinstance(sections, dict) or not all(isinstance(name, str) for name in sections):
        raise CommandError("it is not a ROS parameter file")
    values: dict[str, Any] = {}
    matched = False
    for name, section in sections.items():
        if not _matches(name, node) or (name == "/**" and not use_wildcard):
            continue
        if not isinstance(section, dict) or not isinstance(section.get("ros__parameters"), dict):
            raise CommandError(f"section '{name}' has no 'ros__parameters'")
        matched = True
        values |= _flat(section["ros__parameters"])
    if not matched:
        raise CommandError(f"it has no section for {node} (it has: {', '.join(sections) or 'none'})")
    return values


def _matches(section: str, node: str) -> bool:
    parts = [
        {"*": "/[^/]+", "**": "(?:/[^/]+)*"}.get(part, "/" + re.escape(part)) for part in section.strip("/").split("/")
    ]
    return re.fullmatch("".join(parts), node) is not None


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested parameters by their full names."""
    values: dict[str, Any] = {}
    for name, value in tree.items():
        values |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return values


def _describe_arguments(parser: argparse.ArgumentParser) -> None:
    _node_arguments(parser)
    parser.add_argument("parameter_names", nargs="+", help="names of the parameters")


def _describe(args: argparse.Namespace, parameters: _Parameters) -> Outcome:
    for descriptor in parameters.descriptors(args.parameter_names):
        print("Parameter name:", descriptor.name)
        print("  Type:", _TYPES[descriptor.type][0])
        if descriptor.description:
            print("  Description:", descriptor.description)
        print("  Constraints:")
        if descriptor.read_only:
            print("    Read only: true")
        for bounds in [*descriptor.floating_point_range, *descriptor.integer_range][:1]:
            print("    Min value:", bounds.from_value)
            print("    Max value:", bounds.to_value)
            if bounds.step:
                print("    Step:", bounds.step)
        if descriptor.additional_constraints:
            print("    Additional constraints:", descriptor.additional_constraints)
    return None


VERBS = {
    "delete": Verb("Delete a parameter", _with_node(_delete), _delete_arguments),
    "describe": Verb("Show what parameters mean and may be", _with_node(_describe), _describe_arguments),
    "dump": Verb("Show all parameters of a node as a parameter file", _with_node(_dump), _node_arguments),
    "get": Verb("Show the value of a parameter", _with_node(_get), _get_arguments),
    "list": Verb("List the parameters of one node or of all", _list, _list_arguments),
    "load": Verb("Set the parameters that a file has for a node", _with_node(_load), _load_arguments),
    "set": Verb("Set a parameter", _with_node(_set), _set_arguments),
}
