"""The ``ros2`` command: finds the command asked for, runs it, and turns its end into an exit code.

Exit codes: 0 success; 1 an error, with one line on stderr; 2 a command line that is not understood, or SIGINT; 15
SIGTERM. A reader that goes away (``ros2 topic echo /x | head -1``) is a success.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

from ros2_fallback import stopping
from ros2_fallback.command import CommandError, Outcome, add_verbs

__all__ = ["COMMANDS", "entry", "main"]

DESCRIPTION = """\
This is ros2_fallback, not ros2cli: a stand-in for the `ros2` command on machines that have rclpy but no ros2cli.
What it has behaves and prints as ros2cli for ROS 2 Jazzy does; what it has not is not listed here. There is no daemon:
each call discovers the graph afresh, which takes up to two seconds."""


@dataclass(frozen=True)
class Command:
    """One command: its module is imported when it is asked for, so that no command waits for what another needs."""

    summary: str
    module: str
    verbs: str = ""  #: for the help; commands whose arguments belong to another program have none
    graph: bool = False  #: whether it takes part in the ROS graph, and so must be stopped with care


COMMANDS: dict[str, Command] = {
    "bag": Command("Record, inspect and play bags (by rig_bag)", "bag"),
    "interface": Command("Show information about ROS interfaces", "interface", "list, package, packages, proto, show"),
    "node": Command("Show information about nodes", "node", "info, list", graph=True),
    "param": Command(
        "Read and change parameters of nodes", "param", "delete, describe, dump, get, list, load, set", graph=True
    ),
    "pkg": Command("Show information about packages", "pkg", "executables, list, prefix"),
    "run": Command("Run an executable of a package", "run"),
    "service": Command("Show and call services", "service", "call, find, info, list, type", graph=True),
    "topic": Command("Show, read and publish topics", "topic", "bw, echo, find, hz, info, list, pub, type", graph=True),
}


def _help_of_commands() -> str:
    width = max(len(name) for name in COMMANDS)
    lines = []
    for name, command in sorted(COMMANDS.items()):
        verbs = f": {command.verbs}" if command.verbs else ""
        lines.append(f"{name.ljust(width)}  {command.summary}{verbs}")
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--use-python-default-buffering",
        action="store_true",
        help="leave the buffering of stdout to Python instead of writing each line at once",
    )
    subparsers = parser.add_subparsers(
        title="Commands",
        description=_help_of_commands(),
        metavar="Call `ros2 <command> -h` for more detailed usage.",
        dest="command",
    )
    for name in COMMANDS:
        subparsers.add_parser(name, add_help=False)
    return parser


def _split(argv: Sequence[str]) -> tuple[list[str], str | None, list[str]]:
    """What stands before the command's name, the name, and what stands behind it."""
    for i, argument in enumerate(argv):
        if not argument.startswith("-"):
            return list(argv[:i]), argument, list(argv[i + 1 :])
    return list(argv), None, []


def _dispatch(argv: Sequence[str]) -> Outcome:
    """Import the command asked for, let it declare its arguments, and run it."""
    parser = _parser()
    head, name, rest = _split(argv)
    options = parser.parse_args(head if name is None else [*head, name])
    if name is None:
        parser.print_help()
        return 0
    module = importlib.import_module(f"ros2_fallback.{COMMANDS[name].module}")
    stopping.check()
    _set_buffering(options.use_python_default_buffering)
    if hasattr(module, "main"):  # a command without verbs of its own
        main_of_command: Callable[[list[str]], Outcome] = module.main
        return main_of_command(rest)

    command_parser = argparse.ArgumentParser(
        prog=f"ros2 {name}",
        description=COMMANDS[name].summary,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if hasattr(module, "arguments"):
        module.arguments(command_parser)
    add_verbs(command_parser, module.VERBS, rest)
    args = command_parser.parse_args(rest)
    if args.verb is None:
        command_parser.print_help()
        return 0
    run: Callable[[argparse.Namespace], Outcome] = args.run
    return run(args)


def _set_buffering(python_default: bool) -> None:
    if not python_default and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)


def _reader_went_away() -> None:
    """Send what is still buffered nowhere, so that closing stdout at exit does not fail."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (without the program's name) and return its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        name = _split(argv)[1]
        if name in COMMANDS and COMMANDS[name].graph:
            with stopping.deferred():
                outcome = _dispatch(argv)
        else:
            outcome = _dispatch(argv)
        sys.stdout.flush()
    except SystemExit as end:  # argparse, after it has printed
        outcome = end.code
    except BrokenPipeError:
        _reader_went_away()
        return 0
    except (KeyboardInterrupt, stopping.Stopped) as stop:
        return int(getattr(stop, "signum", signal.SIGINT))
    except CommandError as error:
        outcome = str(error)
    if isinstance(outcome, str):
        print(outcome, file=sys.stderr)
        return 1
    return 0 if outcome is None else int(outcome)


def entry() -> NoReturn:
    """Run the command line of this process, and end it."""
    code = main()
    # What is left is to close down, which nobody needs to interrupt.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _reader_went_away()
    sys.exit(code)
