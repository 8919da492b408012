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
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import shared_control
from rig_runtime.children import end_with_parent
from rig_study import cluster
from rig_study.declared import StudyError
from shared_control.filter import Verdict
from shared_control.scenario import Scenario
from shared_control.trial import judged, run_trial, wanted_speed

__all__ = ["Finished", "Job", "finished", "processes", "run", "run_job", "science", "write_table"]

Row = dict[str, Any]


@functools.cache
def science() -> str:
    """SHA-256 of the sources that a headless trial runs: a result of other code is not the result."""
    root, found = Path(shared_control.__file__).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        found.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


@dataclass(frozen=True)
class Job:
    """One trial to run, and the columns that say which it is."""

    name: str
    scenario: Scenario
    seed: int
    labels: Mapping[str, Any] = field(default_factory=dict)
    trace: int = 0  # keep the state of each so many ticks; 0: of none
    judge: Scenario | None = None  # whose filter judges the trial when it is over: what it would have rejected

    @property
    def key(self) -> str:
        """Name and hash of all that the result depends on."""
        scenarios = [_content(self.scenario), None if self.judge is None else _content(self.judge)]
        what = [scenarios, self.seed, dict(self.labels), self.trace, science()]
        text = json.dumps(what, sort_keys=True, default=list)
        return f"{self.name}:{hashlib.sha256(text.encode()).hexdigest()[:16]}"


class Finished(NamedTuple):
    """A job with its row."""

    job: Job
    key: str
    row: Row
    seconds: float  # that the trial took, in the process that ran it
    before: bool  # it was in the journal


def _content(scenario: Scenario) -> dict[str, Any]:
    content = {part: dataclasses.asdict(getattr(scenario, part)) for part in ("filter", "robot", "user", "task")}
    # Pace and proposed seed are no part of a headless trial.
    loop = {k: v for k, v in dataclasses.asdict(scenario.loop).items() if k not in ("seed", "pacing")}
    return {**content, "loop": loop}


def run_job(job: Job) -> Row:
    """Run one trial; its row of the table."""
    result = run_trial(job.scenario, job.seed)
    row: Row = {"name": job.name, **job.labels, "task": job.scenario.loop.task, "seed": job.seed}
    row["duration"] = job.scenario.loop.duration
    row["intervened"] = float(np.mean(result.verdict != Verdict.ACCEPTED))
    row["outcome"] = int(result.outcome)
    row |= {} if result.measures is None else result.measures._asdict()
    if job.judge is not None:
        row["judged_pra"] = judged(result, job.judge).pra
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
    trusted_network: bool = False,
    report: Callable[[int, int, int], None] | None = None,
) -> list[Row]:
    """The rows of all jobs, in their order; those in the journal of ``folder`` are taken from there.

    Parameters
    ----------
    workers, scheduler, trusted_network: as for :func:`finished`.
    report: called with trials done, trials in all, and trials that were there already.

    Raises
    ------
    StudyError: two jobs of one name, and as :func:`finished`.
    """
    if len({job.name for job in jobs}) != len(jobs):
        raise StudyError("two trials have the same name")
    rows: dict[str, Row] = {}
    there = 0
    coming = finished(jobs, folder, workers=workers, scheduler=scheduler, trusted_network=trusted_network)
    with contextlib.closing(coming) as results:
        for done, result in enumerate(results, 1):
            rows[result.key] = result.row
            there += result.before
            if report is not None and not result.before:
                report(done, len(jobs), there)
    return [rows[job.key] for job in jobs]


def finished(
    jobs: Sequence[Job],
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    trusted_network: bool = False,
) -> Iterator[Finished]:
    """Each job when it is finished: first those in the journal of ``folder``, then the others, begun in their order.

    Close the iterator (``contextlib.closing``) where it may not be used up: it ends the processes.

    Parameters
    ----------
    workers: processes of the pool; as many as this process may use, if left out.
    scheduler: address of a Dask scheduler, instead of the pool. It can run code here: see :mod:`rig_study.cluster`.
    trusted_network: it may be on another machine without TLS.

    Raises
    ------
    StudyError: the journal cannot be written, the scheduler is not allowed or cannot be reached, or a process was ended
        from outside.
    RuntimeError: a trial failed; the message names it.
    """
    count, todo = processes(workers), dict[str, Job]()
    journal = folder / "journal.jsonl"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        there = _journal(journal)
        # Line by line into the file: a run that is killed loses what was not finished, and nothing else.
        file = journal.open("a", encoding="utf-8")
    except OSError as error:
        raise StudyError(f"{folder}: {error.strerror or error}") from error
    with file:
        for job in jobs:
            if (key := job.key) in there:
                yield Finished(job, key, *there[key], before=True)
            else:
                todo[key] = job
        if scheduler is None:
            coming = _results(todo, count)
        else:
            coming = cluster.results(_timed, todo, scheduler, trusted_network=trusted_network)
        with contextlib.closing(coming) as results:
            for key, (row, seconds) in results:
                try:
                    file.write(json.dumps({"key": key, "row": row, "seconds": round(seconds, 4)}) + "\n")
                    file.flush()
                except OSError as error:
                    raise StudyError(f"{journal}: {error.strerror or error}") from error
                yield Finished(todo[key], key, row, seconds, before=False)


def processes(workers: int | None) -> int:
    """As many as wanted, or as this process may use.

    Raises
    ------
    StudyError: fewer than one.
    """
    if workers is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers < 1:
        raise StudyError(f"workers: {workers} is not allowed; it must be at least 1")
    return workers


def _journal(path: Path) -> dict[str, tuple[Row, float]]:
    """What is there; a torn end is cut off, so that the next line begins on its own."""
    if not path.exists():
        return {}
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) != len(data):
        path.write_bytes(whole)
    entries = (json.loads(line) for line in whole.splitlines())
    return {entry["key"]: (entry["row"], entry.get("seconds", 0.0)) for entry in entries}


def _timed(job: Job) -> tuple[Row, float]:
    begin = time.perf_counter()
    try:
        return run_job(job), time.perf_counter() - begin
    except Exception as error:
        raise RuntimeError(f"trial {job.name}, seed {job.seed}, failed: {type(error).__name__}: {error}") from error


def _results(jobs: Mapping[str, Job], workers: int) -> Iterator[tuple[str, tuple[Row, float]]]:
    """Key, row and time of each job, in the order in which they finish."""
    workers = min(workers, len(jobs))
    if workers <= 1:
        yield from ((key, _timed(job)) for key, job in jobs.items())
        return
    # Imported here: one worker needs no pool.
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool

    # The first one here: what is to be compiled is compiled once, and forked workers have it.
    first, *others = jobs
    yield first, _timed(jobs[first])
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_in_worker, initargs=(os.getpid(),))
    try:
        futures = {pool.submit(_timed, jobs[key]): key for key in others}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool:
        raise StudyError(
            "a process was ended from outside (by a lack of memory?); what was finished is kept, and the same command "
            "goes on from there, with --workers 1 in one process"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _in_worker(parent: int) -> None:
    # Ctrl-C reaches every process of the terminal: the first one ends the others, each after its trial.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    end_with_parent(signal.SIGKILL, parent)


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
