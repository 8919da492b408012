"""From a command to a ready node or a running trial, and the memory that it then has, beside a bare rclpy node."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import loop
import rclpy
from live import LIMIT, in_own_domain
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rows import BenchError, Row, alternate
from std_msgs.msg import String

from mig_interfaces.msg import TrialState
from rig_bringup.up import graph_command
from rig_runtime import topics
from rig_runtime.run import make_executor, wait_until

Watch = Callable[[Node, Callable[[Any], None]], object]


class Started(NamedTuple):
    """A process that was ready."""

    seconds: float
    megabytes: float


def start(command: list[str], watch: Watch) -> Started:
    """Run a command until what it says on its topic lets `watch` call back; it is ended then.

    Raises
    ------
    BenchError: it ends before, or says nothing.
    """
    environment = {**in_own_domain(), "RIG_REALTIME": "off"}
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    observer = rclpy.create_node("observer", namespace="/rig", context=context)
    executor = make_executor(context)
    executor.add_node(observer)
    heard: list[float] = []
    watch(observer, lambda _: heard.append(time.monotonic()))
    begin = time.monotonic()
    process = subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until(lambda: bool(heard) or process.poll() is not None, executor, LIMIT)
        if not heard:
            process.terminate()
            raise BenchError(f"{' '.join(command)} was not ready: {process.communicate()[0].strip()}")
        return Started(heard[0] - begin, _proportional(process.pid))
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)  # `ros2 run` passes no signal on to the node behind it
        process.communicate()
        executor.shutdown()
        observer.destroy_node()
        context.try_shutdown()


def _proportional(pid: int) -> float:
    """Proportional set size [MB]: pages that processes share count in parts."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="utf-8").splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise BenchError("the kernel does not say how much memory a process has")


def _bare() -> Started:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    command = [sys.executable, str(Path(__file__).with_name("bare_node.py"))]
    return start(command, lambda node, ready: node.create_subscription(String, "bare", ready, latched))


def _filter() -> Started:
    command = ["ros2", "run", "mig_filter_node", "mig_filter_node", "--ros-args", "-r", "__ns:=/rig"]
    topic = topics.NODE_REPORT
    # Reports come from the node's executor, which is spun when everything is loaded.
    return start(command, lambda node, ready: node.create_subscription(topic.type, topic.name, ready, topic.qos))


def _graph() -> Started:
    topic = topics.TRIAL_STATE

    def watch(node: Node, ready: Callable[[Any], None]) -> object:
        def follow(trial: TrialState) -> None:
            if trial.phase >= TrialState.PHASE_RUNNING:
                ready(trial)

        return node.create_subscription(topic.type, topic.name, follow, topic.qos)

    with tempfile.TemporaryDirectory() as folder:
        files = loop.parameters(Path(folder), record=True, autostart=True, pacing="realtime")
        return start(graph_command(True, files, "rig"), watch)


def rows(runs: int) -> list[Row]:
    """The filter node, and the composed graph with its recorder."""
    os.environ.setdefault("RIG_ROOT", str(Path(__file__).resolve().parents[1]))
    for warm in (_filter, _graph, _bare):
        warm()
    node, graph, bare = alternate(runs, _filter, _graph, _bare)
    baseline = "a bare rclpy node"
    found = []
    for name, what, started, wanted in (
        ("node", "ros2 run mig_filter_node mig_filter_node to its first report, warm", node, "value <= 2"),
        ("graph", "the composed graph to its first tick, warm", graph, ""),
    ):
        times, memory = zip(*started, strict=True)
        base_times, base_memory = zip(*bare, strict=True)
        found += [
            Row(f"startup.{name}", what, "s", times, baseline, base_times, wanted=wanted),
            Row(f"memory.{name}", "proportional set size then", "MB", memory, baseline, base_memory),
        ]
    return found
