"""``montecarlo`` and ``sweep``: many trials of a scenario, or of a grid of its parameters, into one table."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from rig_study.commands import carry_out
from rig_study.progress import progress
from rig_study.runs import Job, run, write_table
from rig_study.study_cli import add_run_options, where
from rig_study.sweep import load_sweep, montecarlo_jobs, sweep_jobs

__all__ = ["montecarlo", "sweep"]


def montecarlo(argv: Sequence[str]) -> int:
    """``./rig montecarlo``. Returns 0, or 2 for bad input; 130 if interrupted."""
    parser = argparse.ArgumentParser(
        prog="./rig montecarlo", description="Run a scenario over many seeds, headless; resumable."
    )
    parser.add_argument("scenario", help="path, or a name under config")
    parser.add_argument("--trials", type=int, default=100, help="how many (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the first trial; the others follow (%(default)s)")
    parser.add_argument(
        "--trace", type=int, default=5, help="keep the state of each so many ticks; 0: none (%(default)s)"
    )
    add_run_options(parser)
    options = parser.parse_args(argv)
    name = f"montecarlo_{Path(options.scenario).stem}"
    return _run(lambda: montecarlo_jobs(options.scenario, options.trials, options.seed, options.trace), name, options)


def sweep(argv: Sequence[str]) -> int:
    """``./rig sweep``. Returns 0, or 2 for bad input; 130 if interrupted."""
    parser = argparse.ArgumentParser(
        prog="./rig sweep",
        description="Run every point of a grid of parameters over the same seeds, headless; resumable.",
    )
    parser.add_argument("sweep", help="path, or a name under config/sweeps")
    add_run_options(parser)
    options = parser.parse_args(argv)
    return _run(lambda: sweep_jobs(load_sweep(options.sweep)), f"sweep_{Path(options.sweep).stem}", options)


def _run(make: Callable[[], list[Job]], name: str, options: argparse.Namespace) -> int:
    folder = options.out or Path("runs") / name

    def body() -> int:
        rows = run(make(), folder, **where(options), report=progress(name))
        print(f"{len(rows)} trials: {write_table(rows, folder / 'trials.parquet')}")
        print(f"next: ./rig analyze {folder} --out {folder / 'report'}")
        return 0

    return carry_out(body, resumes=True)
