"""A row of `./rig bench`: what was measured in each run, and its baseline in the same run."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


class BenchError(Exception):
    """A row cannot be measured; the message says why and what to do."""


class NotHereError(BenchError):
    """Nothing is wrong, but this machine lacks what the row needs."""


_WANTED = re.compile(r"(ratio|value) (<=|>=|<) (\S+)")


@dataclass(frozen=True)
class Row:
    """One quantity over several runs; `values[k]` and `baselines[k]` come from the same minute."""

    name: str
    what: str
    unit: str
    values: tuple[float, ...]
    baseline: str = ""
    baselines: tuple[float, ...] = ()
    #: Such as "ratio <= 1.2" or "value >= 25"; empty: no figure is wanted.
    wanted: str = ""
    more_is_better: bool = False
    #: Counts of what should not be: all runs together stand for the row, for a median forgets the worst two of five.
    counted: bool = False
    #: Load average before and after.
    load: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.values or len(self.baselines) not in (0, len(self.values)):
            raise ValueError(f"{self.name}: {len(self.values)} values beside {len(self.baselines)} of the baseline")
        if self.wanted and not _WANTED.fullmatch(self.wanted):
            raise ValueError(f"{self.name}: {self.wanted!r} is no wanted figure")

    @property
    def value(self) -> float:
        """Median of the values, or their sum where they are counts."""
        return math.fsum(self.values) if self.counted else statistics.median(self.values)

    @property
    def base(self) -> float:
        """The same of the baseline."""
        return math.fsum(self.baselines) if self.counted else statistics.median(self.baselines)

    @property
    def relative(self) -> tuple[float, ...]:
        """Value over baseline of each run; the values if they are counts, or have no baseline, or one of zero."""
        if self.counted or not self.baselines or min(self.baselines) <= 0.0:
            return self.values
        return tuple(value / base for value, base in zip(self.values, self.baselines, strict=True))

    @property
    def ratio(self) -> float | None:
        """Median of the runs' ratios, not the ratio of the medians; None without a baseline to divide by."""
        return None if self.relative is self.values else statistics.median(self.relative)

    @property
    def met(self) -> bool | None:
        """Whether the wanted figure is reached; None if none is wanted."""
        match = _WANTED.fullmatch(self.wanted)
        if match is None:
            return None
        found = self.value if match[1] == "value" else self.ratio
        limit = float(match[3])
        if found is None:
            return False
        return {"<=": found <= limit, ">=": found >= limit, "<": found < limit}[match[2]]

    @classmethod
    def from_json(cls, body: Mapping[str, Any]) -> Row:
        """As :func:`dataclasses.asdict` and JSON wrote it."""
        return cls(**{key: tuple(value) if isinstance(value, list) else value for key, value in body.items()})


def spread(values: Sequence[float]) -> float:
    """Interquartile range; 0 of a single value."""
    if len(values) < 2:
        return 0.0
    low, _, high = statistics.quantiles(values, n=4, method="inclusive")
    return high - low


def percentile(values: Sequence[float], share: float) -> float:
    """The value that this share of the others does not exceed."""
    return sorted(values)[min(int(share * len(values)), len(values) - 1)]


def alternate(runs: int, *calls: Callable[[], Any]) -> list[tuple[Any, ...]]:
    """What the calls return, one after the other, as often as there are runs: one tuple a call.

    All see the same load thereby. What goes first changes from run to run, so that none has always the warmer cache.
    """
    found: list[list[Any]] = [[] for _ in calls]
    for run in range(runs):
        for place in range(len(calls)):
            which = (place + run) % len(calls)
            found[which].append(calls[which]())
    return [tuple(results) for results in found]


HEADER = ("row", "this", "unit", "baseline", "ratio", "spread", "wanted")


def table(rows: Sequence[Row]) -> str:
    """Medians, of counts sums; the spread is the interquartile range of the ratios, or of values without a ratio."""
    lines = [HEADER, *map(_cells, rows)]
    widths = [max(len(line[place]) for line in lines) for place in range(len(HEADER))]
    text = []
    for line in lines:
        numbers = (cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))
        text.append("  ".join([line[0].ljust(widths[0]), *numbers]).rstrip())
    return "\n".join(text)


def _cells(row: Row) -> tuple[str, ...]:
    met = {None: "", True: " yes", False: " NO"}[row.met]
    return (
        row.name,
        f"{row.value:.4g}",
        row.unit,
        f"{row.base:.4g}" if row.baselines else "-",
        "-" if row.ratio is None else f"{row.ratio:.3g}",
        f"{spread(row.relative):.2g}",
        f"{row.wanted}{met}" or "-",
    )
