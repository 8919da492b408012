"""The time that analysing recorded trials takes: `./rig run python bench/analysis.py`.

One subject's ninety 30 s trials are recorded in lockstep, all nodes in one process, through the session that people
run; then `./rig analyze` reads them, in a process of its own each time. The bags stay in the folder, and a second call
uses them.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from pathlib import Path

from machine import describe

PROTOCOL = """
study: {scenario: cart_pendulum_noise_training, duration: DURATION, seed: 9}
groups: {all: {subjects: 1, modes: ["off", training, "off"]}}
sets: {set1: {trials: EACH}, set2: {trials: EACH}, set3: {trials: EACH}}
"""


def main() -> None:
    """Record what is missing, analyse it, print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("runs/bench_analysis"), help="of the bags (%(default)s)")
    parser.add_argument("--trials", type=int, default=30, help="in each of three sets (%(default)s)")
    parser.add_argument("--duration", type=float, default=30.0, help="of a trial [s] (%(default)s)")
    parser.add_argument("--runs", type=int, default=3, help="of the analysis (%(default)s)")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    protocol = options.folder / "bench.yaml"
    protocol.write_text(PROTOCOL.replace("DURATION", str(options.duration)).replace("EACH", str(options.trials)))
    rig = [sys.executable, "-m", "rig_bringup"]
    session = ["study", "run", str(protocol), "--subject", "S01", "--out", str(options.folder)]
    begin = time.monotonic()
    subprocess.run([*rig, *session, "--pacing", "lockstep", "--compose"], check=True, stdout=subprocess.DEVNULL)
    bags = options.folder / "S01" / "bags"
    size = sum(file.stat().st_size for file in bags.rglob("*.mcap")) / 1e6
    print(f"recorded: {len(list(bags.iterdir()))} bags, {size:.0f} MB, {time.monotonic() - begin:.0f} s")
    seconds = []
    for _ in range(options.runs):
        begin = time.monotonic()
        subprocess.run(
            [*rig, "analyze", str(bags), "--out", str(options.folder / "report")], check=True, stdout=subprocess.DEVNULL
        )
        seconds.append(time.monotonic() - begin)
    print(f"analysed: {statistics.median(seconds):.1f} s (median of {[round(each, 1) for each in seconds]})")
    print(f"load {describe()['load average']}")


if __name__ == "__main__":
    main()
