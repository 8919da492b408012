"""The closed loop of four nodes in one process: latency, deadlines, and what the recorder costs."""

from __future__ import annotations

import itertools
import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ring
from ament_index_python.packages import get_package_prefix
from jitter import nanosleep, nanosleep_beside
from live import LIMIT, Live, in_own_domain
from native import program
from rows import BenchError, Row, alternate, percentile

from mig_interfaces.msg import TrialState
from mig_interfaces.srv import StartTrial
from rig_bringup import scenario
from rig_bringup.compose import graph
from rig_bringup.graph_process import GraphProcess
from rig_bringup.monitor import Monitor
from rig_bringup.up import graph_command
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

    def tick(self) -> float:
        """Mean time from state to state [s] without the slowest 2 %, which are stalls of the machine."""
        times = sorted(after - before for before, after in itertools.pairwise(self.sent))
        return statistics.fmean(times[: round(0.98 * len(times))])


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
        return Trial(latencies, [*task.sent.values()], task.trial.missed_deadlines)


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


def _trial(**settings: Any) -> Trial:
    with tempfile.TemporaryDirectory() as folder:
        return run(Path(folder), **settings)


def _medians(trials: Sequence[Sequence[float]], share: float = 0.5) -> tuple[float, ...]:
    return tuple(1e6 * percentile(times, share) for times in trials)


def lockstep(runs: int) -> list[Row]:
    """State out to state in, one tick after the other."""
    loop, objects, raw = alternate(
        runs,
        lambda: _trial(pacing="lockstep", duration=10.0).latencies,
        ring.rounds,
        lambda: ring.rounds(raw=True),
    )
    what = "state out to motion in, four nodes composed, lockstep, work included, p50"
    found = _medians(loop)
    return [
        Row("loop.lockstep.p50", what, "us", found, _RING, _medians(objects), wanted="ratio <= 1.5"),
        Row("loop.lockstep.p50.bytes", what, "us", found, _RING_OF_BYTES, _medians(raw)),
    ]


def realtime(runs: int) -> list[Row]:
    """The same at 100 Hz of wall time, and how regular the states are."""
    period, ticks = 0.01, 500
    with program("wake") as wake:
        trials, bare, sleeps = alternate(
            runs,
            lambda: _trial(pacing="realtime", duration=period * ticks),
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
            _medians(latencies, share),
            f"{_RING}, at 100 Hz",
            _medians(bare, share),
            wanted=wanted,
        )
        for name, share, wanted in (("p50", 0.5, "ratio <= 1.5"), ("p99", 0.99, ""))
    ]
    late = [[at - trial.sent[0] - period * k for k, at in enumerate(trial.sent)] for trial in trials]
    jitter = Row(
        *("loop.100Hz.jitter", "lateness of a state against its grid, p99", "us", _medians(late, 0.99)),
        *("clock_nanosleep in C", _medians(sleeps, 0.99)),
    )
    return [*rows, jitter]


def kilohertz(runs: int) -> list[Row]:
    """Share of missed deadlines at 1 kHz, 60 s in all; a horizon of as many steps as at 100 Hz."""
    period, seconds = 0.001, 60.0 / runs
    missed, over = [], []
    with program("wake") as wake:
        for _ in range(runs):
            with nanosleep_beside(wake, period) as wakes:
                trial = _trial(pacing="realtime", duration=seconds, sample_time=period, horizon=0.15)
            left = period - statistics.median(trial.latencies)
            missed.append(100.0 * trial.missed / round(seconds / period))
            over.append(100.0 * statistics.fmean(lateness > left for lateness in wakes.late))
    what = "ticks that found the loop not closed at 1 kHz, 60 s in all, composed"
    # What makes a wake-up as late as that makes a tick miss its deadline whatever its work is.
    baseline = "clock_nanosleep in C beside it, later than a median tick leaves over"
    return [Row("loop.1kHz.missed", what, "%", tuple(missed), baseline, tuple(over), wanted="value < 0.1")]


def recorder(runs: int) -> list[Row]:
    """A tick with and without it: all in one process, all but the recorder in one, and each node in its own."""
    with_, without = alternate(
        runs,
        lambda: 1e6 * _trial(record=True, pacing="lockstep", duration=10.0).tick(),
        lambda: 1e6 * _trial(pacing="lockstep", duration=10.0).tick(),
    )
    beside_with, beside_without = alternate(
        runs, lambda: 1e6 * _tick_started(True, record=True), lambda: 1e6 * _tick_started(True, record=False)
    )
    apart_with, apart_without = alternate(
        runs, lambda: 1e6 * _tick_started(False, record=True), lambda: 1e6 * _tick_started(False, record=False)
    )
    what = "a tick in lockstep, {}, recorded, mean"
    return [
        Row(
            *("recorder.cost", f"{what.format('composed')} without the slowest 2 %", "us", with_),
            *("not recorded", without),
            wanted="ratio <= 1.15",
        ),
        Row(
            *("recorder.cost.beside", what.format("composed, the recorder in a process of its own"), "us", beside_with),
            *("not recorded", beside_without),
        ),
        Row(
            *("recorder.cost.processes", what.format("each node in a process"), "us", apart_with),
            *("not recorded", apart_without),
            wanted="ratio <= 1.15",
        ),
    ]


def _tick_started(compose: bool, *, record: bool, duration: float = 20.0) -> float:
    """Wall time of a tick [s]; the graph is one process, with the recorder beside it, or one for each node."""
    os.environ.update(in_own_domain())
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        files = parameters(folder, record=record, autostart=True, pacing="lockstep", duration=duration)
        environment = {"RIG_RECORD": str(int(record and not compose)), "RIG_REALTIME": "off"}
        commands = {"log": graph_command(compose, files, "rig")}
        if record and compose:
            executable = Path(get_package_prefix("rig_bag")) / "lib" / "rig_bag" / "recorder"
            arguments = [part for file in files for part in ("--params-file", str(file))]
            commands["recorder.log"] = [str(executable), "--ros-args", "-r", "__ns:=/rig", *arguments]
        processes = [
            stack.enter_context(GraphProcess(command, folder / log, environment)) for log, command in commands.items()
        ]
        monitor = stack.enter_context(Monitor("rig"))
        limit = time.monotonic() + LIMIT
        while monitor.speed() is None:
            monitor.wait(0.1)
            failed = [process for process in processes if process.exit_code]
            if failed or time.monotonic() > limit:
                words = (failed or processes)[0].last_words()
                raise BenchError(f"the graph did not run to its end; it said:\n{words}")
        speed = monitor.speed()
        assert speed is not None
        return 0.01 / speed
