"""Interrupts are raised where they are asked for."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from multiprocessing.connection import Connection

import pytest

from rig_bringup.interrupts import Interrupts, held_back, let_in


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_it_is_asked_for(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with Interrupts() as interrupts:
        interrupts.check()
        signal.raise_signal(number)
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
    assert signal.getsignal(number) == before


@pytest.mark.parametrize(
    ("then", "code", "said"), [("signal.raise_signal(signal.SIGINT)", 130, "interrupted\n"), ("pass", 1, "failed\n")]
)
def test_an_interrupt_is_one_whatever_error_the_library_makes_of_it_that_was_being_loaded(
    then: str, code: int, said: str
) -> None:
    program = f"""
import importlib, signal, sys
from rig_bringup import __main__ as rig

def load(_):
    try:
        {then}
        raise RuntimeError
    except (KeyboardInterrupt, RuntimeError) as error:
        raise ImportError("failed") from error

rig.importlib.import_module = load
sys.argv = ["rig", "up"]
sys.exit(rig.main())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr[-len(said) :]) == (code, said)
    assert ("Traceback" in done.stderr) is (code == 1)


def _say_what_comes(results: Connection) -> None:
    taken: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: taken.append(number))
    let_in()
    results.send(sorted(taken))


def test_a_process_that_was_started_while_signals_are_held_back_takes_them_when_it_is_ready() -> None:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_say_what_comes, args=(there,))
    with held_back():
        process.start()
    # It has not come to its first line.
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(process.pid, number)
    there.close()
    assert here.recv() == [signal.SIGINT, signal.SIGTERM]
    process.join()
    assert process.exitcode == 0
