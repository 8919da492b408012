"""`./rig bench`: every row, one after the other, as a table and as JSON; and what became slower since another run."""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import compare
import machine
from rows import BenchError, Row, table

#: What can be measured: module and function, which returns rows whose names begin with this one, and what they say.
MEASUREMENTS = {
    "filter.cart_pendulum": ("filter:cart_pendulum", "evaluation and replacement against C and Python scalars"),
    "filter.slip": ("filter:slip", "the same of a hybrid task, against C"),
    "filter.laboratory": ("filter:laboratory", "check and update beside the figures of the laboratory's own code"),
    "filter.batch": ("filter:batch", "evaluation of many states, against a loop in C"),
    "node.tick": ("tick:rows", "the filter node from message to message, against a node that echoes"),
    "timer": ("jitter:rows", "lateness of a timer at 100 Hz and 1 kHz, against clock_nanosleep in C"),
    "loop.lockstep": ("loop:lockstep", "state out to motion in, one tick after the other, against a bare ring"),
    "loop.100Hz": ("loop:realtime", "the same at 100 Hz of wall time, and the states' jitter"),
    "loop.1kHz": ("loop:kilohertz", "missed deadlines in 60 s at 1 kHz"),
    "loop.processes": ("processes:rows", "latency and missed deadlines at 100 Hz, a process for each node, recorded"),
    "loop.10min": ("processes:ten_minutes", "the same for ten minutes"),
    "recorder": ("loop:recorder", "a tick with and without the recorder"),
    "reader": ("bag:rows", "reading and checking a bag, against rosbags"),
    "lockstep.composed": ("lockstep:composed", "real-time factor of ./rig up in one process, recorded"),
    "lockstep.processes": ("lockstep:processes", "the same in separate processes"),
    "display": ("display:rows", "a person's page: pointer to wrench, state to drawn, what it costs the loop"),
    "startup": ("startup:rows", "time to a ready node and a running graph, and their memory"),
}

#: What takes long, and is measured only where it is named.
BY_NAME = {"loop.10min"}


def parser() -> argparse.ArgumentParser:
    """The command line of `./rig bench`."""
    result = argparse.ArgumentParser(
        prog="./rig bench",
        description="Measure the rig's speed, each row beside a baseline that alternates with it run by run, and print "
        "medians. Exit code 1 if a row could not be measured or, with --compare, became slower.",
        epilog=f"{compare.RULE} RIG_REALTIME and RIG_CPUS hold for the rows that wall time paces, and their baselines.",
    )
    usual = f"all but {', '.join(BY_NAME)}"
    result.add_argument("rows", nargs="*", metavar="ROW", help=f"rows, or beginnings of their names ({usual})")
    result.add_argument("--list", action="store_true", help="say what there is and measure nothing")
    result.add_argument("--runs", type=int, default=5, metavar="N", help="runs of each row (%(default)s)")
    result.add_argument("--out", type=Path, default=Path("bench.json"), metavar="FILE", help="JSON (%(default)s)")
    result.add_argument("--compare", type=Path, metavar="OLD", help="say what became slower since this JSON file")
    return result


def select(beginnings: Sequence[str]) -> list[str]:
    """Names of the measurements that hold rows with these beginnings, in their order.

    If there are none, all but those that are measured by name only.

    Raises
    ------
    BenchError: nothing begins so.
    """
    for beginning in beginnings:
        if not any(_wants(beginning, name) for name in MEASUREMENTS):
            raise BenchError(f"no row begins with {beginning!r}; there are {', '.join(MEASUREMENTS)}")
    if not beginnings:
        return [name for name in MEASUREMENTS if name not in BY_NAME]
    return [name for name in MEASUREMENTS if any(_wants(beginning, name) for beginning in beginnings)]


def _wants(beginning: str, name: str) -> bool:
    return _holds(name, beginning) and (name not in BY_NAME or beginning.startswith(name))


def _holds(name: str, beginning: str) -> bool:
    # A whole row's name is longer than that of its measurement.
    return name.startswith(beginning) or beginning.startswith(f"{name}.")


def measure(name: str, runs: int) -> list[Row]:
    """The rows of a measurement, from a process of its own: it may change its scheduling, or be ended by a fault.

    Raises
    ------
    Exception: whatever the measurement raised, or that its process died.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_call, MEASUREMENTS[name][0], runs).result()


def _call(where: str, runs: int) -> list[Row]:
    module, function = where.split(":")
    found: list[Row] = getattr(importlib.import_module(module), function)(runs)
    return found


def run(names: Sequence[str], runs: int) -> tuple[list[Row], dict[str, str]]:
    """All rows, and why which measurements failed; a line of progress each."""
    rows: list[Row] = []
    failures: dict[str, str] = {}
    for number, name in enumerate(names, 1):
        print(f"[{number}/{len(names)}] {name}: {MEASUREMENTS[name][1]}", end="", file=sys.stderr, flush=True)
        begin = time.monotonic()
        try:
            rows += measure(name, runs)
            print(f"  {time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)
        except Exception as error:  # noqa: BLE001 whatever it is, the other rows are measured
            failures[name] = f"{type(error).__name__}: {error}" if not isinstance(error, BenchError) else str(error)
            print("  failed", file=sys.stderr, flush=True)
    return rows, failures


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, write, compare."""
    arguments = parser().parse_args(argv)
    try:
        names = select(arguments.rows)
        old = compare.load_rows(arguments.compare) if arguments.compare else []
        if arguments.runs < 1:
            raise BenchError(f"--runs {arguments.runs}: at least one is needed")
        if not arguments.out.resolve().parent.is_dir():
            raise BenchError(f"--out {arguments.out}: there is no such folder")
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if arguments.list:
        names += [] if arguments.rows else [name for name in MEASUREMENTS if name in BY_NAME]
        by_name = " (only where it is named)"
        print("\n".join(f"{name:22} {MEASUREMENTS[name][1]}{by_name * (name in BY_NAME)}" for name in names))
        return 0
    before = machine.describe()
    rows, failures = run(names, arguments.runs)
    after = machine.describe()
    print(table(rows))
    _say_of_the_machine(before, after)
    changes = compare.compare(old, rows) if arguments.compare else []
    for change in changes:
        print(change.text())
    for name, reason in failures.items():
        print(f"error: {name}: {reason}", file=sys.stderr)
    body = {"machine": before, "load average after": after["load average"], "failures": failures}
    arguments.out.write_text(json.dumps({**body, "rows": [asdict(row) for row in rows]}, indent=1) + "\n")
    print(f"written to {arguments.out}")
    return int(bool(failures) or any(change.verdict == "slower" for change in changes))


def _say_of_the_machine(before: dict[str, Any], after: dict[str, Any]) -> None:
    loads = " then ".join(" ".join(map(str, found["load average"])) for found in (before, after))
    print(
        f"{before['processors usable']} processors ({before['processor']}), load {loads}, "
        f"RIG_REALTIME={before['RIG_REALTIME']}, commit {before['commit']}"
    )


if __name__ == "__main__":
    sys.exit(main())
