"""kill -9 of the recorder node in a process of its own, at any moment of its life.

`RIG_KILLS=50 ./rig test tests/rig_bag/test_bag_killed_recorder.py -s` kills fifty and says what each one lost; then no
more than 1.5 s may be lost, which says something only of a machine that keeps up.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile

from mig_interfaces.msg import RecorderState, TaskState
from rig_bag import read
from rig_bag.repair import repair
from rig_bag.verify import verify

KILLS = int(os.environ.get("RIG_KILLS", "2"))
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Publishing:
    """A topic at 100 Hz, from a thread: it knows when it published what."""

    def __init__(self, publisher: Any, make: Callable[[int], TaskState]) -> None:
        self._publisher, self._make = publisher, make
        self.times: list[float] = []
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Publishing:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopped.wait(0.01):
            self.times.append(time.monotonic())
            self._publisher.publish(self._make(len(self.times) - 1))


@pytest.mark.parametrize("run", range(KILLS))
def test_a_killed_recorder_leaves_all_but_the_last_second(
    single_graph: Any, tmp_path: Path, task_state: Callable[[int], TaskState], run: int
) -> None:
    graph = single_graph
    chance = random.Random(1000 + run)
    states: list[RecorderState] = []
    graph.node.create_subscription(RecorderState, "recorder/state", states.append, LATCHED)
    publisher = graph.node.create_publisher(TaskState, "task/state", QoSProfile(depth=500))
    bag = tmp_path / "bag"
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "rig_bag.recorder", "--ros-args", "-r", "__ns:=/rig", "-p", f"uri:={bag}"),
            *("-p", "topics:=[task/state]", "-p", "per_tick_topics:=[task/state]"),
            *("-p", "follow_trial:=false"),
        ],
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain)},
        stderr=subprocess.DEVNULL,
    )
    try:
        with Publishing(publisher, task_state) as published:
            graph.until(lambda: bool(states) and states[-1].messages > 0, limit=120.0)
            # In any phase of a second between two flushes, and of a chunk.
            moment = time.monotonic() + chance.uniform(0.0, 4.0)
            graph.until(lambda: time.monotonic() >= moment, limit=120.0)
            process.kill()
            killed = time.monotonic()
            process.wait()
        times = published.times
    finally:
        process.kill()
        process.wait()
    assert not (bag / "metadata.yaml").exists()
    done = repair(bag)
    assert done.out is not None
    found = verify(done.out)
    assert found.ok, found.text()
    ticks = read(done.out)["/rig/task/state"]["tick"].astype(int)
    # What it had said was in the bag; whole and in order from the first that it took.
    assert len(ticks) >= states[-1].messages
    first = int(ticks[0])
    np.testing.assert_array_equal(ticks, np.arange(first, first + len(ticks)))
    lost = killed - times[min(first + len(ticks), len(times) - 1)]
    print(f"run {run}: {len(ticks)} messages kept, the last {max(lost, 0.0):.3f} s lost")
    assert KILLS < 20 or lost <= 1.5
