"""The loop at 1 kHz, all nodes in one process, with the recorder and without: deadlines over 60 s, latency, decisions.

    RIG_REALTIME=auto ./rig run python bench/kilohertz.py [--horizon 0.5] [--seconds 60]

A horizon of as much time as at 100 Hz has ten times as many steps, and a search goes over all of them several times.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import statistics
import sys
import time

from jitter import nanosleep_beside
from loop import SCENARIO, timed_trial
from native import program
from rows import BenchError, Row, percentile, table

from shared_control import loop as agents
from shared_control.filter import Verdict
from shared_control.scenario import load

PERIOD = 0.001  # [s]

#: [s] As long as leaves a tick for the rest of the loop and for the recorder: a decision with its search takes up to a
#: quarter of a tick (p99; a third with 0.5 s, a half with 0.75 s, and with the 1.5 s of 100 Hz more than all of it).
HORIZON = 0.3

_SECONDS = 60.0
_DECISIONS = 8000


def rows(_: int) -> list[Row]:
    """Two trials of a minute, however many runs the others have."""
    return measure(HORIZON, _SECONDS)


def measure(horizon: float, seconds: float) -> list[Row]:
    """Missed deadlines and latency of two trials, and what decisions take of a tick, by processor time."""
    return [
        *_trial(horizon, seconds, record=False),
        *_trial(horizon, seconds, record=True),
        *_decisions(horizon),
    ]


def _trial(horizon: float, seconds: float, *, record: bool) -> list[Row]:
    ticks = round(seconds / PERIOD)
    with program("wake") as wake, nanosleep_beside(wake, PERIOD) as wakes:
        trial = timed_trial(record=record, pacing="realtime", duration=seconds, sample_time=PERIOD, horizon=horizon)
    left = PERIOD - statistics.median(trial.latencies)
    # What makes a wake-up as late as that makes a tick miss its deadline whatever its work is.
    over = ticks * statistics.fmean(lateness > left for lateness in wakes.late)
    in_c = f"clock_nanosleep in C beside it{'' if wakes.priority else ', in ordinary scheduling'}"
    name = f"loop.1kHz{'.recorded' if record else ''}"
    conditions = f"1 kHz for {seconds:.0f} s, composed{', recorded' if record else ''}, horizon {horizon:g} s"
    found = [
        Row(
            *(f"{name}.missed", f"ticks of {ticks} that found the loop not closed, {conditions}; {trial.scheduling}"),
            *("ticks", (float(trial.missed),), f"{in_c}, later than a median tick leaves over, of as many", (over,)),
            wanted=f"value < {ticks / 1000:.0f}",
            counted=True,
        )
    ]
    found += [
        Row(
            *(f"{name}.p{100 * share:.0f}", f"state out to motion in, {conditions}, p{100 * share:.0f}", "us"),
            *((1e6 * percentile(trial.latencies, share),), f"{in_c}, lateness, p{100 * share:.0f}"),
            (1e6 * percentile(wakes.late, share),),
        )
        for share in (0.5, 0.99)
    ]
    return found


def _decisions(horizon: float) -> list[Row]:
    found = []
    for verdict, times in decisions(horizon).items():
        what = f"a decision, {verdict}, horizon {horizon:g} s, processor time"
        found += [
            Row(
                *(f"loop.1kHz.{verdict}.p{100 * share:.0f}", f"{what}, p{100 * share:.0f}", "us"),
                *((1e6 * percentile(times, share),), "a tick", (1e6 * PERIOD,)),
            )
            for share in (0.5, 0.99)
        ]
    return found


def decisions(horizon: float) -> dict[str, list[float]]:
    """Processor time [s] of each decision of a trial without a graph, by verdict: accepted, replaced."""
    shipped = load(SCENARIO)
    scenario = dataclasses.replace(
        shipped,
        loop=dataclasses.replace(shipped.loop, sample_time=PERIOD),
        filter=dataclasses.replace(shipped.filter, horizon=horizon),
    )
    user, judge = agents.make_user(scenario, 1), agents.make_filter(scenario)
    robot, plant = agents.make_robot(scenario), agents.make_plant(scenario, 1)
    for agent in (user, judge, plant):
        agent.warm_up()
    found: dict[str, list[float]] = {"accepted": [], "replaced": []}
    for tick in range(_DECISIONS):
        x = plant.state
        force = user.act(tick, tick * PERIOD, x, plant.task_mode)
        begin = time.thread_time()
        outcome = judge.decide(x, force, plant.task_mode)
        taken = time.thread_time() - begin
        found["accepted" if outcome.decision.verdict is Verdict.ACCEPTED else "replaced"].append(taken)
        plant.step(robot.step(outcome.admitted_force), outcome.admitted_force)
    return found


def main() -> int:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--horizon", type=float, default=HORIZON, help="[s] (%(default)s)")
    arguments.add_argument("--seconds", type=float, default=_SECONDS, help="length of the trial (%(default)s)")
    options = arguments.parse_args()
    try:
        found = measure(options.horizon, options.seconds)
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(table(found))
    print(f"load {os.getloadavg()[0]:.1f}; {found[0].what}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
