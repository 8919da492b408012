"""``ros2 interface``: message, service and action definitions as they are installed in ``share/<package>``."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from ros2_fallback import index
from ros2_fallback.command import CommandError, Outcome, Verb

__all__ = ["VERBS", "definition", "definition_path"]

_TITLES = {"msg": "Messages:", "srv": "Services:", "action": "Actions:"}
_PRIMITIVES = frozenset(
    ["bool", "byte", "char", "string", "wstring", "float32", "float64"]
    + [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
)
# A field or a constant: the type, its bounds, and what follows.
_DECLARATION = re.compile(r"\s*(?P<type>[A-Za-z][\w/]*)(?P<bounds>(?:<=\d+)?(?:\[[^\]]*\])?)\s+(?P<name>\w+)")


def definition_path(identifier: str) -> Path:
    """The file that defines an interface named as ``package/kind/Name``.

    Raises:
        CommandError: if the name is malformed, or there is no such package or interface.
    """
    parts = identifier.split("/")
    if len(parts) != 3 or not all(parts) or ".." in parts:
        raise CommandError(f"Invalid name '{identifier}'. Expected three parts separated by '/'")
    package, kind, name = parts
    where = index.prefix(package)
    if where is None:
        raise CommandError(f"Unknown package '{package}'")
    folder = where / "share" / package / kind
    for path in (folder / f"{name}.{kind}", folder / f"{name}.idl"):
        if path.exists():
            return path
    raise CommandError(f"Could not find the interface '{folder / name}'")


def definition(identifier: str, comments: bool = True, nested_comments: bool = False, depth: int = 0) -> Iterator[str]:
    """The lines of an interface's definition, each nested message expanded below its field, one tab deeper.

    Without `comments`, comments and blank lines are left out; `nested_comments` says the same for the expansions.
    """
    path = definition_path(identifier)
    package = identifier.split("/", maxsplit=1)[0]
    is_idl = path.suffix == ".idl"
    for line in path.read_text(encoding="utf-8").splitlines():
        text = line.rstrip()
        code = text if is_idl else text[: _comment_start(text)].rstrip()
        if comments or code:
            shown = text if comments else code.strip()
            yield "\t" * depth + shown if shown else ""
        nested = None if is_idl else _nested_type(code, package)
        if nested:
            yield from definition(nested, nested_comments, nested_comments, depth + 1)


def _comment_start(text: str) -> int:
    """Where the comment of a line begins, behind any quoted text; the line's length if there is none."""
    quote = ""
    escaped = False
    for i, character in enumerate(text):
        if escaped:
            escaped = False
        elif quote:
            escaped = character == "\\"
            if character == quote:
                quote = ""
        elif character == "#":
            return i
        elif character in "\"'":
            quote = character
    return len(text)


def _nested_type(code: str, package: str) -> str | None:
    """The message type that a line's field has, as ``package/msg/Name``; None for a primitive one or no field."""
    match = _DECLARATION.match(code)
    if match is None or match["type"] in _PRIMITIVES:
        return None
    parts = match["type"].split("/")
    if len(parts) == 1:
        return f"{package}/msg/{parts[0]}"
    return f"{parts[0]}/msg/{parts[-1]}"


def _show_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--all-comments", action="store_true", help="show the comments of nested definitions too")
    group.add_argument("--no-comments", action="store_true", help="show neither comments nor blank lines")
    parser.add_argument("type", help="full name (e.g. 'std_msgs/msg/String'), or '-' to read it from stdin")


def _show(args: argparse.Namespace) -> Outcome:
    identifier = args.type
    if identifier == "-":
        if sys.stdin.isatty():
            return "ros2 interface show: expected a type's name on stdin"
        identifier = sys.stdin.readline().strip()
    for line in definition(identifier, comments=not args.no_comments, nested_comments=args.all_comments):
        print(line)
    return None


def _kind_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-m", "--only-msgs", action="append_const", dest="kinds", const="msg", help="show messages")
    parser.add_argument("-s", "--only-srvs", action="append_const", dest="kinds", const="srv", help="show services")
    parser.add_argument(
        "-a", "--only-actions", action="append_const", dest="kinds", const="action", help="show actions"
    )


def _kinds(args: argparse.Namespace) -> tuple[str, ...]:
    return tuple(kind for kind in _TITLES if args.kinds is None or kind in args.kinds)


def _list(args: argparse.Namespace) -> Outcome:
    for kind in _kinds(args):
        print(_TITLES[kind])
        for package in index.interface_packages():
            for name in index.interfaces(package, (kind,)):
                print(f"    {package}/{name}")
    return None


def _package_arguments(parser: argparse.ArgumentParser) -> None:
    _kind_arguments(parser)
    parser.add_argument("package_name", help="name of the package (e.g. 'std_msgs')")


def _package(args: argparse.Namespace) -> Outcome:
    for name in index.interfaces(args.package_name, _kinds(args)):
        print(f"{args.package_name}/{name}")
    return None


def _packages(args: argparse.Namespace) -> Outcome:
    for package in index.interface_packages():
        if index.interfaces(package, _kinds(args)):
            print(package)
    return None


def _proto_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("type", help="full name (e.g. 'std_msgs/msg/String')")
    parser.add_argument("--no-quotes", action="store_true", help="leave out the quotes around the text")


def _proto(args: argparse.Namespace) -> Outcome:
    # Imported here: the other verbs need no message classes, which bring the ROS libraries with them.
    from ros2_fallback.message_text import to_yaml
    from ros2_fallback.message_types import interface_class

    interface = interface_class(args.type)
    asked = getattr(interface, "Goal", None) or getattr(interface, "Request", None) or interface
    text = to_yaml(asked())
    print(text if args.no_quotes else f'"{text}"')
    return None


VERBS = {
    "list": Verb("List the interfaces", _list, _kind_arguments),
    "package": Verb("List the interfaces of one package", _package, _package_arguments),
    "packages": Verb("List the packages that have interfaces", _packages, _kind_arguments),
    "proto": Verb("Show an interface's default values as YAML", _proto, _proto_arguments),
    "show": Verb("Show the definition of an interface", _show, _show_arguments),
}
