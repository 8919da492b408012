"""``reproduce``: every figure of ``docs/results.md`` measured again, and written into its tables.

All trials of all measurements are one list for one pool of processes, so none of them waits for another's last trial.
The first trial of each comes first: a scenario that fails does so at once, and how long the rest takes is known from
then on. What is finished is in a journal (:mod:`rig_study.runs`), from which the same command goes on.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rig_study.commands import carry_out
from rig_study.declared import StudyError
from rig_study.measurements import Measurement, Options, measurements
from rig_study.progress import bar, clear
from rig_study.results_page import Row, line, update
from rig_study.runs import Finished, Job, finished, processes
from rig_study.runs import Row as Trial

__all__ = ["main"]


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
    return carry_out(lambda: _reproduce(options), resumes=True)


def _reproduce(options: argparse.Namespace) -> int:
    there = measurements()
    chosen = {name: there[name] for name in there if not options.names or name.startswith(tuple(options.names))}
    if not chosen:
        raise StudyError(f"nothing begins with {', '.join(options.names)}; there are: {', '.join(there)}")
    if options.list:
        print("\n".join(chosen))
        return 0
    if options.seeds is not None and options.seeds < 1:
        raise StudyError(f"seeds: {options.seeds} is not allowed; it must be at least 1")
    folder = options.out if options.seeds is None else options.out / f"first_{options.seeds}"
    work = _Work(chosen, Options(folder, options.seeds), processes(options.workers))
    begin, rows_of = time.monotonic(), dict[str, list[Row]]()
    for number, (name, rows) in enumerate(work.measure(options.out / "trials"), 1):
        took = f"{len(work.keys[name]):,} trials, which took {work.seconds[name]:.1f} s"
        print(f"[{number}/{len(chosen)}] {name}: {took}", *map(line, rows), sep="\n", flush=True)
        rows_of[name] = rows
    took = f"{time.monotonic() - begin:.0f} s, of {len(work.jobs):,} trials {work.before:,} were there"
    print(f"{len(chosen)} measured in {took}; tables and figures of each run: {folder}")
    if options.seeds is None:
        page = options.page or Path(os.environ.get("RIG_ROOT", ".")) / "docs" / "results.md"
        tables: dict[str, list[Row]] = {}
        # They finish in any order; the page has them in its own.
        for name, measurement in chosen.items():
            tables.setdefault(measurement.table, []).extend(rows_of[name])
        tables.pop("", None)
        left = {measurement.table for name, measurement in there.items() if name not in chosen}
        update(page, tables, whole=tables.keys() - left)
        print(f"written: {page}")
    return 0


class _Work:
    """The trials of some measurements, each once, and what is known of how long they take."""

    def __init__(self, chosen: Mapping[str, Measurement], options: Options, workers: int) -> None:
        self._chosen, self._options, self._workers = chosen, options, workers
        self.jobs: dict[str, Job] = {}
        self.keys: dict[str, list[str]] = {}
        #: Who needs a trial; the first of them answers for its time.
        self._needed_by: dict[str, list[str]] = {}
        for name, measurement in chosen.items():
            its = {job.key: job for job in measurement.jobs(options)}
            self.jobs |= its
            self.keys[name] = list(its)
            for key in its:
                self._needed_by.setdefault(key, []).append(name)
        self._missing = {name: len(keys) for name, keys in self.keys.items()}
        self._rows: dict[str, Trial] = {}
        self._left, self._known = (dict.fromkeys(chosen, 0) for _ in range(2))
        for names in self._needed_by.values():
            self._left[names[0]] += 1
        self.seconds = dict.fromkeys(chosen, 0.0)
        self.before = 0

    def measure(self, journal: Path) -> Iterator[tuple[str, list[Row]]]:
        """The rows of each measurement, as soon as its last trial is there."""
        first = [keys[0] for keys in self.keys.values() if keys]
        order = [self.jobs[key] for key in dict.fromkeys([*first, *self.jobs])]
        with contextlib.closing(finished(order, journal, workers=self._workers)) as results:
            for done, result in enumerate(results, 1):
                for name in self._take(result):
                    clear()
                    yield name, self._rows_of(name)
                if not result.before:
                    bar("reproduce", done, len(order), self._time_left())
        for name, keys in self.keys.items():
            if not keys:
                yield name, self._rows_of(name)

    def _take(self, result: Finished) -> list[str]:
        """Note a trial; the measurements that now have all of theirs."""
        self._rows[result.key] = result.row
        names = self._needed_by[result.key]
        self._left[names[0]] -= 1
        self._known[names[0]] += 1
        self.seconds[names[0]] += result.seconds
        self.before += result.before
        for name in names:
            self._missing[name] -= 1
        return [name for name in names if not self._missing[name]]

    def _rows_of(self, name: str) -> list[Row]:
        return self._chosen[name].rows(self._options, [self._rows[key] for key in self.keys[name]])

    def _time_left(self) -> float:
        """[s] What is missing, at the mean of its measurement so far, on all processes."""
        mean = sum(self.seconds.values()) / max(1, len(self._rows))
        times = (
            left * (self.seconds[name] / self._known[name] if self._known[name] else mean)
            for name, left in self._left.items()
        )
        return sum(times) / self._workers
