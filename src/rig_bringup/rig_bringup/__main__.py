"""`python -m rig_bringup COMMAND ...`: what `./rig` calls once the environment is there."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from pathlib import Path
from types import FrameType

#: Module and function behind each command. Imported only when it is asked for: none pays for another's start-up.
_COMMANDS = {
    "up": ("rig_bringup.up", "main"),
    "display": ("rig_bringup.up", "display"),
    "test": ("rig_bringup.testing", "main"),
    "bag": ("rig_bringup.__main__", "bag"),
    "rederive": ("rig_study.rederive_cli", "main"),
    "study": ("rig_bringup.session", "main"),
    "montecarlo": ("rig_study.sweep_cli", "montecarlo"),
    "sweep": ("rig_study.sweep_cli", "sweep"),
    "reproduce": ("rig_study.reproduce_cli", "main"),
    "soak": ("rig_bringup.soak", "main"),
    "faults": ("rig_bringup.faults.cli", "main"),
    "fuzz": ("rig_bringup.__main__", "fuzz"),
    "bench": ("rig_bringup.__main__", "bench"),
    "analyze": ("rig_study.analyze_cli", "main"),
}


def main() -> int:
    """Dispatch."""
    command, *rest = sys.argv[1:] or [""]
    if command not in _COMMANDS:
        print(f"error: there is no command {command!r}; use {', '.join(_COMMANDS)}", file=sys.stderr)
        return 2
    interrupts: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        interrupts.append(number)
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        # Also in the background, where a shell has interrupts ignored; `kill` ends a run as Ctrl-C does.
        signal.signal(number, interrupt)
    module, function = _COMMANDS[command]
    try:
        code: int = getattr(importlib.import_module(module), function)(rest)
    except (KeyboardInterrupt, Exception) as error:
        # A library in C++ that is being loaded makes an error of its own of an interrupt.
        if interrupts or isinstance(error, KeyboardInterrupt):
            # Where there is more to say, the command says it and returns the same.
            print("interrupted", file=sys.stderr)
            return 130
        # The middleware's own error; its name serves, so that no command pays for rclpy that does not use it.
        if type(error).__name__ != "RCLError":
            raise
        from rig_runtime.run import refusal_of_middleware

        print(f"error: {refusal_of_middleware(error)}", file=sys.stderr)
        return 2
    return code


def bag(arguments: list[str]) -> int:
    """`./rig bag`: with what the rig knows about a trial in `bag info`."""
    from rig_bag.cli import main as bag_main

    return bag_main(arguments, "./rig bag", about=trial_of)


def bench(arguments: list[str]) -> int:
    """`./rig bench`: becomes the checkout's own measurements, which are not installed."""
    suite = Path(os.environ["RIG_ROOT"]) / "bench" / "suite.py"
    os.execv(sys.executable, [sys.executable, str(suite), *arguments])


def fuzz(arguments: list[str]) -> int:
    """`./rig fuzz`: becomes the checkout's own, as `bench` does."""
    where = Path(os.environ["RIG_ROOT"]) / "tests" / "fuzz"
    os.execv(sys.executable, [sys.executable, str(where), *arguments])


def trial_of(bag: str) -> str:
    """Verdicts, deadlines, latencies of a recorded trial; nothing of a bag that is none."""
    from rig_study.recorded import TrialError
    from rig_study.trial_report import summarize

    try:
        return summarize(bag)
    except TrialError:
        return ""


if __name__ == "__main__":
    sys.exit(main())
