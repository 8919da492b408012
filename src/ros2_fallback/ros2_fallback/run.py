"""``ros2 run``: replace this process by an executable of a package.

The executable takes over the process instead of becoming its child: signals, exit code, terminal and process id are
then its own, and whoever starts nodes from a script can wait for them and stop them by the id that the shell knows.
Nothing here imports rclpy, so that starting a node costs no more than finding it.
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from ros2_fallback import index
from ros2_fallback.command import CommandError

__all__ = ["find_executable", "main"]


def find_executable(package: str, executable: str) -> Path:
    """The one executable of that name in the package.

    Raises:
        CommandError: if there is no such package, no such executable in it, or more than one.
    """
    found = [path for path in index.executables(package) if path.name == executable]
    if not found:
        raise CommandError("No executable found")
    if len(found) > 1:
        raise CommandError("\n- ".join(["Multiple executables found:", *map(str, found)]))
    return found[0]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="ros2 run", description="Run an executable of a package")
    parser.add_argument(
        "--prefix",
        type=shlex.split,
        default=[],
        help="command to put before the executable, quoted if it has spaces (e.g. --prefix 'gdb -ex run --args')",
    )
    parser.add_argument("package_name", help="name of the package")
    parser.add_argument("executable_name", help="name of the executable")
    parser.add_argument("argv", nargs=argparse.REMAINDER, help="passed on to the executable as it is")
    return parser


def main(argv: Sequence[str]) -> str:
    """Become the executable that `argv` asks for; returns only if that fails, with the reason."""
    args = _parser().parse_args(argv)
    path = find_executable(args.package_name, args.executable_name)
    command = [*args.prefix, str(path), *args.argv]
    sys.stdout.flush()
    sys.stderr.flush()
    # The interpreter ignores these for itself; the executable shall find them as a shell would have left them.
    for name in ("SIGPIPE", "SIGXFSZ"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
    try:
        os.execvp(command[0], command)
    except OSError as error:
        return f"Cannot run '{command[0]}': {error.strerror}"
