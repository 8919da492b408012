"""`./rig faults`: the table of faults, run on a live graph."""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import numpy as np

# Imported for the rows that they put into the table, in this order.
from rig_bringup.faults import commands, inputs, machine, network, nodes, people, sessions, starts  # noqa: F401
from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.rows import ROWS, NotHereError, Row, Seen, run
from rig_bringup.interrupts import held_back, let_in
from rig_runtime.realtime import freeze_garbage


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
        "--repeats",
        type=int,
        default=1,
        metavar="N",
        help="injections of each row that is timed or kills (%(default)s; 50 kills at most)",
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
            print(f"{name:26} {row.fault}: {row.follows}")
        return 0
    print(_columns("row", "", ["n", "p50", "p99", "most"], "limit", "stall", "[ms to zero force]"), flush=True)
    results: dict[str, dict[str, Any]] = {}
    # In the order of the table, but all that is done to one kind of graph together.
    for kind in dict.fromkeys(row.on for row in chosen.values()):
        names = [name for name, row in chosen.items() if row.on is kind]
        results |= _in_own_process(names, options)
    failed = [name for name, result in results.items() if not result["passed"]]
    left_out = [name for name, result in results.items() if result.get("needs")]
    print(
        f"{len(results) - len(failed) - len(left_out)} of {len(results)} rows are as they must be"
        + (f", {len(left_out)} not run: {', '.join(left_out)}" if left_out else "")
    )
    if options.out:
        options.out.write_text(json.dumps(results, indent=1) + "\n")
    return 1 if failed else 0


def _in_own_process(names: list[str], options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Do rows of one kind of graph in a process of their own; a row that it did not come to has failed.

    The middleware keeps what it once knew of the network for as long as a process lives.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(there, names, options))
    done: dict[str, dict[str, Any]] = {}
    try:
        with held_back():
            process.start()
        there.close()
        # The last word is None; without it the process has ended before its end.
        with contextlib.suppress(EOFError, OSError):
            while (said := here.recv()) is not None:
                done |= said
            return done
    except KeyboardInterrupt:
        _end(process)
        raise
    finally:
        process.join()
    print("error: the process of these rows has ended too early", file=sys.stderr)
    for name in [name for name in names if name not in done] or [f"{names[0]} and what came with it"]:
        done[name] = {"passed": False, "zero": [], "stalls": [], "remark": "not done: what stands above ended it"}
        print(_columns(name, "FAILED", 4 * [""], "", "", done[name]["remark"]), flush=True)
    return done


def _end(process: SpawnProcess) -> None:
    """Have it end its graph and then itself, however long that takes; at once, if this is interrupted again."""
    try:
        while process.is_alive():
            # While a node is ended the signal is left aside.
            process.terminate()
            process.join(1.0)
    except KeyboardInterrupt:
        process.kill()
        raise


def _work(results: Connection, names: list[str], options: argparse.Namespace) -> None:
    told = threading.Event()

    def end(*_: object) -> None:
        if not told.is_set():
            told.set()
            raise KeyboardInterrupt

    # Ctrl-C reaches both processes, `kill` the other one alone: that one ends this one, in either case.
    signal.signal(signal.SIGINT, lambda *_: None)
    signal.signal(signal.SIGTERM, end)
    try:
        let_in()
        _do(results, names, options, told)
    except (KeyboardInterrupt, Exception):
        # The middleware makes an error of its own of an interrupt that comes while it converts a message.
        if not told.is_set():
            raise


def _do(results: Connection, names: list[str], options: argparse.Namespace, told: threading.Event) -> None:
    # A collection would hold up the hand in the middle of what it measures; `run` collects between rows.
    freeze_garbage()
    rows = {name: ROWS[name] for name in names}
    kind = rows[names[0]].on

    def show(name: str, row: Row, result: dict[str, Any]) -> None:
        results.send({name: result})
        print(_line(name, row, result), flush=True)
        # What a row does in the end may have failed, and put that in the place of the interrupt.
        if told.is_set():
            raise KeyboardInterrupt

    with tempfile.TemporaryDirectory() as folder:
        if kind is None:
            for name, row in rows.items():
                show(name, row, _judge(Path(folder), row, options))
        elif not _on_graph(kind, Path(folder) / kind.kind, rows, options, show):
            return
    results.send(None)


def _on_graph(
    kind: type[LiveGraph],
    folder: Path,
    rows: dict[str, Row],
    options: argparse.Namespace,
    show: Callable[[str, Row, dict[str, Any]], None],
) -> bool:
    """Do rows to one graph, and check its bag; False if the graph does not go on."""
    try:
        with kind(folder) as graph:
            for name, row in rows.items():
                show(name, row, _judge(graph, row, options))
            bag = Row("", "", lambda graph, _: Seen([], graph.close_bag()))
            show(f"{kind.kind}: the bag", bag, _judge(graph, bag, options))
    except NotHereError as lack:
        for name, row in rows.items():
            show(name, row, _left_out(lack))
    except FaultError as error:
        print(f"error: the {kind.kind} graph does not go on: {error}", file=sys.stderr)
        return False
    return True


def _left_out(lack: NotHereError) -> dict[str, Any]:
    return {"passed": True, "zero": [], "stalls": [], "needs": str(lack), "remark": str(lack)}


def _judge(at: LiveGraph | Path, row: Row, options: argparse.Namespace) -> dict[str, Any]:
    stalls: list[float] = []
    try:
        if isinstance(at, LiveGraph):
            at.stalls = stalls
            seen = run(at, row, options.repeats) if row.fault else row.inject(at, 1)
        else:
            seen = row.inject(at, options.repeats)
    except NotHereError as lack:
        return _left_out(lack)
    except FaultError as error:
        return {"passed": False, "zero": [], "stalls": stalls, "remark": str(error)}
    late = row.within is not None and float(np.percentile(seen.zero, 99)) > row.within
    return {
        "passed": options.untimed or not late,
        "late": late,
        "zero": seen.zero,
        "stalls": stalls,
        "remark": seen.remark,
    }


def _line(name: str, row: Row, result: dict[str, Any]) -> str:
    zero = 1e3 * np.array(result["zero"])
    verdict = "late" if result.get("late") else "ok" if result["passed"] else "FAILED"
    if result.get("needs"):
        verdict = "not run"
    figures = 4 * [""]
    if len(zero):
        figures = [str(len(zero)), *(f"{x:.1f}" for x in (*np.percentile(zero, [50, 99]), zero.max()))]
    limit = "" if row.within is None else f"{1e3 * row.within:.0f}"
    stall = f"{1e3 * max(result['stalls']):.1f}" if result["stalls"] else ""
    return _columns(name, verdict, figures, limit, stall, result["remark"] or row.follows)


def _columns(name: str, verdict: str, figures: list[str], limit: str, stall: str, remark: str) -> str:
    numbers = " ".join(f"{text:>8}" for text in (*figures[1:], limit, stall))
    return f"{name:26} {verdict:7} {figures[0]:>4} {numbers}   {remark}"
