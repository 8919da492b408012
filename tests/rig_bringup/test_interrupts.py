"""Interrupts are raised where they are asked for."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from rig_bringup.interrupts import Interrupts


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
