"""What became slower beyond noise from earlier runs of `./rig bench` to another."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rows import BenchError, Row, spread

#: By how much of itself a row's median moves between quiet hours of one machine while its code is the same: by the
#: beginning of its name. Rows that wall time paces, and starts of processes, move most.
FLOORS = {"memory": 0.02, "filter": 0.15, "loop.lockstep": 0.15, "lockstep": 0.15, "recorder": 0.15, "reader": 0.15}
_PACED = 0.5

#: How many OLD files say for themselves how much a row moves.
_ENOUGH_FILES = 3

RULE = (
    "A row has changed beyond noise if the median of its ratios to the baseline (of its values if it has no ratio) has "
    "moved by more than the largest of: the interquartile range over the runs, of the old and of the new; the range of "
    "its medians over the OLD files; and, unless these are three or more, what such a row moves by between quiet hours "
    f"of one machine: {100 * FLOORS['memory']:.0f} % of memory, {100 * FLOORS['filter']:.0f} % of what computes, "
    f"{100 * _PACED:.0f} % of what wall time paces and of starts. A single run is judged by that alone. A count "
    "of what should not be has changed if it differs by more than twice the square root of both counts together. "
    "Settings must be those of OLD; on another machine only ratios are judged."
)

#: What must be the same, and why the whole comparison says nothing if it is not.
_SETTINGS = ("RIG_REALTIME", "RIG_CPUS", "middleware")
_MACHINE = ("processor", "processors usable")


@dataclass(frozen=True)
class Change:
    """A row then and now."""

    name: str
    #: slower, faster, same, or why it is not judged.
    verdict: str
    old: float = math.nan
    new: float = math.nan
    noise: float = math.nan

    def text(self) -> str:
        """One line."""
        if self.verdict not in ("slower", "faster", "same"):
            return f"{self.name}: {self.verdict}"
        return f"{self.name}: {self.verdict}, {self.old:.3g} -> {self.new:.3g} (noise {self.noise:.2g})"


@dataclass(frozen=True)
class Bench:
    """What a run of `./rig bench` wrote."""

    path: Path
    rows: tuple[Row, ...]
    machine: Mapping[str, Any]
    body: Mapping[str, Any]


def load(path: Path) -> Bench:
    """A file that `./rig bench` wrote.

    Raises
    ------
    BenchError: missing, or not such a file.
    """
    try:
        body = json.loads(path.read_text(encoding="utf-8"))
        return Bench(path, tuple(map(Row.from_json, body["rows"])), dict(body["machine"]), body)
    except OSError as error:
        raise BenchError(f"{path}: {error.strerror}; name a file that ./rig bench wrote") from None
    except (ValueError, KeyError, TypeError):
        raise BenchError(f"{path} is no result of ./rig bench; name a file that it wrote with --out") from None


def check_settings(olds: Sequence[Bench], now: Mapping[str, Any]) -> list[str]:
    """In what the machine differs from that of the files, in words.

    Raises
    ------
    BenchError: the settings differ, so nothing can be compared.
    """
    for old in olds:
        for key in _SETTINGS:
            if old.machine.get(key) != now.get(key):
                raise BenchError(
                    f"{old.path} was measured with {key}={_said(old.machine, key)}, and now it is {_said(now, key)}: "
                    "measure with the same, or compare with another file"
                )
    return [
        f"{old.path} is of another machine ({key}: {_said(old.machine, key)}, now {_said(now, key)}): "
        "rows without a ratio are not judged"
        for old in olds
        for key in _MACHINE
        if old.machine.get(key) != now.get(key)
    ]


def _said(machine: Mapping[str, Any], key: str) -> str:
    return str(machine.get(key) or "nothing")


def compare(olds: Sequence[Sequence[Row]], new: Sequence[Row], *, same_machine: bool = True) -> list[Change]:
    """Each new row against those of the same name in each of the old runs."""
    return [_change([old for rows in olds for old in rows if old.name == row.name], row, same_machine) for row in new]


def vanished(olds: Sequence[Sequence[Row]], new: Sequence[Row], measured: Iterable[str]) -> list[Change]:
    """Rows that these measurements had in an old run and have no more."""
    there, measured = {row.name for row in new}, tuple(measured)
    gone = dict.fromkeys(row.name for rows in olds for row in rows if row.name not in there)
    return [
        Change(name, "has vanished: it was measured then")
        for name in gone
        if any(name == whole or name.startswith(f"{whole}.") for whole in measured)
    ]


def _change(olds: Sequence[Row], new: Row, same_machine: bool) -> Change:
    if not olds:
        return Change(new.name, "is new")
    if any(_kind(old) != _kind(new) for old in olds):
        return Change(new.name, "is measured in another way than it was")
    if new.ratio is None and not same_machine:
        return Change(new.name, "not judged: no ratio, and another machine")
    if new.counted:
        return _counted(olds, new)
    medians = [statistics.median(old.relative) for old in olds]
    before, after = statistics.median(medians), statistics.median(new.relative)
    noise = max(*(spread(row.relative) for row in (*olds, new)), max(medians) - min(medians))
    if len(olds) < _ENOUGH_FILES:
        noise = max(noise, _floor(new.name) * min(before, after))
    return Change(new.name, _verdict(before, after, noise, new.more_is_better), before, after, noise)


def _kind(row: Row) -> tuple[object, ...]:
    return row.unit, row.baseline, row.ratio is None, row.counted


def _floor(name: str) -> float:
    return next((share for beginning, share in FLOORS.items() if name.startswith(f"{beginning}.")), _PACED)


def _counted(olds: Sequence[Row], new: Row) -> Change:
    runs = len(new.values)
    before = runs * math.fsum(old.value for old in olds) / sum(len(old.values) for old in olds)
    noise = 2.0 * math.sqrt(abs(before) + abs(new.value))
    return Change(new.name, _verdict(before, new.value, noise, new.more_is_better), before, new.value, noise)


def _verdict(before: float, after: float, noise: float, more_is_better: bool) -> str:
    worse = before - after if more_is_better else after - before
    return "slower" if worse > noise else "faster" if -worse > noise else "same"
