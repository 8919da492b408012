"""`python -m rig_bringup COMMAND ...`: what `./rig` calls once the environment is there."""

from __future__ import annotations

import sys


def main() -> int:
    """Dispatch; each command is imported only when it is asked for, so that none pays for another's start-up."""
    command, *rest = sys.argv[1:] or [""]
    if command == "up":
        from rig_bringup.up import main as up

        return up(rest)
    if command == "display":
        from rig_bringup.up import main as up

        return up(["--display", *rest])
    if command == "test":
        from rig_bringup.testing import main as test

        return test(rest)
    if command == "bag":
        from rig_bag.cli import main as bag

        return bag(rest, "./rig bag", about=trial_of)
    if command == "rederive":
        from rig_study.rederive_cli import main as rederive

        return rederive(rest)
    print(f"error: there is no command {command!r}; use up, display, test, bag, rederive", file=sys.stderr)
    return 2


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
