"""The time of a whole study with virtual subjects: `./rig run python bench/study.py [--protocol paper]`.

`./rig study simulate` of the protocol, then `./rig analyze` of its folder, each in a process of its own, into a folder
that was empty: trials with the filter, measures, statistics, figures and the report.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from machine import describe


def main() -> None:
    """Print the time of both parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="paper", help="path, or a name under config/protocols (%(default)s)")
    parser.add_argument("--cohort", default="learners", help="path, or a name under config/cohorts (%(default)s)")
    parser.add_argument("--workers", type=int, default=2, help="processes (%(default)s)")
    options = parser.parse_args()
    rig = [sys.executable, "-m", "rig_bringup"]
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        simulate = ["study", "simulate", options.protocol, "--cohort", options.cohort, "--out", folder]
        subprocess.run([*rig, *simulate, "--workers", str(options.workers)], check=True)
        simulated = time.monotonic()
        subprocess.run([*rig, "analyze", folder, "--out", str(Path(folder) / "report")], check=True)
        analysed = time.monotonic()
    print(
        f"{options.protocol}: {analysed - begin:.1f} s in all, {simulated - begin:.1f} s for the trials on "
        f"{options.workers} processes, {analysed - simulated:.1f} s for statistics, figures and report"
    )
    print(f"load {describe()['load average']}")


if __name__ == "__main__":
    main()
