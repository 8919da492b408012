"""One pacemaker for each namespace and domain."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import Any

import pytest

from rig_runtime.claim import Claim, ClaimError
from shared_control.parameters import ParameterError
from task_sim_node.node import TaskSimNode

NAMESPACE = f"claimed_{os.getpid()}"


def test_a_namespace_is_claimed_once_in_a_domain() -> None:
    first = Claim(3, f"/{NAMESPACE}")
    with pytest.raises(ClaimError, match=rf"paces /{NAMESPACE} on domain 3.*ROS_DOMAIN_ID"):
        Claim(3, NAMESPACE)
    Claim(4, NAMESPACE).close()
    Claim(3, f"{NAMESPACE}_too").close()
    first.close()
    Claim(3, NAMESPACE).close()


def test_nothing_stays_behind_however_the_process_ends() -> None:
    code = f"from rig_runtime.claim import Claim; c = Claim(5, {NAMESPACE!r}); print('there', flush=True); input()"
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert other.stdout is not None
    assert other.stdin is not None
    assert other.stdout.readline() == b"there\n"
    with pytest.raises(ClaimError):
        Claim(5, NAMESPACE)
    other.send_signal(signal.SIGKILL)
    other.wait()
    other.stdin.close()
    other.stdout.close()
    Claim(5, NAMESPACE).close()


def test_a_second_pacemaker_is_refused(single_graph: Any) -> None:
    first = single_graph.make(TaskSimNode)
    with pytest.raises(ParameterError, match="task_sim: another graph paces /rig"):
        single_graph.make(TaskSimNode)
    single_graph.remove(first)
    single_graph.make(TaskSimNode)
