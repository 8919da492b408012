"""A child does not outlive its parent, whenever that one ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

PROGRAM = """
import os, signal, sys
from rig_runtime.children import end_with_parent

end_with_parent(signal.SIGTERM, int(sys.argv[1]))
print("goes on")
"""


@pytest.mark.parametrize(("there", "said", "code"), [(True, "goes on\n", 0), (False, "", -signal.SIGTERM)])
def test_a_parent_that_has_ended_before_its_child_could_ask_is_noticed(there: bool, said: str, code: int) -> None:
    parent = os.getpid() if there else 0  # no process has the number 0, so that its child has lost it
    done = subprocess.run([sys.executable, "-c", PROGRAM, str(parent)], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == (said, code)


def test_a_child_ends_with_its_parent() -> None:
    child = "import os, signal, time; from rig_runtime.children import end_with_parent; "
    child += "end_with_parent(signal.SIGTERM, os.getppid()); print(flush=True); time.sleep(600)"
    parent = f"import subprocess, sys, time; subprocess.Popen([sys.executable, '-c', {child!r}]); time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"\n"
        running.kill()
        # The child holds the other end of it: there is an end only when it has gone.
        assert running.stdout.read() == b""
