"""What became slower beyond noise from one run of `./rig bench` to another."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rows import BenchError, Row, spread

RULE = (
    "A row has changed beyond noise if the median of its ratio to the baseline (of its value, where it has no "
    "baseline) has moved by more than the interquartile range over the runs, of both the old and the new. Rows with "
    "fewer than three runs in either are not judged."
)

_LEAST_RUNS = 3


@dataclass(frozen=True)
class Change:
    """A row then and now."""

    row: Row
    #: slower, faster, same, or why it is not judged.
    verdict: str
    old: float = float("nan")
    new: float = float("nan")
    noise: float = float("nan")

    def text(self) -> str:
        """One line."""
        if self.verdict not in ("slower", "faster", "same"):
            return f"{self.row.name}: {self.verdict}"
        return f"{self.row.name}: {self.verdict}, {self.old:.3g} -> {self.new:.3g} (noise {self.noise:.2g})"


def compare(old: Sequence[Row], new: Sequence[Row]) -> list[Change]:
    """Each new row against the old one of the same name."""
    known = {row.name: row for row in old}
    return [_change(known.get(row.name), row) for row in new]


def _change(old: Row | None, new: Row) -> Change:
    if old is None:
        return Change(new, "is new")
    if old.unit != new.unit or old.baseline != new.baseline or (old.ratio is None) != (new.ratio is None):
        return Change(new, "is measured in another way than it was")
    if min(len(old.values), len(new.values)) < _LEAST_RUNS:
        return Change(new, f"not judged: fewer than {_LEAST_RUNS} runs")
    before, after = statistics.median(old.relative), statistics.median(new.relative)
    noise = max(spread(old.relative), spread(new.relative))
    worse = before - after if new.more_is_better else after - before
    verdict = "slower" if worse > noise else "faster" if -worse > noise else "same"
    return Change(new, verdict, before, after, noise)


def load_rows(path: Path) -> list[Row]:
    """The rows of a file that `./rig bench` wrote.

    Raises
    ------
    BenchError: missing, or not such a file.
    """
    try:
        return [Row.from_json(body) for body in json.loads(path.read_text(encoding="utf-8"))["rows"]]
    except OSError as error:
        raise BenchError(f"{path}: {error.strerror}; name a file that ./rig bench wrote") from None
    except (ValueError, KeyError, TypeError):
        raise BenchError(f"{path} is no result of ./rig bench; name a file that it wrote with --out") from None
