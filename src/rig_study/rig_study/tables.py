"""Tables of trials and of subjects, from bags or from the tables of simulated runs.

A trial is used if its bag can be read to its end, holds a task with measures, ran to its end, and has every tick that
was planned with its state and decision. Any other is left out, and listed with the reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rig_bag import BagError
from rig_study.declared import StudyError
from rig_study.recorded import MODES, PHASES, TrialError, load, measured
from shared_control.scenario import ScenarioError

__all__ = ["RULE", "Gathered", "find_bags", "read", "subjects"]

RULE = (
    "A trial is used if its bag can be read to its end, holds a task with measures, ran to its end, and has every "
    "planned tick with its state and its decision. Any other is left out. Of a trial that was repeated, the last such "
    "attempt is used."
)
#: What a mean over trials is taken of; success becomes the rate.
_NOT_MEASURES = frozenset(
    ("name", "subject", "group", "set", "trial", "attempt", "position", "mode", "task", "seed", "outcome", "source")
)


@dataclass
class Gathered:
    """Trials, one a row, and what was left out: its name and why."""

    trials: pd.DataFrame
    left_out: list[tuple[str, str]] = field(default_factory=list)
    bags: dict[str, Path] = field(default_factory=dict)


def find_bags(path: Path) -> Iterator[Path]:
    """Bags at a path or anywhere below, in the order of their paths."""
    if path.is_file():
        if path.suffix == ".mcap":
            yield path
        return
    files = sorted(path.rglob("*.mcap"))
    # A folder that holds a file of messages is a bag, closed or cut.
    yield from dict.fromkeys(file.parent for file in files)


def read(paths: Sequence[Path]) -> Gathered:
    """Everything that is found at the paths: ``trials.parquet`` of a run, or bags.

    Raises
    ------
    StudyError: a path is not there, holds neither, or a trial is there twice.
    """
    tables: list[pd.DataFrame] = []
    result = Gathered(pd.DataFrame())
    rows: list[dict[str, Any]] = []
    for path in paths:
        if not path.exists():
            raise StudyError(f"{path}: there is no such file or folder")
        table = path / "trials.parquet" if path.is_dir() else path
        if table.suffix == ".parquet" and table.is_file():
            tables.append(_table(table))
            continue
        found = list(find_bags(path))
        if not found:
            raise StudyError(f"{path}: holds neither trials.parquet nor a bag")
        for bag in found:
            name = _name(bag, path)
            try:
                row = _row(bag, name)
            except (BagError, TrialError, ScenarioError) as error:
                # A report says the same wherever the bags are.
                why = str(error).replace(str(bag.resolve()), name).replace(str(bag), name)
                result.left_out.append((name, why))
                continue
            rows.append(row)
            result.bags[name] = bag
    if rows:
        tables.append(pd.DataFrame(_last_attempts(rows, result.left_out)))
    if tables:
        result.trials = pd.concat(tables, ignore_index=True)
        twice = result.trials["name"][result.trials["name"].duplicated()]
        if len(twice):
            raise StudyError(f"trial {twice.iloc[0]} is there twice; name each input once")
    return result


def _last_attempts(rows: list[dict[str, Any]], left_out: list[tuple[str, str]]) -> list[dict[str, Any]]:
    """Of each subject's trial, the last attempt."""
    last: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in sorted(rows, key=lambda row: (row["attempt"], row["name"])):
        key = (row["subject"], row["set"], row["trial"]) if row.get("subject") else (row["name"],)
        if key in last:
            left_out.append((last[key]["name"], f"done again as {row['name']}"))
        last[key] = row
    kept = {row["name"] for row in last.values()}
    return [row for row in rows if row["name"] in kept]


def _attempt(name: str) -> int:
    """Where nobody counted, as in older bags: as the recorder numbered them at the end of the bag's name."""
    found = re.search(r"_a(\d+)$", name)
    return int(found[1]) if found else 1


def _table(path: Path) -> pd.DataFrame:
    try:
        return pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise StudyError(f"{path}: not a table of trials: {error}") from None


def _name(bag: Path, root: Path) -> str:
    parent = bag.parent.name if bag.name == "bag" else bag.stem if bag.is_file() else bag.name
    return parent or root.name


def _row(bag: Path, name: str) -> dict[str, Any]:
    trial = load(bag)
    state = trial.trial
    if PHASES[state.phase] != "finished":
        raise TrialError(f"not run to its end: {PHASES[state.phase]}, {state.message}")
    planned = int(state.ticks_planned)
    if trial.ticks_recorded < planned:
        raise TrialError(f"{planned - trial.ticks_recorded} of {planned} ticks lack state or decision")
    found = measured(trial)
    if found is None:
        raise TrialError(f"task {state.task} has no measures")
    modes = dict.fromkeys(MODES[mode] for mode in trial.mode)
    who = {"subject": state.subject, "group": state.group, "set": state.set} if state.subject else {}
    return {
        "name": name,
        **who,
        "trial": int(state.trial),
        "attempt": int(getattr(state, "attempt", 0)) or _attempt(name),
        "mode": " then ".join(modes),
        "task": state.task,
        "scenario": state.scenario,
        "seed": int(state.seed),
        "duration": planned * trial.sample_time,
        "intervened": float(np.mean(trial.verdict != 0)),
        "missed_deadlines": int(state.missed_deadlines),
        **found._asdict(),
    }


def subjects(trials: pd.DataFrame) -> pd.DataFrame:
    """Means of each subject in each set; ``success`` becomes ``success_rate``.

    Raises
    ------
    StudyError: the trials are of no subjects.
    """
    for column in ("subject", "group", "set"):
        if column not in trials:
            raise StudyError(f"the trials have no column {column}: they are of no study")
    measures = [
        column
        for column in trials.columns
        if column not in _NOT_MEASURES and pd.api.types.is_numeric_dtype(trials[column])
    ]
    keys = ["subject", "group", "set"]
    means = trials.astype(dict.fromkeys(measures, float)).groupby(keys, sort=True)[measures].mean()
    counts = trials.groupby(keys, sort=True).size().rename("trials")
    return pd.concat([counts, means], axis=1).rename(columns={"success": "success_rate"}).reset_index()
