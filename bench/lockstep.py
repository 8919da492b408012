"""How fast the graph runs in lockstep, recorder included: `./rig run python bench/lockstep.py [--seeds N]`.

Each row is one trial through `./rig up`; the factor is trial time over wall time, from the first tick to the last.
Beside it stands that of a bare ring of four hops, without recorder or work (`bench/ring.py`), from the same minute.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from live import in_own_domain
from ring import NAME as RING
from ring import seconds_per_round
from rows import BenchError, Row, alternate

from rig_study.recorded import load
from shared_control import measures

SCENARIO = "cart_pendulum_noise_assistance"


def main() -> None:
    """Run the trials and print one line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="how many trials, each with another seed")
    parser.add_argument("--first", type=int, default=1, help="the first seed")
    parser.add_argument("--duration", type=float, default=30.0, help="length of a trial [s]")
    parser.add_argument("--processes", action="store_true", help="separate processes instead of one")
    parser.add_argument("--scenario", default=SCENARIO)
    arguments = parser.parse_args()
    print(
        f"{'seed':>6} {'x real time':>12} {'bare ring':>10} {'ticks':>6} {'decisions':>9} {'success at':>10} "
        f"{'rejected':>9} {'load':>6}"
    )
    inverted = 0
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        with tempfile.TemporaryDirectory() as folder:
            row = _line(arguments, seed, Path(folder) / "run")
        inverted += row[1]
        print(row[0], flush=True)
    print(f"inverted: {inverted} of {arguments.seeds}")


def run_trial(scenario: str, seed: int, duration: float, processes: bool, out: Path) -> float:
    """Run a trial into a folder; trial time over wall time.

    Raises
    ------
    BenchError: it did not run to its end.
    """
    command = [sys.executable, "-m", "rig_bringup", "up", scenario, "--pacing", "lockstep", "--no-report"]
    command += ["--seed", str(seed), "--duration", str(duration), "--out", str(out)]
    if not processes:
        command.append("--compose")
    result = subprocess.run(command, check=False, capture_output=True, text=True, env=in_own_domain())
    speed = re.search(r"lockstep: (\S+) x", result.stdout)
    if result.returncode != 0 or speed is None:
        said = f"{result.stdout.strip()[-500:]}\n{result.stderr.strip()}"
        raise BenchError(f"the trial did not run to its end (exit code {result.returncode}): {said}")
    return float(speed[1])


def _factor(processes: bool) -> float:
    with tempfile.TemporaryDirectory() as folder:
        return run_trial(SCENARIO, 1, 30.0, processes, Path(folder) / "run")


def _rows(runs: int, name: str, processes: bool) -> list[Row]:
    ours, ring = alternate(runs, lambda: _factor(processes), lambda: 0.01 / seconds_per_round())
    what = f"30 s of trial over their wall time, recorded, {name}"
    wanted = "" if processes else "value >= 25"
    return [
        Row(f"lockstep.{name}", what, "x", ours, f"{RING}, composed", ring, wanted=wanted, more_is_better=True),
    ]


def composed(runs: int) -> list[Row]:
    """All nodes in one process."""
    return _rows(runs, "composed", False)


def processes(runs: int) -> list[Row]:
    """Each node in one of its own."""
    return _rows(runs, "processes", True)


def _line(arguments: argparse.Namespace, seed: int, out: Path) -> tuple[str, bool]:
    ring = seconds_per_round()
    factor = run_trial(arguments.scenario, seed, arguments.duration, arguments.processes, out)
    ring = 0.5 * (ring + seconds_per_round())
    trial = load(out / "bag")
    found = measures.cart_pendulum(trial.states, trial.sample_time)
    rejected = 1.0 - trial.shares()["accepted"]
    return (
        f"{seed:6} {factor:12.1f} {trial.sample_time / ring:10.1f} "
        f"{trial.ticks_recorded:6} {trial.decisions_recorded:9} {found.time_to_success:9.2f}s "
        f"{rejected:9.3f} {os.getloadavg()[0]:6.1f}"
    ), found.success


if __name__ == "__main__":
    main()
