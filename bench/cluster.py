"""A sweep on a local Dask cluster of two workers against the process pool: `./rig run python bench/cluster.py`.

Both run the same jobs into empty folders, in turn. What is compared is the time from the first job to the last row,
with a cluster whose workers are up and have their kernels, and the bytes of the tables.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import distributed
from machine import describe

from rig_study.runs import run, run_job, write_table
from rig_study.sweep import load_sweep, sweep_jobs

WORKERS = 2


def main() -> None:
    """Print the times of each run, their ratio, and whether the tables are the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweep", default="cart_pendulum_horizon", help="path, or a name under config/sweeps")
    parser.add_argument("--runs", type=int, default=3, help="of each, in turn (%(default)s)")
    options = parser.parse_args()
    jobs = sweep_jobs(load_sweep(options.sweep))
    seconds: dict[str, list[float]] = {"pool": [], "cluster": []}
    tables: set[bytes] = set()
    with (
        distributed.LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=None) as cluster,
        tempfile.TemporaryDirectory() as folder,
    ):
        with distributed.Client(cluster) as client:
            # Its workers are new processes: each loads its kernels once, as those of a cluster that stands have.
            client.run(run_job, jobs[0])
        for number in range(options.runs):
            for kind, each in seconds.items():
                where = Path(folder) / f"{kind}{number}"
                begin = time.monotonic()
                if kind == "pool":
                    rows = run(jobs, where, workers=WORKERS)
                else:
                    rows = run(jobs, where, scheduler=cluster.scheduler_address)
                each.append(time.monotonic() - begin)
                tables.add(write_table(rows, where / "trials.parquet").read_bytes())
    for kind, each in seconds.items():
        print(f"{kind:8} {statistics.median(each):7.2f} s  (median of {[round(value, 2) for value in each]})")
    ratio = statistics.median(seconds["cluster"]) / statistics.median(seconds["pool"])
    print(f"cluster / pool {ratio:.3f}; {len(jobs)} trials; tables {'identical' if len(tables) == 1 else 'DIFFER'}")
    print(f"load {describe()['load average']}")


if __name__ == "__main__":
    main()
