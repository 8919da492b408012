"""What the recorder costs a tick in lockstep: in the graph's process, beside it, and where each node has its own."""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from live import LIMIT, in_own_domain
from loop import parameters, percentiles, timed_trial
from rows import BenchError, Row, alternate

from rig_bringup.graph_process import GraphProcess
from rig_bringup.monitor import Monitor
from rig_bringup.up import graph_command


def composed(runs: int) -> list[Row]:
    """All nodes and the recorder in one process: from state to state."""
    with_, without = alternate(
        runs,
        lambda: timed_trial(record=True, pacing="lockstep", duration=10.0).ticks(),
        lambda: timed_trial(pacing="lockstep", duration=10.0).ticks(),
    )
    return [
        Row(
            *(f"recorder.composed.{name}", f"a tick in lockstep, composed, recorded, {name}", "us"),
            *(percentiles(with_, share), "not recorded", percentiles(without, share)),
            wanted=wanted,
        )
        for name, share, wanted in (("p50", 0.5, "ratio <= 1.15"), ("p99", 0.99, ""))
    ]


def beside(runs: int) -> list[Row]:
    """All but the recorder in one process."""
    return _started(runs, "beside", "composed, the recorder in a process of its own", compose=True)


def processes(runs: int) -> list[Row]:
    """Each node in a process."""
    return _started(runs, "processes", "each node in a process", compose=False, wanted="ratio <= 1.15")


def _started(runs: int, name: str, what: str, *, compose: bool, wanted: str = "") -> list[Row]:
    with_, without = alternate(
        runs, lambda: 1e6 * _tick(compose, record=True), lambda: 1e6 * _tick(compose, record=False)
    )
    # Without a recorder nobody has the times of single ticks; the whole trial's is what lockstep is about.
    title = f"a tick in lockstep, {what}, recorded: wall time of 20 s of trial, over its ticks"
    return [Row(f"recorder.{name}", title, "us", with_, "not recorded", without, wanted=wanted)]


def _tick(compose: bool, *, record: bool, duration: float = 20.0) -> float:
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
