"""What a row of the table of faults is, and how one is run.

The rows are in `inputs`, `nodes`, `machine`, `network`, `people` and `starts`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rig_bag import BagError
from rig_bag.verify import verify
from rig_bringup.faults.hand import PUSH
from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_runtime.realtime import collect_garbage
from shared_control.filter import Reason

__all__ = [
    "LIMIT",
    "ROWS",
    "Inject",
    "NotHereError",
    "Row",
    "Seen",
    "expect_every_tick_once",
    "expect_reason",
    "expect_whole_bag",
    "row",
    "run",
]

#: [s] From any loss to zero force: `command_timeout` and one tick.
LIMIT = 0.05 + 0.01


class Seen(NamedTuple):
    """What followed: how long after each injection the force was zero [s], and a remark."""

    zero: list[float]
    remark: str = ""


class NotHereError(Exception):
    """A fault that cannot be done on this machine; the message says what that needs."""


#: Does a fault so many times to a graph (or, with none, in a folder), sees what follows, and raises :class:`FaultError`
#: if that is not what must follow.
Inject = Callable[[Any, int], Seen]


class Row(NamedTuple):
    """One line of the table."""

    fault: str
    follows: str  # what must follow, in words
    inject: Inject
    #: [s] From the loss to zero force; None where no force is to become zero.
    within: float | None = None
    #: The kind of graph that it is done to; None: it starts its own.
    on: type[LiveGraph] | None = LiveGraph


#: By name, in the order in which they are run.
ROWS: dict[str, Row] = {}


def row(
    name: str, fault: str, follows: str, within: float | None = None, on: type[LiveGraph] | None = LiveGraph
) -> Callable[[Inject], Inject]:
    """Put an injection into the table."""

    def add(inject: Inject) -> Inject:
        ROWS[name] = Row(fault, follows, inject, within, on)
        return inject

    return add


def run(graph: LiveGraph, row: Row, repeats: int) -> Seen:
    """Do one row on a graph that flows, and leave it flowing.

    Raises
    ------
    FaultError: what must follow did not, or a force that is not the good hand's went through.
    NotHereError: it cannot be done on this machine.
    """
    graph.recover()
    graph.hand.forget()
    # Collecting what the row before left takes as long as several ticks, and so does judging it; the hand is deaf
    # meanwhile, and what it has to catch up on is no time of this row: some ten ticks that come at once.
    collect_garbage()
    graph.ticks(30)
    seen = row.inject(graph, repeats)
    through = graph.hand.commanded | {heard.force for heard in graph.hand.motions}
    if through := {force for force in through if not math.isfinite(force) or abs(force) not in (0.0, PUSH)}:
        raise FaultError(f"raw input went through: {sorted(through)} N")
    graph.recover()
    return seen


def expect_reason(graph: LiveGraph, reason: Reason) -> None:
    """One of these reasons was given.

    Raises
    ------
    FaultError: it was not.
    """
    seen = set(graph.hand.reasons.values())
    if reason not in seen:
        names = ", ".join(Reason(number).name.lower() for number in sorted(seen))
        raise FaultError(f"no decision gave the reason {reason.name.lower()}; there were {names}")


def expect_every_tick_once(graph: LiveGraph) -> None:
    """The filter decided each tick, and none twice.

    Raises
    ------
    FaultError: it did not.
    """
    decided = graph.hand.decided
    if not decided:
        raise FaultError("no decision has come")
    ticks = range(min(decided), max(decided) + 1)
    if missing := [tick for tick in ticks if decided[tick] == 0]:
        raise FaultError(f"{len(missing)} ticks have no decision, the first is {missing[0]}")
    if twice := [tick for tick in ticks if decided[tick] > 1]:
        raise FaultError(f"{len(twice)} ticks were decided twice, the first is {twice[0]}")


def expect_whole_bag(bag: Path, *, every_tick: bool = True) -> int:
    """A bag is undamaged and what it says it is, and lacks no tick; returns how many messages it holds.

    Raises
    ------
    FaultError: it is not.
    """
    try:
        found = verify(bag)
    except BagError as error:
        raise FaultError(f"the bag cannot be read: {error}") from error
    checks = [check for check in found.checks if every_tick or check.name != "ticks"]
    if problems := [f"{check.name}: {check.problems[0]}" for check in checks if check.problems]:
        raise FaultError(f"the bag {bag.name} is not as it should be: {'; '.join(problems)}")
    return sum(found.counts.values())
