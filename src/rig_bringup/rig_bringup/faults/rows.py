"""What a row of the table of faults is, and how one is run.

The rows are in `commands`, `inputs`, `nodes`, `machine`, `network`, `people`, `sessions` and `starts`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rig_bag import BagError
from rig_bag.verify import verify
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
    "in_every_mode",
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
    FaultError: what must follow did not, or a force was admitted for a tick that was not what the good hand pushed in
    that tick, or what the filter says that its controller put in the place of that.
    NotHereError: it cannot be done on this machine.
    """
    graph.ready()
    graph.hand.forget()
    graph.hand.account.begin()
    # Collecting what the row before left takes as long as several ticks, and so does judging it; the hand is deaf
    # meanwhile, and what it has to catch up on is no time of this row: some ten ticks that come at once.
    collect_garbage()
    graph.ticks(30)
    seen = row.inject(graph, repeats)
    # By then the decisions have come of all that was admitted.
    graph.recover()
    if wrong := graph.hand.account.wrong():
        forces = ", ".join(f"{force:g}" for _, force in wrong[:5])
        raise FaultError(f"raw input went through: {forces} N, in {len(wrong)} commands or motions")
    return seen


#: By mode, the threshold under which a good force passes as it is, is accepted, is replaced by the controller's.
_MODES = {"off": 0.0, "training": 1e9, "assistance": -1e9}


def in_every_mode(inject: Inject) -> Inject:
    """The same with the filter off, in training and in assistance, in each of them its share of the injections."""

    def inject_in_each(graph: LiveGraph, repeats: int) -> Seen:
        zero: list[float] = []
        remark = ""
        for mode, threshold in _MODES.items():
            graph.judge(mode, threshold)
            graph.recover()
            graph.hand.motions.clear()
            seen = inject(graph, -(-repeats // len(_MODES)))
            zero, remark = zero + seen.zero, seen.remark
            graph.recover()
        return Seen(zero, f"in three modes{'; ' if remark else ''}{remark}")

    return inject_in_each


def expect_reason(graph: LiveGraph, reason: Reason) -> int:
    """Each decision on a tick without a good force gives this reason; returns how many there are.

    A wrench that is late besides may be called stale, but not most of them.

    Raises
    ------
    FaultError: there is none, or it gives another reason.
    """
    given = Counter(graph.hand.account.reasons().values())
    if not given[reason] or given[Reason.STALE_WRENCH] > given[reason] or set(given) - {reason, Reason.STALE_WRENCH}:
        told = ", ".join(f"{count} of {which.name.lower()}" for which, count in given.items()) or "none"
        raise FaultError(
            f"the decisions without a good force must give the reason {reason.name.lower()}; there is {told}"
        )
    return given[reason]


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
