"""`./rig fuzz`: garbage at every boundary of the rig, reproducible from a seed; a table of what became of it."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # tests/, as pytest has it
os.environ["RIG_REALTIME"] = "off"

from fuzz.every import EVERY
from fuzz.runner import Outcome, run, table


def main() -> int:
    """0 if nothing crashed, hung, or was refused without a clear error."""
    names = [kind.name for kind in EVERY]
    parser = argparse.ArgumentParser(prog="./rig fuzz", description=__doc__)
    parser.add_argument("boundary", nargs="*", choices=[[], *names], help=f"only these: {', '.join(names)}")
    parser.add_argument("--inputs", type=int, default=10_000, help="over all boundaries (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="another one, other inputs (default: %(default)s)")
    parser.add_argument("--only", type=int, metavar="N", help="input number N alone, to see a crash again")
    options = parser.parse_args()
    if options.inputs < 1:
        parser.error(f"--inputs {options.inputs}: must be at least 1")
    kinds = [kind for kind in EVERY if not options.boundary or kind.name in options.boundary]
    shares = sum(kind.share for kind in kinds)
    outcomes = []
    for kind in kinds:
        count = max(1, round(options.inputs * kind.share / shares))
        outcome = run(kind, range(count) if options.only is None else [options.only], options.seed, _say)
        outcomes.append(outcome)
        print(f"\r{'':60}\r" if sys.stderr.isatty() else "", end="", file=sys.stderr)
        for number, what in outcome.crashes:
            print(f"-- {kind.name}, input {number}\n{what}", flush=True)
    print(table(outcomes))
    return int(any(outcome.crashes for outcome in outcomes))


def _say(outcome: Outcome) -> None:
    if sys.stderr.isatty() and outcome.inputs % 50 == 0:
        print(f"\r{outcome.boundary}: {outcome.inputs} inputs, {outcome.seconds:.0f} s ", end="", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
