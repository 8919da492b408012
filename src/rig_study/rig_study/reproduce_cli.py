"""``reproduce``: every figure of ``docs/results.md`` measured again, and written into its tables."""

from __future__ import annotations

import argparse
import functools
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import rig_study
from rig_study.declared import StudyError
from rig_study.reproduce_study import MEASUREMENTS, Measurement, Options
from rig_study.results_page import Row, line, update
from rig_study.runs import digest, science
from shared_control import reproduce
from shared_control.parameters import ParameterError
from shared_control.scenario import find

__all__ = ["main", "measurements"]


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="./rig reproduce",
        description="Measure the paper's claims in full counts and write them into the tables of docs/results.md. What "
        "is measured stays in the folder: the same command goes on where it stopped.",
    )
    result.add_argument("names", nargs="*", metavar="NAME", help="names, or beginnings of names; all if left out")
    result.add_argument("--list", action="store_true", help="say which names there are")
    result.add_argument("--seeds", type=int, metavar="N", help="at most N trials of each; not for the page")
    result.add_argument("--workers", type=int, help="processes; as many as there are cores, if left out")
    result.add_argument("--out", type=Path, default=Path("runs/reproduce"), help="folder (%(default)s)")
    result.add_argument("--page", type=Path, help="whose tables are written (docs/results.md)")
    return result


def main(argv: Sequence[str]) -> int:
    """Returns 0, or 2 for bad input; 130 if interrupted, and then the same call goes on where it stopped."""
    options = parser().parse_args(argv)
    there = measurements()
    chosen = [name for name in there if not options.names or name.startswith(tuple(options.names))]
    if options.list:
        print("\n".join(chosen))
        return 0
    try:
        if not chosen:
            raise StudyError(f"nothing begins with {', '.join(options.names)}; there are: {', '.join(there)}")
        if options.seeds is not None and options.seeds < 1:
            raise StudyError(f"seeds: {options.seeds} is not allowed; it must be at least 1")
        left = {measurement.table for name, measurement in there.items() if name not in chosen}
        _measure({name: there[name] for name in chosen}, options, left)
    except ParameterError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


def measurements() -> dict[str, Measurement]:
    """Everything, by name: the claims of the science, then the study and the figures."""
    claims = {
        name: Measurement("map" if name.startswith("map/") else "claims", functools.partial(_claim, name))
        for name in reproduce.CLAIMS
    }
    return {**claims, **MEASUREMENTS}


def _claim(name: str, options: Options) -> list[Row]:
    claim = reproduce.CLAIMS[name]
    measured = reproduce.measure(claim, options.trials, options.workers)
    changes = [f"{key}: {value}" for values in claim.changes.values() for key, value in values.items()]
    what = ", ".join(f"`{part}`" for part in (claim.base, *changes))
    seeds = f"{options.at_most(claim.seeds):,} seeds from {reproduce.FIRST_SEED}"
    return [(name, claim.wanted, measured, f"{what}; {seeds}")]


def _measure(chosen: dict[str, Measurement], options: argparse.Namespace, left: set[str]) -> None:
    """``left``: tables that have rows besides."""
    folder = options.out if options.seeds is None else options.out / f"first_{options.seeds}"
    settings = Options(folder, options.seeds, options.workers)
    journal = folder / "journal.jsonl"
    folder.mkdir(parents=True, exist_ok=True)
    done, tables = _read(journal), dict[str, list[Row]]()
    begin = time.monotonic()
    for number, (name, measurement) in enumerate(chosen.items(), 1):
        key = f"{name}:{_sources(name in MEASUREMENTS)}"
        if key in done:
            rows, took = done[key], "measured before"
        else:
            print(f"[{number}/{len(chosen)}] {name} ...", file=sys.stderr, flush=True)
            since = time.monotonic()
            rows = measurement.rows(settings)
            took = f"{time.monotonic() - since:.0f} s"
            with journal.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key, "rows": rows}) + "\n")
        print(f"[{number}/{len(chosen)}] {name}: {took}", *map(line, rows), sep="\n", flush=True)
        if measurement.table:
            tables.setdefault(measurement.table, []).extend(rows)
    print(f"{len(chosen)} measured in {time.monotonic() - begin:.0f} s; tables and figures of each run: {folder}")
    if options.seeds is None:
        page = options.page or Path(os.environ.get("RIG_ROOT", ".")) / "docs" / "results.md"
        update(page, tables, whole=tables.keys() - left)
        print(f"written: {page}")


def _read(journal: Path) -> dict[str, list[Row]]:
    """What is there; a line that a kill cut off is nothing."""
    found: dict[str, list[Row]] = {}
    if journal.exists():
        data = journal.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) != len(data):
            journal.write_bytes(whole)
        for text in whole.splitlines():
            entry = json.loads(text)
            found[entry["key"]] = [tuple(row) for row in entry["rows"]]
    return found


@functools.cache
def _sources(study: bool) -> str:
    """Of all that a figure depends on: the science, the configuration, and this package where it is one of a study."""
    package, config = Path(rig_study.__file__).parent, find(reproduce.CLAIMS["cart/noise/off"].base).parent
    parts = [science(), digest(config.rglob("*.yaml"), config)]
    parts += [digest(package.rglob("*.py"), package)] if study else []
    return "".join(part[:8] for part in parts)
