"""`python -m rig_bringup COMMAND ...`: what `./rig` calls once the environment is there."""

from __future__ import annotations

import sys


def main() -> int:
    """Dispatch; each command is imported only when it is asked for, so that none pays for another's start-up."""
    command, *rest = sys.argv[1:] or [""]
    if command == "up":
        from rig_bringup.up import main as up

        return up(rest)
    if command == "test":
        from rig_bringup.testing import main as test

        return test(rest)
    if command == "bag":
        from rig_bag.cli import main as bag

        return bag(rest)
    if command == "rederive":
        from rig_study.rederive_cli import main as rederive

        return rederive(rest)
    print(f"error: there is no command {command!r}; use up, test, bag, rederive", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
