"""`./rig faults`: the table of faults, run on a live graph."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

# Imported for the rows that they put into the table, in this order.
from rig_bringup.faults import inputs, nodes  # noqa: F401
from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.rows import ROWS, Row, run


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        "rig faults",
        description="Do each fault of docs/safety.md to a live graph of separate processes in real time, and see what "
        "follows. Beside the times to zero force stands the machine's stall: how late a sleep of a millisecond was, at "
        "worst, during the same waits. The code is 0 if every row does what it must.",
    )
    result.add_argument("rows", nargs="*", metavar="ROW", help="names, or beginnings of names; all if left out")
    result.add_argument("--list", action="store_true", help="say what the rows are, and do nothing")
    result.add_argument(
        "--repeats", type=int, default=1, metavar="N", help="injections of each row that is timed (%(default)s)"
    )
    result.add_argument(
        "--untimed", action="store_true", help="a force that becomes zero too late is shown, and is no failure"
    )
    result.add_argument("--out", type=Path, metavar="FILE", help="write the results as JSON")
    return result


def main(argv: Sequence[str]) -> int:
    """0 if all is as it must be, 1 if not, 2 for bad input."""
    options = parser().parse_args(argv)
    chosen = {name: row for name, row in ROWS.items() if not options.rows or name.startswith(tuple(options.rows))}
    if not chosen or options.repeats < 1:
        why = "--repeats must be at least 1" if chosen else f"no row begins with {', '.join(options.rows)}"
        print(f"error: {why}; rows: {', '.join(ROWS)}", file=sys.stderr)
        return 2
    if options.list:
        for name, row in chosen.items():
            print(f"{name:24} {row.fault}: {row.follows}")
        return 0
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        try:
            print("starting the graph", file=sys.stderr, flush=True)
            with LiveGraph(Path(folder)) as graph:
                print(_columns("row", "", ["n", "p50", "p99", "most"], "limit", "stall", "[ms to zero force]"))
                for name, row in chosen.items():
                    results[name] = _judge(graph, row, options)
                    print(_line(name, row, results[name]), flush=True)
        except FaultError as error:
            print(f"error: the graph does not go on: {error}", file=sys.stderr)
            return 1
    failed = [name for name, result in results.items() if not result["passed"]]
    print(f"{len(results) - len(failed)} of {len(results)} rows are as they must be")
    if options.out:
        options.out.write_text(json.dumps(results, indent=1) + "\n")
    return 1 if failed else 0


def _judge(graph: LiveGraph, row: Row, options: argparse.Namespace) -> dict[str, Any]:
    try:
        graph.stalls.clear()
        seen = run(graph, row, options.repeats)
    except FaultError as error:
        return {"passed": False, "zero": [], "stalls": [], "remark": str(error)}
    late = row.within is not None and float(np.percentile(seen.zero, 99)) > row.within
    return {
        "passed": options.untimed or not late,
        "late": late,
        "zero": seen.zero,
        "stalls": graph.stalls[:],
        "remark": seen.remark,
    }


def _line(name: str, row: Row, result: dict[str, Any]) -> str:
    zero = 1e3 * np.array(result["zero"])
    verdict = ("late" if result.get("late") else "ok") if result["passed"] or result.get("late") else "FAILED"
    figures = 4 * [""]
    if len(zero):
        figures = [str(len(zero)), *(f"{x:.1f}" for x in (*np.percentile(zero, [50, 99]), zero.max()))]
    limit = "" if row.within is None else f"{1e3 * row.within:.0f}"
    stall = f"{1e3 * max(result['stalls']):.1f}" if result["stalls"] else ""
    return _columns(name, verdict, figures, limit, stall, result["remark"] or row.follows)


def _columns(name: str, verdict: str, figures: list[str], limit: str, stall: str, remark: str) -> str:
    numbers = " ".join(f"{text:>8}" for text in (*figures[1:], limit, stall))
    return f"{name:24} {verdict:6} {figures[0]:>4} {numbers}   {remark}"
