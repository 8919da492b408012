"""`./rig bench`: rows, one measurement after the other, as a table and as JSON; and what became slower since."""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import compare
import figures
import machine
from rows import BenchError, NotHereError, Row, table


class Measurement(NamedTuple):
    """Rows whose names begin with that of the measurement."""

    #: Module and function.
    where: str
    #: About how long five runs take on an idle machine [s].
    seconds: int
    what: str
    #: Only with --all, or where it is named.
    long: bool = False


MEASUREMENTS = {
    "filter.cart_pendulum": Measurement("filter:cart_pendulum", 6, "evaluation, search and decision beside C"),
    "filter.slip": Measurement("filter:slip", 4, "the same of a hybrid task"),
    "filter.laboratory": Measurement("filter:laboratory", 1, "decisions beside published times of another's code"),
    "filter.batch": Measurement("filter:batch", 4, "evaluation of many states in one call beside C"),
    "node.tick": Measurement("tick:rows", 3, "the filter node from message to message beside an echo"),
    "timer": Measurement("jitter:rows", 75, "lateness of a timer at 100 Hz and 1 kHz beside clock_nanosleep in C"),
    "loop.lockstep": Measurement("loop:lockstep", 5, "state out to motion in, tick after tick, beside a bare ring"),
    "loop.100Hz": Measurement("loop:realtime", 80, "the same at 100 Hz of wall time, and the states' jitter"),
    "loop.1kHz": Measurement("kilohertz:rows", 145, "60 s at 1 kHz, composed, without recorder and with it", long=True),
    "loop.processes": Measurement("processes:rows", 115, "100 Hz, a process for each node, recorded", long=True),
    "loop.10min": Measurement("processes:ten_minutes", 620, "the same for ten minutes", long=True),
    "recorder.composed": Measurement("recorder:composed", 15, "a tick with and without the recorder, in one process"),
    "recorder.beside": Measurement("recorder:beside", 45, "the same, the recorder in a process of its own", long=True),
    "recorder.processes": Measurement("recorder:processes", 45, "the same, each node in a process", long=True),
    "reader": Measurement("bag:rows", 6, "reading and checking a bag beside rosbags"),
    "lockstep.composed": Measurement("lockstep:composed", 15, "real-time factor of ./rig up in one process, recorded"),
    "lockstep.processes": Measurement("lockstep:processes", 28, "the same in separate processes"),
    "display": Measurement("display:rows", 230, "a person's page: hand to wrench, state to drawn, cost", long=True),
    "startup": Measurement("startup:rows", 25, "time to a ready node and a running graph, and their memory"),
}

#: As wall time paces them, they need an idle machine and RIG_REALTIME=auto.
PACED = ("timer", "loop.100Hz", "loop.1kHz", "loop.processes", "loop.10min")


def parser() -> argparse.ArgumentParser:
    """The command line of `./rig bench`."""
    quick = sum(each.seconds for each in MEASUREMENTS.values() if not each.long)
    whole = sum(each.seconds for each in MEASUREMENTS.values())
    result = argparse.ArgumentParser(
        prog="./rig bench",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Measure the rig's speed beside baselines and print medians; the JSON file has each run.\n"
        f"Without ROW: all that is quick, about {_minutes(quick)}; --all: everything, about {_minutes(whole)}.\n\n"
        f"RIG_REALTIME=auto is what the figures in docs/performance.md are for: {', '.join(PACED)}\n"
        "are paced by wall time, and without it measure how the machine schedules. They need two idle processors.\n"
        "RIG_REALTIME and RIG_CPUS hold for these rows and their baselines alone.\n\n"
        "Exit code 1 if a row could not be measured or, with --compare, became slower; 0 where a wanted figure is\n"
        "missed, which the last line says, and where this machine lacks what a row needs.\n\n"
        + "\n".join(_listed(MEASUREMENTS))
        + "\n  * only with --all, or where it is named",
        epilog=compare.RULE,
    )
    result.add_argument("rows", nargs="*", metavar="ROW", help="rows, or beginnings of their names")
    result.add_argument("--all", action="store_true", help="the long ones too")
    result.add_argument("--list", action="store_true", help="say what there is and how long it takes; measure nothing")
    result.add_argument("--runs", type=int, default=5, metavar="N", help="runs of each row (%(default)s)")
    result.add_argument("--out", type=Path, default=Path("bench.json"), metavar="FILE", help="JSON (%(default)s)")
    result.add_argument(
        "--compare",
        type=Path,
        action="append",
        default=[],
        metavar="OLD",
        help="say what became slower since this JSON file; again for more files, which say how much a row moves",
    )
    result.add_argument("--table", type=Path, metavar="FILE", help="print a JSON file as Markdown; measure nothing")
    result.add_argument("--into", type=Path, metavar="DOC", help="put that table between the marks in this document")
    return result


def _minutes(seconds: int) -> str:
    return f"{round(seconds / 60)} minutes"


def _listed(names: Sequence[str] | dict[str, Measurement]) -> list[str]:
    each = [(name, MEASUREMENTS[name]) for name in names]
    return [f"  {name:21}{'*' if found.long else ' '}{found.seconds:4} s  {found.what}" for name, found in each]


def select(beginnings: Sequence[str], everything: bool = False) -> list[str]:
    """Names of the measurements that hold rows with these beginnings, in their order.

    If there are none, those that are quick. What is long is measured only by its own name, or with `everything`.

    Raises
    ------
    BenchError: nothing begins so.
    """
    for beginning in beginnings:
        if not any(_holds(name, beginning) for name in MEASUREMENTS):
            raise BenchError(f"no row begins with {beginning!r}; there are {', '.join(MEASUREMENTS)}")
    return [
        name
        for name, found in MEASUREMENTS.items()
        if any(
            _holds(name, beginning) and (everything or not found.long or beginning.startswith(name))
            for beginning in beginnings or [""]
        )
    ]


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
        return pool.submit(_call, MEASUREMENTS[name].where, runs).result()


def _call(where: str, runs: int) -> list[Row]:
    module, function = where.split(":")
    found: list[Row] = getattr(importlib.import_module(module), function)(runs)
    return found


@dataclass
class Results:
    """What a run of the suite has found."""

    rows: list[Row] = field(default_factory=list)
    #: Why which measurement failed, and why which is not for this machine.
    failures: dict[str, str] = field(default_factory=dict)
    not_run: dict[str, str] = field(default_factory=dict)
    #: [s] that each took.
    seconds: dict[str, float] = field(default_factory=dict)

    def measured(self) -> list[str]:
        """Names of the measurements that have rows."""
        return [name for name in self.seconds if name not in self.failures and name not in self.not_run]


def run(names: Sequence[str], runs: int) -> Results:
    """All rows; a line of progress each."""
    results = Results()
    for number, name in enumerate(names, 1):
        found = MEASUREMENTS[name]
        progress = f"[{number}/{len(names)}] {name}: {found.what} (about {found.seconds} s)"
        print(progress, end="", file=sys.stderr, flush=True)
        begin, load = time.monotonic(), os.getloadavg()[0]
        try:
            rows = measure(name, runs)
            loads = (round(load, 2), round(os.getloadavg()[0], 2))
            results.rows += [replace(row, load=loads) for row in rows]
            end = f"{time.monotonic() - begin:.0f} s"
        except NotHereError as reason:
            results.not_run[name], end = str(reason), "not run"
        except Exception as error:  # noqa: BLE001 whatever it is, the other rows are measured
            results.failures[name] = str(error) if isinstance(error, BenchError) else f"{type(error).__name__}: {error}"
            end = "failed"
        results.seconds[name] = round(time.monotonic() - begin, 1)
        print(f"  {end}", file=sys.stderr, flush=True)
    return results


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, write, compare."""
    arguments = parser().parse_args(argv)
    try:
        return _main(arguments)
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _main(arguments: argparse.Namespace) -> int:
    if arguments.into and not arguments.table:
        raise BenchError("--into needs --table FILE: the table of which run?")
    if arguments.table:
        text = figures.markdown(compare.load(arguments.table))
        print(text if not arguments.into else figures.put(text, arguments.into))
        return 0
    names = select(arguments.rows, arguments.all)
    if arguments.list:
        print("\n".join(_listed(names if arguments.rows else MEASUREMENTS)))
        print("* only with --all, or where it is named")
        return 0
    before = machine.describe()
    olds = [compare.load(path) for path in arguments.compare]
    warnings = compare.check_settings(olds, before)
    if arguments.runs < 1:
        raise BenchError(f"--runs {arguments.runs}: at least one is needed")
    if not arguments.out.resolve().parent.is_dir():
        raise BenchError(f"--out {arguments.out}: there is no such folder")
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    results = run(names, arguments.runs)
    after = machine.describe()
    print(table(results.rows))
    _say_of_the_machine(before, after)
    changes = _changes(olds, results, same_machine=not warnings)
    for change in changes:
        print(change.text())
    for name, reason in results.not_run.items():
        print(f"not run: {name}: {reason}")
    for name, reason in results.failures.items():
        print(f"error: {name}: {reason}", file=sys.stderr)
    body = {"machine": before, "load average after": after["load average"], "failures": results.failures}
    body |= {"not run": results.not_run, "seconds": results.seconds, "rows": [asdict(row) for row in results.rows]}
    arguments.out.write_text(json.dumps(body, indent=1) + "\n", encoding="utf-8")
    print(f"written to {arguments.out}")
    print(_last_line(results))
    return int(bool(results.failures) or any(change.verdict == "slower" for change in changes))


def _changes(olds: Sequence[compare.Bench], results: Results, *, same_machine: bool) -> list[compare.Change]:
    if not olds:
        return []
    old_rows = [old.rows for old in olds]
    changes = compare.compare(old_rows, results.rows, same_machine=same_machine)
    return changes + compare.vanished(old_rows, results.rows, results.measured())


def _say_of_the_machine(before: dict[str, Any], after: dict[str, Any]) -> None:
    loads = " then ".join(" ".join(map(str, found["load average"])) for found in (before, after))
    print(
        f"{before['processors usable']} processors ({before['processor']}), load {loads}, "
        f"RIG_REALTIME={before['RIG_REALTIME']}, commit {before['commit']}"
    )


def _last_line(results: Results) -> str:
    wanted = [row for row in results.rows if row.met is not None]
    missed = [row.name for row in wanted if not row.met]
    if not wanted:
        return "no figure is wanted of these rows"
    if not missed:
        return f"all {len(wanted)} wanted figures are met"
    return f"{len(missed)} of {len(wanted)} wanted figures missed: {', '.join(missed)}"


if __name__ == "__main__":
    sys.exit(main())
