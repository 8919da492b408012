"""`run`: bad parameters are one sentence, signals end a node cleanly, a step back of the clock is noticed."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from rclpy.executors import SingleThreadedExecutor

from rig_runtime import run


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


def test_security_that_cannot_be_had_is_one_sentence_and_never_a_node_without_it(tmp_path: Path) -> None:
    """Whether this middleware has DDS-Security or not: there are no keys."""
    keys = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(tmp_path)}
    process = start(**keys, ROS_SECURITY_ENCLAVE_OVERRIDE="/rig")
    said, complaint = process.communicate(timeout=120)
    assert said == ""
    begin = "error: the middleware does not start: failed to initialize rcl: SECURITY ERROR: "
    assert complaint == f"{begin}directory '{tmp_path}/enclaves/rig' does not exist\n"
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


def test_signals_are_taken_in_a_thread_and_the_third_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    before = {number: signal.getsignal(number) for number in run._SIGNALS}
    happened: queue.SimpleQueue[object] = queue.SimpleQueue()

    def ended(code: int) -> None:
        happened.put(code)
        sys.exit()  # of the thread

    monkeypatch.setattr(run.os, "_exit", ended)
    taker = run._SignalTaker()
    pipe = signal.set_wakeup_fd(-1)
    for number, handler in before.items():
        signal.signal(number, handler)
    # What Python's C handler writes: the number of any signal, one that is none of these among them.
    os.write(pipe, bytes([signal.SIGCHLD, signal.SIGINT]))
    deadline = time.monotonic() + 30.0
    while not taker.taken and time.monotonic() < deadline:
        os.sched_yield()
    taker.call(lambda: happened.put("asked to end"))
    assert happened.get(timeout=30.0) == "asked to end", "a signal that came before anybody could be told"
    os.write(pipe, bytes([signal.SIGTERM]))
    assert happened.get(timeout=30.0) == "asked to end"
    os.write(pipe, bytes([signal.SIGINT]))
    assert happened.get(timeout=30.0) == 130


def test_an_executor_that_is_none_is_refused(single_graph: Any) -> None:
    with pytest.raises(ValueError, match="'multi' is not known; it must be one of events, single"):
        run.make_executor(single_graph.context, "multi")


def test_where_the_fast_executor_does_not_serve_the_reference_does(
    single_graph: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Deaf(SingleThreadedExecutor):
        def spin_until_future_complete(self, *_: Any, **__: Any) -> None:
            """Serve nothing."""

    monkeypatch.setattr(run, "EventsExecutor", Deaf)
    executor = run.make_executor(single_graph.context)
    assert type(executor) is SingleThreadedExecutor
    assert "using the single-threaded one" in capsys.readouterr().err
    executor.shutdown()


def test_waiting_ends_with_the_condition_or_the_limit(single_graph: Any) -> None:
    looks = iter((False, False, True))
    assert run.wait_until(lambda: next(looks), single_graph.executor, 60.0)
    assert not run.wait_until(lambda: False, single_graph.executor, 0.05)


def test_a_step_back_of_the_wall_clock_is_noticed_and_one_forward_is_none() -> None:
    """In a process of its own: whoever watches does so until the end."""
    code = """
import threading, time, types
from rig_runtime import clocks, run

looks, step, stepped, looked = 0, 0, threading.Event(), threading.Condition()

def sleep(seconds):
    global looks
    time.sleep(seconds)
    with looked:
        looks += 1
        looked.notify_all()

def looks_twice_more():
    with looked:
        wanted = looks + 2
        assert looked.wait_for(lambda: looks >= wanted, 60.0)

run.time = types.SimpleNamespace(sleep=sleep)
run.wall_ahead_of_steady = lambda: clocks.wall_ahead_of_steady(lambda: time.time_ns() + step)
run.watch_clock(lambda seconds: stepped.set() if abs(seconds - 3600.0) < 1.0 else None, 0.01)
looks_twice_more()
step = 3600 * 10**9
looks_twice_more()
assert not stepped.is_set()
step = 0
assert stepped.wait(60.0)
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
