"""The closed loop of four processes and a recorder at 100 Hz, as `./rig up` starts it: what its bag says of latency.

Each node puts its wall times into its messages; `rig_study.hops` makes the loop's latency of them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from jitter import Wakes, nanosleep_beside
from live import in_own_domain
from loop import SCENARIO
from native import program
from rows import BenchError, Row, percentile

from rig_runtime.clocks import wall_ahead_of_steady
from rig_runtime.realtime import Settings
from rig_runtime.ticks import from_stamp
from rig_study.recorded import RecordedTrial, load

_LOOP = "loop, state out to motion in"
_PERIOD = 0.01

#: [s] Between two looks at whether the machine stands still.
_STEP = 0.001


def trial(seconds: float) -> RecordedTrial:
    """Run a trial and read it.

    Raises
    ------
    BenchError: it did not run to its end.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "rig_bringup", "up", SCENARIO, "--pacing", "realtime", "--no-report"]
        command += ["--duration", str(seconds), "--out", f"{folder}/run"]
        # As for every row that wall time paces, real-time scheduling only where it is asked for.
        environment = {**in_own_domain(), "RIG_REALTIME": os.environ.get("RIG_REALTIME", "off")}
        result = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
        if result.returncode != 0:
            raise BenchError(f"the trial did not run to its end: {result.stderr.strip()}")
        return load(Path(folder) / "run" / "bag")


def rows(runs: int) -> list[Row]:
    """Latency and missed deadlines, 10 s a run."""
    return _rows("loop.processes", runs, 10.0)


def ten_minutes(_: int) -> list[Row]:
    """The same once, for ten minutes."""
    return _rows("loop.10min", 1, 600.0)


def _rows(name: str, runs: int, seconds: float) -> list[Row]:
    trials, sleeps, own = [], [], []
    above = True
    with program("wake") as wake:
        for _ in range(runs):
            ahead = 1e-9 * wall_ahead_of_steady()
            with ExitStack() as beside:
                # A machine may let one of its processors stand still.
                wakes = [
                    beside.enter_context(nanosleep_beside(wake, _STEP, processor))
                    for processor in sorted(Settings.from_environment().cpus or os.sched_getaffinity(0))
                ]
                found = trial(seconds)
            trials.append(found)
            above = above and all(each.priority for each in wakes)
            sleeps.append([late for each in wakes for late in each.late])
            own.append(float(_own(found, 1e-9 * from_stamp(found.trial.epoch) - ahead, wakes)))
    ordinary = "" if above else " in ordinary scheduling"
    # A tick that was missed has no latency: it counts as one of a whole period.
    latencies = [1e6 * np.nan_to_num(found.hops[_LOOP][:-1], nan=_PERIOD) for found in trials]
    what = "state out to motion in, four processes and a recorder, 100 Hz, work included"
    rows = []
    for share, wanted in ((0.5, ""), (0.99, "value < 3000")):
        title = f"p{100 * share:.0f}"
        values = tuple(float(percentile(times, share)) for times in latencies)
        bare = tuple(1e6 * percentile(times, share) for times in sleeps)
        baseline = f"lateness of clock_nanosleep in C{ordinary} beside it, at 1 kHz on each processor, {title}"
        rows.append(Row(f"{name}.{title}", f"{what}, {title}", "us", values, baseline, bare, wanted=wanted))
    missed = tuple(float(found.trial.missed_deadlines) for found in trials)
    what = f"ticks that found the loop not closed, of {round(runs * seconds / _PERIOD)}"
    rows.append(Row(f"{name}.missed", what, "ticks", missed, wanted="value <= 0", counted=True))
    if above:  # else the graph itself may hold up the C loop
        what = "of these, in whose period not every processor stood still for half of it, by a C loop on each"
        rows.append(Row(f"{name}.missed.own", what, "ticks", tuple(own), wanted="value <= 0", counted=True))
    return rows


def _own(found: RecordedTrial, begin: float, wakes: Sequence[Wakes]) -> int:
    """How many of the missed ticks the machine's stalls do not account for; the trial's begin [s, steady clock]."""
    due = begin + found.time[found.held]
    accounted = sum(all(each.held_up(at - _PERIOD, at) >= _PERIOD / 2.0 for each in wakes) for at in due)
    return int(found.trial.missed_deadlines) - accounted
