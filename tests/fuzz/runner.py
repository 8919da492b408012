"""Runs boundaries over inputs, counts what became of them, and keeps what must not have happened."""

from __future__ import annotations

import signal
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from fuzz.boundary import Boundary
from fuzz.garbage import Garbage

__all__ = ["Hang", "Outcome", "run", "table"]

#: [s] An input that takes longer hangs; the first one of all imports libraries, on a busy machine for half a minute.
LIMIT = 60.0


class Hang(Exception):  # noqa: N818 an event, not a mistake
    """An input took longer than it may."""


@dataclass
class Outcome:
    """What became of the inputs of a boundary."""

    boundary: str
    counts: Counter[str] = field(default_factory=Counter)
    #: Number of the input and what it did, for each that did what it must not.
    crashes: list[tuple[int, str]] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def inputs(self) -> int:
        """How many there were."""
        return self.counts.total() + len(self.crashes)


@contextmanager
def _limited() -> Iterator[None]:
    def hang(*_: object) -> None:
        raise Hang(f"no answer within {LIMIT:g} s")

    before = signal.signal(signal.SIGALRM, hang)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def run(
    kind: type[Boundary],
    inputs: Sequence[int],
    seed: int,
    progress: Callable[[Outcome], None] = lambda _: None,
    most: int = 20,
) -> Outcome:
    """Send a boundary the inputs of these numbers; gives up after `most` crashes. A crash takes a new boundary."""
    outcome = Outcome(kind.name)
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="rig-fuzz-") as folder:
        boundary: Boundary | None = None
        for number in inputs:
            try:
                with _limited():
                    if boundary is None:
                        boundary = kind(Path(tempfile.mkdtemp(dir=folder)))
                    outcome.counts[boundary.send(Garbage(f"{seed}/{kind.name}/{number}"))] += 1
            except Exception:  # noqa: BLE001 whatever it is, it is what is looked for
                outcome.crashes.append((number, traceback.format_exc()))
                _end(boundary, outcome, number)
                boundary = None
                if len(outcome.crashes) >= most:
                    break
            outcome.seconds = time.monotonic() - begin
            progress(outcome)
        if boundary is not None:
            _end(boundary, outcome, inputs[-1])
    outcome.seconds = time.monotonic() - begin
    return outcome


def _end(boundary: Boundary | None, outcome: Outcome, number: int) -> None:
    if boundary is None:
        return
    try:
        with _limited():
            boundary.finish()
    except Exception:  # noqa: BLE001
        outcome.crashes.append((number, "afterwards: " + traceback.format_exc()))


def table(outcomes: Sequence[Outcome]) -> str:
    """For a person."""
    head = f"{'boundary':24} {'inputs':>8} {'refused':>8} {'accepted':>9} {'crashes':>8} {'s':>6}"
    rows = [
        f"{o.boundary:24} {o.inputs:8} {o.counts['refused']:8} {o.counts['accepted']:9} {len(o.crashes):8} "
        f"{o.seconds:6.0f}"
        for o in outcomes
    ]
    total = (
        f"{'all':24} {sum(o.inputs for o in outcomes):8} {sum(o.counts['refused'] for o in outcomes):8} "
        f"{sum(o.counts['accepted'] for o in outcomes):9} {sum(len(o.crashes) for o in outcomes):8} "
        f"{sum(o.seconds for o in outcomes):6.0f}"
    )
    return "\n".join([head, *rows, total])
