"""Many headless trials, on a process pool or on Dask: the same table whatever ran it and however often it stopped.

A finished trial is a line of ``journal.jsonl`` in the folder of the run, keyed by its name and a hash of everything
that it depends on: scenario, seed, what is kept of it, and the sources of the science. What is there when a run begins
is not run again; a line that was cut off by a kill is dropped. When all trials are there, the table is written in their
order.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import shared_control
from rig_study.declared import StudyError
from shared_control.filter import Verdict
from shared_control.scenario import Scenario
from shared_control.trial import run_trial, wanted_speed

__all__ = ["Job", "digest", "progress", "run", "run_job", "science", "write_table"]

Row = dict[str, Any]


def digest(files: Iterable[Path], root: Path) -> str:
    """SHA-256 over the names below ``root`` and the contents of files, in hexadecimal."""
    found = hashlib.sha256()
    for path in sorted(files):
        found.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


@functools.cache
def science() -> str:
    """Of the sources that a headless trial runs: a result of other code is not the result."""
    root = Path(shared_control.__file__).parent
    return digest(root.rglob("*.py"), root)


@dataclass(frozen=True)
class Job:
    """One trial to run, and the columns that say which it is."""

    name: str
    scenario: Scenario
    seed: int
    labels: Mapping[str, Any] = field(default_factory=dict)
    trace: int = 0  # keep the state of each so many ticks; 0: of none

    @property
    def key(self) -> str:
        """Name and hash of all that the result depends on."""
        parts = {part: dataclasses.asdict(getattr(self.scenario, part)) for part in ("filter", "robot", "user", "task")}
        # Pace and proposed seed are no part of a headless trial.
        loop = {k: v for k, v in dataclasses.asdict(self.scenario.loop).items() if k not in ("seed", "pacing")}
        what = [parts, loop, self.seed, dict(self.labels), self.trace, science()]
        text = json.dumps(what, sort_keys=True, default=list)
        return f"{self.name}:{hashlib.sha256(text.encode()).hexdigest()[:16]}"


def run_job(job: Job) -> Row:
    """Run one trial; its row of the table."""
    result = run_trial(job.scenario, job.seed)
    row: Row = {"name": job.name, **job.labels, "task": job.scenario.loop.task, "seed": job.seed}
    row["duration"] = job.scenario.loop.duration
    row["intervened"] = float(np.mean(result.verdict != Verdict.ACCEPTED))
    row["outcome"] = int(result.outcome)
    row |= {} if result.measures is None else result.measures._asdict()
    if job.trace:
        names = job.scenario.loop.make_task().state_names
        row |= {f"trace.{name}": result.states[:: job.trace, k].tolist() for k, name in enumerate(names)}
        row["trace_step"] = job.trace * result.sample_time
        # The share of the ticks from each kept state to the next.
        intervened = result.verdict != Verdict.ACCEPTED
        row["trace_intervened"] = [
            float(np.mean(part)) for part in np.split(intervened, range(job.trace, len(intervened), job.trace))
        ]
        wanted = wanted_speed(job.scenario, len(result.states))
        if wanted is not None:
            row["trace_wanted_speed"] = wanted[:: job.trace]
    return row


def run(
    jobs: Sequence[Job],
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    report: Callable[[int, int, int], None] | None = None,
) -> list[Row]:
    """The rows of all jobs, in their order; those in the journal of ``folder`` are taken from there.

    Parameters
    ----------
    workers: processes of the pool; as many as this process may use, if left out.
    scheduler: address of a Dask scheduler, instead of the pool.
    report: called with trials done, trials in all, and trials that were there already.

    Raises
    ------
    StudyError: two jobs of one name, the journal cannot be written, or the scheduler cannot be reached.
    """
    keys = [job.key for job in jobs]
    if len({job.name for job in jobs}) != len(jobs):
        raise StudyError("two trials have the same name")
    if workers is not None and workers < 1:
        raise StudyError(f"workers: {workers} is not allowed; it must be at least 1")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        rows = _journal(folder / "journal.jsonl")
        todo = [job for job, key in zip(jobs, keys, strict=True) if key not in rows]
        there = len(jobs) - len(todo)
        # Line by line into the file: a run that is killed loses what was not finished, and nothing else.
        with (folder / "journal.jsonl").open("a", encoding="utf-8") as journal:
            for done, (job, row) in enumerate(_results(todo, workers, scheduler), there + 1):
                rows[job.key] = row
                journal.write(json.dumps({"key": job.key, "row": row}) + "\n")
                journal.flush()
                if report is not None:
                    report(done, len(jobs), there)
    except OSError as error:
        raise StudyError(f"{folder}: {error.strerror or error}") from error
    return [rows[key] for key in keys]


def _journal(path: Path) -> dict[str, Row]:
    """What is there; a torn end is cut off, so that the next line begins on its own."""
    if not path.exists():
        return {}
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) != len(data):
        path.write_bytes(whole)
    entries = (json.loads(line) for line in whole.splitlines())
    return {entry["key"]: entry["row"] for entry in entries}


def _results(jobs: Sequence[Job], workers: int | None, scheduler: str | None) -> Iterator[tuple[Job, Row]]:
    """Each job with its row, in the order in which they finish."""
    if scheduler is not None:
        yield from _on_dask(jobs, scheduler)
        return
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = min(workers, len(jobs))
    if workers <= 1:
        yield from ((job, run_job(job)) for job in jobs)
        return
    # Imported here: one worker needs no pool.
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    # The first one here: what is to be compiled is compiled once, and forked workers have it.
    yield jobs[0], run_job(jobs[0])
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context(method))
    try:
        futures = {pool.submit(run_job, job): job for job in jobs[1:]}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _on_dask(jobs: Sequence[Job], scheduler: str) -> Iterator[tuple[Job, Row]]:
    from distributed import Client, as_completed

    try:
        client = Client(scheduler, timeout="30s")
    except (OSError, ValueError) as error:
        raise StudyError(f"scheduler {scheduler!r} cannot be reached: {error}") from error
    with client:
        futures = client.map(run_job, jobs, pure=False)
        job_of = {future.key: job for future, job in zip(futures, jobs, strict=True)}
        for future in as_completed(futures):
            yield job_of[future.key], future.result()


def progress(title: str) -> Callable[[int, int, int], None]:
    """A line on standard error: done, in all, and how long the rest will take at this rate."""
    begin = time.monotonic()

    def show(done: int, total: int, there: int) -> None:
        rate = (time.monotonic() - begin) / max(1, done - there)
        left = round(rate * (total - done))
        end = "\n" if done == total or not sys.stderr.isatty() else ""
        if end == "\n" and done != total and done % max(1, total // 20):
            return
        filled = 30 * done // total
        print(
            f"\r{title} [{'#' * filled}{'.' * (30 - filled)}] {done}/{total}, {left // 60}:{left % 60:02d} left ",
            end=end, file=sys.stderr, flush=True,
        )  # fmt: skip

    return show


def write_table(rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Rows as Parquet; a column that a row lacks is null there. The same rows give the same bytes.

    Raises
    ------
    StudyError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = dict.fromkeys(name for row in rows for name in row)
    table = pa.table({name: [row.get(name) for row in rows] for name in names})
    partial = path.with_suffix(".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, partial)
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise StudyError(f"{path} cannot be written: {error.strerror or error}") from error
    return path
