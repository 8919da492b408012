"""Faults of the whole: a start-up that is interrupted at any moment, a second graph where there is one already."""

from __future__ import annotations

import random
import signal
import sys
import time
from pathlib import Path

from rig_bag import read
from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.marked import Marked
from rig_bringup.faults.people import PersonGraph, UserGraph, free_port
from rig_bringup.faults.rows import Seen, expect_every_tick_once, expect_whole_bag, row
from rig_bringup.faults.sessions import Session
from rig_runtime import topics

#: [s] What `./rig up` may take to end, and how long its trial would be.
_PATIENCE = 60.0
_DURATION = 3


#: Every process of a graph with a session: the nodes, and the conductor, which is the session's own.
_NODES = {**UserGraph.nodes, **PersonGraph.nodes}
_PROCESSES = (*_NODES, "conductor")

#: [s] What a node may take to end.
_ENDS = 20.0


def _start_of(process: str, graph: LiveGraph, k: int) -> list[str]:
    """The command that starts one of them, in another namespace."""
    if process == "conductor":
        return Session(graph.folder, f"start_{k}").command
    arguments = ["-r", "__ns:=/elsewhere", "-r", f"__node:={process}", "--params-file", str(graph.parameters)]
    more = {"recorder": f"uri:={graph.folder / f'start_{k}'}", "display": f"port:={free_port()}"}
    if process in more:
        arguments += ["-p", more[process]]
    return ["ros2", "run", *_NODES[process], "--ros-args", *arguments]


@row(
    "start/node interrupted",
    "SIGINT at a random moment of the start of each node, and of a conductor",
    "it ends by itself as one that was interrupted, and leaves nothing",
)
def _interrupted_node(graph: LiveGraph, repeats: int) -> Seen:
    moments, k, began = random.Random(7), 0, 0
    for k, process in enumerate(_PROCESSES * min(repeats, 50)):
        log = graph.folder / f"start_{k}.log"
        with Marked(_start_of(process, graph, k), log) as start:
            graph.ticks(moments.randrange(1, 200))
            start.signal(signal.SIGINT)
            graph.wait(lambda: start.code is not None, f"{process} does not end when it is interrupted", limit=_ENDS)
            # By itself: what is still there is not killed before it is looked for.
            if left := graph.meanwhile(lambda: start.left(2.0), "what is left has not been looked for"):
                raise FaultError(f"{process} has left processes behind: {left}\n{start.words()}")
        code = start.code
        # 0 from when it has its own handlers on; before that the interpreter says that it was interrupted.
        if code not in (0, 130, -signal.SIGINT) and not start.words().rstrip().endswith("KeyboardInterrupt"):
            raise FaultError(f"{process} was interrupted and returned {code}:\n{start.words()}")
        began += code == 0
    return Seen([], f"{k + 1} starts, {began} of which had begun to serve")


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


@row(
    "graph/two on one domain", "another graph beside it, under another namespace", "neither hears the other; both go on"
)
def _other_graph(graph: LiveGraph, _: int) -> Seen:
    out, topic = graph.folder / "other", f"/other/{topics.WRENCH.name}"
    graph.hand.forget()
    with Marked(up(out, "--namespace", "other"), graph.folder / "other.log") as rig:
        graph.wait(lambda: rig.code is not None, "the other graph has not ended", limit=_PATIENCE)
        if rig.code != 0:
            raise FaultError(f"the other graph returned {rig.code}:\n{rig.words()}")
    expect_every_tick_once(graph)
    ticks = len(graph.hand.decided)
    count = graph.meanwhile(lambda: expect_whole_bag(out / "bag"), "the other bag is still being verified")
    pushed = read(out / "bag", [topic])[topic]["wrench.force"][:, 0]
    if ours := set(pushed.tolist()) & {force for force, _ in graph.hand.account.pushed.values()}:
        raise FaultError(f"the other graph has heard what was pushed in this one: {sorted(ours)[:5]} N")
    return Seen([], f"{ticks} ticks meanwhile; the other: {len(pushed)} ticks, {count} messages in a whole bag")


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
