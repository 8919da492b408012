"""Faults of the whole: a start-up that is interrupted at any moment, a second graph where there is one already."""

from __future__ import annotations

import random
import signal
import sys
import time
from pathlib import Path

from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.marked import Marked
from rig_bringup.faults.rows import Seen, expect_every_tick_once, expect_whole_bag, row

#: [s] What `./rig up` may take to end, and how long its trial would be.
_PATIENCE = 60.0
_DURATION = 3


@row("start/node interrupted", "SIGINT at a random moment of a node's start, five times", "it ends, and leaves nothing")
def _interrupted_node(graph: LiveGraph, _: int) -> Seen:
    moments = random.Random(7)
    for node in moments.choices(["task_sim", "mig_filter", "admittance_sim"], k=5):
        process = graph.start_process(node, node, "elsewhere")
        graph.ticks(moments.randrange(1, 200))
        graph.end(process)
        if left := process.left():
            raise FaultError(f"{node} has left processes behind: {left}")
    return Seen([])


@row(
    "start/interrupted",
    "SIGINT at a random moment of ./rig up, ten times or more",
    "it says so, code 130; no process is left, a bag that was begun is whole",
    on=None,
)
def _interrupted(folder: Path, repeats: int) -> Seen:
    moments, bags, slowest = random.Random(8), 0, 0.0
    count = max(10, min(repeats, 50))
    for k in range(count):
        run = folder / f"interrupted_{k}"
        # From the command on, and from when there is a bag on.
        after = moments.uniform(0.0, 2.0)
        with Marked(up(run, "--namespace", "interrupted"), folder / f"interrupted_{k}.log") as rig:
            if k % 2:
                rig.wait_for((run / "bag").exists, _PATIENCE)
            rig.wait_for(lambda: False, after)
            sent = time.monotonic()
            rig.signal(signal.SIGINT)
            code = rig.end(_PATIENCE)
            if left := rig.left(2.0):
                raise FaultError(f"interrupted at moment {k}, it left processes behind: {left}")
        slowest = max(slowest, time.monotonic() - sent)
        if code != 130:
            raise FaultError(f"interrupted at moment {k}, it returned {code}:\n{rig.words()}")
        if (run / "bag").exists():
            expect_whole_bag(run / "bag")
            bags += 1
    return Seen([], f"{count} starts, {bags} bags begun, all whole; ended within {slowest:.1f} s")


@row("graph/two in one namespace", "a second graph where there is one already", "refused in words; the first goes on")
def _second_graph(graph: LiveGraph, _: int) -> Seen:
    second = graph.start_process("task_sim", "task_sim", graph.namespace)
    try:
        graph.wait(lambda: second.exit_code is not None, "the second pacemaker has not ended", limit=30.0)
        if second.exit_code != 2 or "paces" not in second.last_words():
            raise FaultError(f"the second pacemaker ended with {second.exit_code}:\n{second.last_words()}")
    finally:
        graph.end(second)
    log = graph.folder / "second.log"
    with Marked(up(graph.folder / "second", "--namespace", graph.namespace), log) as rig:
        # The hand goes on meanwhile.
        graph.wait(lambda: rig.code is not None, "./rig up has not ended", limit=_PATIENCE)
        if rig.code != 2 or "paces" not in rig.words():
            raise FaultError(f"./rig up returned {rig.code}:\n{rig.words()}")
        said = rig.words().splitlines()[-1]
    graph.ticks(50)
    expect_every_tick_once(graph)
    return Seen([], said)


def up(out: Path, *more: str) -> list[str]:
    """The command line of a short trial in real time."""
    command = [sys.executable, "-m", "rig_bringup", "up", "--pacing", "realtime", "--duration", str(_DURATION)]
    return [*command, "--no-report", "--out", str(out), *more]
