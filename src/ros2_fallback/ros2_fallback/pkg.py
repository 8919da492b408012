"""``ros2 pkg``: what is installed."""

from __future__ import annotations

import argparse

from ros2_fallback import index
from ros2_fallback.command import Outcome, Verb

__all__ = ["VERBS"]

_NOT_FOUND = "Package not found"


def _list(_args: argparse.Namespace) -> Outcome:
    for name in index.package_names():
        print(name)
    return None


def _prefix_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package_name", help="name of the package")
    parser.add_argument("--share", action="store_true", help="show the package's share folder instead")


def _prefix(args: argparse.Namespace) -> Outcome:
    where = index.prefix(args.package_name)
    if where is None:
        return _NOT_FOUND
    print(where / "share" / args.package_name if args.share else where)
    return None


def _executables_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package_name", nargs="?", help="name of the package (default: all packages)")
    parser.add_argument("--full-path", action="store_true", help="show where each executable is")


def _executables(args: argparse.Namespace) -> Outcome:
    for package in [args.package_name] if args.package_name else index.package_names():
        for path in index.executables(package):
            print(path if args.full_path else f"{package} {path.name}")
    return None


VERBS = {
    "executables": Verb("List the executables of one package or of all", _executables, _executables_arguments),
    "list": Verb("List the packages", _list),
    "prefix": Verb("Show where a package is installed", _prefix, _prefix_arguments),
}
