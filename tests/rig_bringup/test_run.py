"""`run`: bad parameters are one sentence, signals end a node cleanly."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


def start(*arguments: str, **environment_besides: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "user_sim_node.main", "--ros-args", "-r", "__ns:=/rig", *arguments]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(62 + os.getpid() % 30), **environment_besides}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_bad_parameter_ends_the_node_with_one_sentence() -> None:
    _, said = start("-p", "user:=ghost").communicate(timeout=120)
    assert "error: node /rig/user_sim: user" in said
    assert "Traceback" not in said


def test_a_scheduling_that_is_none_ends_the_node_with_one_sentence() -> None:
    process = start(RIG_REALTIME="always")
    _, said = process.communicate(timeout=120)
    assert said == "error: RIG_REALTIME=always is not known; it must be one of off, auto, require\n"
    assert process.returncode == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("threads_of_libraries", ["1", "2"])
def test_a_signal_at_start_or_later_ends_it_without_a_trace(number: signal.Signals, threads_of_libraries: str) -> None:
    process = start(OPENBLAS_NUM_THREADS=threads_of_libraries)
    deadline = time.monotonic() + 120.0
    while not _takes_signals(process.pid) and process.poll() is None:
        assert time.monotonic() < deadline
    process.send_signal(number)
    _, said = process.communicate(timeout=120)
    assert "Traceback" not in said
    assert process.returncode == 0


def _takes_signals(pid: int) -> bool:
    """Whether `run` has begun: it catches SIGTERM, the second of the two."""
    with Path(f"/proc/{pid}/status").open(encoding="ascii") as status:
        caught = next(line for line in status if line.startswith("SigCgt")).split()[1]
    return bool(int(caught, 16) & 1 << (signal.SIGTERM - 1))
