"""``analyze``: bags, or the tables of simulated runs, to tables, statistics, figures and one report."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rig_study import study_statistics, tables
from rig_study.commands import carry_out
from rig_study.declared import StudyError

__all__ = ["analyze", "main"]


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="./rig analyze",
        description="From bags, or the tables of simulated runs, to trials.parquet, subjects.parquet, statistics.json, "
        "figures (SVG, PNG) and one self-contained report.html.",
        epilog=tables.RULE,
    )
    result.add_argument(
        "inputs", type=Path, nargs="+", metavar="DIR|BAG", help="bags, folders of bags, folders of runs"
    )
    result.add_argument("--out", type=Path, required=True, help="folder for the results")
    result.add_argument("--sets", nargs=2, metavar="SET", help="before and after (first and last by name, if left out)")
    return result


def main(argv: Sequence[str]) -> int:
    """Returns 0; 1 if no trial could be used; 2 for bad input."""
    options = parser().parse_args(argv)
    return carry_out(lambda: analyze(options.inputs, options.out, tuple(options.sets) if options.sets else None))


def analyze(inputs: Sequence[Path], out: Path, sets: tuple[str, str] | None = None) -> int:
    """Write everything into ``out``. Returns 0, or 1 if no trial could be used.

    Raises
    ------
    StudyError: as :func:`rig_study.tables.read`, or ``out`` cannot be written. StatisticsError: fewer than two sets.
    """
    gathered = tables.read(inputs)
    for name, why in gathered.left_out:
        print(f"left out: {name}: {why}", file=sys.stderr)
    if gathered.trials.empty:
        print(f"error: none of {len(gathered.left_out)} trials could be used", file=sys.stderr)
        return 1
    try:
        page = _write(gathered, out, sets)
    except OSError as error:
        raise StudyError(f"{out}: {error.strerror or error}") from None
    print(f"{len(gathered.trials)} trials, {len(gathered.left_out)} left out: {page}")
    return 0


def _write(gathered: tables.Gathered, out: Path, sets: tuple[str, str] | None) -> Path:
    from rig_study.study_report import write

    out.mkdir(parents=True, exist_ok=True)
    trials = gathered.trials
    trials.to_parquet(out / "trials.parquet", index=False)
    found: dict[str, object] = {"trials": len(trials), "rule": tables.RULE, "left_out": gathered.left_out}
    if "subject" in trials and trials["subject"].notna().all():
        tables.subjects(trials).to_parquet(out / "subjects.parquet", index=False)
        found["study"] = study_statistics.compute(trials, sets or study_statistics.outer_sets(trials))
    text = json.dumps(study_statistics.finite(found), indent=1, allow_nan=False)
    (out / "statistics.json").write_text(text + "\n", encoding="utf-8")
    return write(gathered, json.loads(text), out)
