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

from ring import seconds_per_round

from rig_study.recorded import load
from shared_control import measures


def main() -> None:
    """Run the trials and print one line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="how many trials, each with another seed")
    parser.add_argument("--first", type=int, default=1, help="the first seed")
    parser.add_argument("--duration", type=float, default=30.0, help="length of a trial [s]")
    parser.add_argument("--processes", action="store_true", help="separate processes instead of one")
    parser.add_argument("--scenario", default="cart_pendulum_noise_assistance")
    arguments = parser.parse_args()
    print(
        f"{'seed':>6} {'x real time':>12} {'bare ring':>10} {'ticks':>6} {'decisions':>9} {'success at':>10} "
        f"{'rejected':>9} {'load':>6}"
    )
    inverted = 0
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        with tempfile.TemporaryDirectory() as folder:
            row = _trial(arguments, seed, Path(folder) / "run")
        inverted += row[1]
        print(row[0], flush=True)
    print(f"inverted: {inverted} of {arguments.seeds}")


def _trial(arguments: argparse.Namespace, seed: int, out: Path) -> tuple[str, bool]:
    command = [sys.executable, "-m", "rig_bringup", "up", arguments.scenario, "--pacing", "lockstep", "--no-report"]
    command += ["--seed", str(seed), "--duration", str(arguments.duration), "--out", str(out)]
    if not arguments.processes:
        command.append("--compose")
    ring = seconds_per_round()
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    ring = 0.5 * (ring + seconds_per_round())
    trial = load(out / "bag")
    found = measures.cart_pendulum(trial.states, trial.sample_time)
    rejected = 1.0 - trial.shares()["accepted"]
    factor = float(re.search(r"lockstep: (\S+) x", said)[1])  # type: ignore[index]
    return (
        f"{seed:6} {factor:12.1f} {trial.sample_time / ring:10.1f} "
        f"{trial.ticks_recorded:6} {trial.decisions_recorded:9} {found.time_to_success:9.2f}s "
        f"{rejected:9.3f} {os.getloadavg()[0]:6.1f}"
    ), found.success


if __name__ == "__main__":
    main()
