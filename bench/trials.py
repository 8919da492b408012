"""Many headless trials: ``./rig run python bench/trials.py [SCENARIO] [--trials 100] [--workers 2]``.

Wall time of ``run_trials`` after a warm-up, and the processor time that it took in all processes: on a machine with
other work the second, over the number of workers, is what the first would be on an idle one.
"""

from __future__ import annotations

import argparse
import os
import time

from shared_control.scenario import load
from shared_control.trial import run_trials

#: First of the seeds; used nowhere else.
FIRST_SEED = 70_000_000


def _processor_time() -> float:
    """[s] of this process and of those of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("scenario", nargs="?", default="cart_pendulum_noise_assistance")
    arguments.add_argument("--trials", type=int, default=100)
    arguments.add_argument("--workers", type=int, default=2)
    options = arguments.parse_args()
    scenario = load(options.scenario)
    run_trials(scenario, range(FIRST_SEED, FIRST_SEED + options.workers), options.workers)
    begin, worked = time.perf_counter(), _processor_time()
    run_trials(scenario, range(FIRST_SEED, FIRST_SEED + options.trials), options.workers)
    wall, cpu = time.perf_counter() - begin, _processor_time() - worked
    print(
        f"{options.scenario}: {options.trials} trials of {scenario.loop.duration:g} s on {options.workers} processes: "
        f"{wall:.1f} s of wall time, {cpu:.1f} s of processor time ({cpu / options.workers:.1f} s for each process), "
        f"load average {os.getloadavg()[0]:.1f}"
    )


if __name__ == "__main__":
    main()
