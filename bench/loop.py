"""The closed loop of four nodes in one process: latency in lockstep and at 100 Hz, and jitter."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ring
from jitter import nanosleep
from live import Live
from native import program
from rows import Row, alternate, percentile

from mig_interfaces.msg import TrialState
from mig_interfaces.srv import StartTrial
from rig_bringup import scenario
from rig_bringup.compose import graph
from rig_runtime.wire import stamp_of
from task_sim_node.node import TaskSimNode

SCENARIO = "cart_pendulum_noise_assistance"

_RING = f"{ring.NAME}, message objects"
_RING_OF_BYTES = f"{ring.NAME}, bytes"


class TimedTaskSim(TaskSimNode):
    """The pacemaker, which notes when a state goes out and when the loop has closed."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        #: When, by stamp.
        self.sent: dict[int, float] = {}
        self.closed: dict[int, float] = {}

    def _publish_state(self, *given: Any) -> None:
        assert self.clock is not None
        self.sent[self.clock.stamp(self._pacemaker.tick)] = time.perf_counter()
        super()._publish_state(*given)

    def _on_motion(self, data: bytes) -> None:
        self.closed[stamp_of(data)] = time.perf_counter()
        super()._on_motion(data)


@dataclass(frozen=True)
class Trial:
    """What a trial took."""

    latencies: Sequence[float]  # [s] from state out to motion in
    sent: Sequence[float]  # [s] when each state went out
    missed: int
    scheduling: str  # of the process

    def ticks(self) -> list[float]:
        """Times from state to state [s]."""
        return [after - before for before, after in itertools.pairwise(self.sent)]


def run(folder: Path, *, record: bool = False, pacing: str, **settings: Any) -> Trial:
    """A trial of a shipped scenario, with all nodes in this process."""
    files = parameters(folder, record=record, pacing=pacing, **settings)
    factories = [TimedTaskSim if factory is TaskSimNode else factory for factory in graph(record)]
    with Live(paced=pacing == "realtime") as live:
        nodes = [live.make(factory, files) for factory in factories]
        task: TimedTaskSim = nodes[-1]
        recorder = nodes[0] if record else None
        live.settle(lambda: task.trial.phase == TrialState.PHASE_IDLE)
        task._begin(StartTrial.Request())
        live.until(lambda: task.trial.phase >= TrialState.PHASE_FINISHED, 0.05)
        if recorder is not None:
            live.until(recorder.closed.done)
        latencies = [task.closed[stamp] - sent for stamp, sent in task.sent.items() if stamp in task.closed]
        return Trial(latencies, [*task.sent.values()], task.trial.missed_deadlines, live.realtime.describe())


def parameters(folder: Path, *, record: bool, autostart: bool = False, horizon: float = 0.0, **loop: Any) -> list[Path]:
    """The scenario's parameter files, in this folder, as is the bag."""
    scenario.use_shipped_scenarios()
    checked = scenario.load(SCENARIO, loop)
    needed = ["user_sim", "mig_filter", "admittance_sim", *(["recorder"] if record else [])]
    own: dict[str, dict[str, Any]] = {"/**/task_sim": {"required_nodes": needed, "autostart": autostart}}
    own |= {"/**/recorder": {"uri": str(folder / "bag")}} if record else {}
    own |= {"/**/mig_filter": {"horizon": horizon}} if horizon else {}
    files = [folder / "scenario.yaml", folder / "own.yaml"]
    for file, text in zip(files, (checked.text(), scenario.parameter_file(own)), strict=True):
        file.write_text(text)
    return files


def timed_trial(**settings: Any) -> Trial:
    """:func:`run` in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        return run(Path(folder), **settings)


def percentiles(trials: Sequence[Sequence[float]], share: float = 0.5) -> tuple[float, ...]:
    """That of each trial [us]."""
    return tuple(1e6 * percentile(times, share) for times in trials)


def lockstep(runs: int) -> list[Row]:
    """State out to state in, one tick after the other."""
    loop, objects, raw = alternate(
        runs,
        lambda: timed_trial(pacing="lockstep", duration=10.0).latencies,
        ring.rounds,
        lambda: ring.rounds(raw=True),
    )
    what = "state out to motion in, four nodes composed, lockstep, work included"
    rows = []
    for name, share, wanted in (("p50", 0.5, "ratio <= 1.5"), ("p99", 0.99, "")):
        found, described = percentiles(loop, share), f"{what}, {name}"
        rows += [
            Row(*(f"loop.lockstep.{name}", described, "us", found, _RING, percentiles(objects, share)), wanted=wanted),
            Row(f"loop.lockstep.{name}.bytes", described, "us", found, _RING_OF_BYTES, percentiles(raw, share)),
        ]
    return rows


def realtime(runs: int) -> list[Row]:
    """The same at 100 Hz of wall time, and how regular the states are."""
    period, ticks = 0.01, 500
    with program("wake") as wake:
        trials, bare, sleeps = alternate(
            runs,
            lambda: timed_trial(pacing="realtime", duration=period * ticks),
            lambda: ring.rounds(ticks, period=period),
            lambda: nanosleep(wake, period, ticks),
        )
    what = "state out to motion in, four nodes composed, 100 Hz, work included"
    latencies = [trial.latencies for trial in trials]
    rows = [
        Row(
            f"loop.100Hz.{name}",
            f"{what}, {name}",
            "us",
            percentiles(latencies, share),
            f"{_RING}, at 100 Hz",
            percentiles(bare, share),
            wanted=wanted,
        )
        for name, share, wanted in (("p50", 0.5, "ratio <= 1.5"), ("p99", 0.99, ""))
    ]
    late = [[at - trial.sent[0] - period * k for k, at in enumerate(trial.sent)] for trial in trials]
    jitter = Row(
        *("loop.100Hz.jitter", "lateness of a state against its grid, p99", "us", percentiles(late, 0.99)),
        *("clock_nanosleep in C", percentiles(sleeps, 0.99)),
    )
    return [*rows, jitter]
