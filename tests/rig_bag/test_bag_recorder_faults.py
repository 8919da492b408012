"""The recorder when something goes wrong: clock, publishers, disk, parameters, and signals to its process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from recorded_loop import LATCHED, Loop, make_recorder, matched, overrides, retime, written
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from mig_interfaces.msg import RecorderState, TaskState, TrialState
from rig_bag import BagError, info, messages, read
from rig_bag.mcap_scan import scan
from rig_bag.recorder import RecorderNode
from rig_bag.verify import verify


def test_a_clock_that_is_set_does_not_move_the_bags_times(
    single_graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    graph = single_graph
    set_by = [0]
    monkeypatch.setattr("rig_bag.recorder._wall", lambda: time.time_ns() + set_by[0])
    retime(monkeypatch, ["/rig/text"], lambda told: told + set_by[0])
    publisher = graph.node.create_publisher(String, "text", QoSProfile(depth=100))
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), topics=["text"], follow_trial=False)
    graph.until(matched(recorder, publisher))
    for hours in (0, -5, 3):
        set_by[0] = hours * 3_600_000_000_000
        recorder._watch()
        before = written(recorder)
        publisher.publish(String(data="x"))
        graph.until(lambda before=before: written(recorder) == before + 1)
    recorder.close()
    said = capfd.readouterr().err
    assert "clock was set by -18000." in said
    assert "clock was set by +28800." in said
    stored = list(messages(tmp_path / "bag"))
    for times in ([message.log_time for message in stored], [message.publish_time for message in stored]):
        assert times == sorted(times)
        assert times[-1] - times[0] < 3_600_000_000_000
    account = dict(scan(tmp_path / "bag" / "bag_0.mcap").metadata)["completeness"]
    jumps = json.loads(account["clock jumps [ns]"])
    assert [round(jump / 3_600_000_000_000) for jump in jumps] == [-5, 8]
    assert verify(tmp_path / "bag").ok


def test_publishers_that_vanish_are_named_and_a_trial_without_its_pacemaker_ends_its_bag(
    single_graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState], capfd: pytest.CaptureFixture[str]
) -> None:
    graph = single_graph
    loop = Loop(graph, trial_state)
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), settle_limit=0.2)
    graph.until(matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_ARMING)
    loop.announce(TrialState.PHASE_RUNNING)
    for tick in range(10):
        loop.tick(tick)
    graph.until(lambda: written(recorder) >= 62)
    recorder._watch()
    graph.node.destroy_publisher(loop.publishers["mig_filter/decision"])
    graph.until(lambda: not recorder.matched()["/rig/mig_filter/decision"])
    recorder._watch()
    assert "no longer published: /rig/mig_filter/decision" in capfd.readouterr().err
    assert not recorder.closed.done()
    graph.node.destroy_publisher(loop.trial)
    graph.until(recorder.closed.done)
    assert recorder.closed.result() == "the publisher of /rig/trial/state vanished during the trial"
    assert not recorder.failed
    found = verify(tmp_path / "bag")
    assert found.ok, found.text()
    assert found.counts["/rig/task/state"] == 10
    assert info(tmp_path / "bag").metadata.custom_data["complete"] == "false"


def test_faults_at_the_start_leave_no_node(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    (tmp_path / "there").mkdir()
    for values, says in (
        ({"uri": str(tmp_path / "there")}, "exists already"),
        ({"uri": str(tmp_path / "a"), "regex": "("}, "not a regular expression"),
        ({"uri": str(tmp_path / "a"), "exclude_regex": "("}, "not a regular expression"),
        ({"uri": str(tmp_path / "a"), "qos_profile_overrides_path": str(tmp_path / "none")}, "cannot be read"),
        ({"uri": "/proc/bag"}, "cannot make the bag /proc/bag"),
        ({"uri": str(tmp_path / "b"), "attachments": [str(tmp_path / "none.yaml")]}, "cannot attach"),
    ):
        with pytest.raises(BagError, match=says):
            RecorderNode(namespace="/rig", context=graph.context, parameter_overrides=overrides(**values))
    assert graph.node.get_node_names() == ["probe"]


def test_a_disk_that_fills_closes_the_bag_and_says_so(
    single_graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = single_graph
    states: list[RecorderState] = []
    graph.node.create_subscription(RecorderState, "recorder/state", states.append, LATCHED)
    publisher = graph.node.create_publisher(String, "text", QoSProfile(depth=100))
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), topics=["text"], follow_trial=False)
    graph.until(matched(recorder, publisher))
    write = os.pwrite

    def full(descriptor: int, data: bytes, offset: int) -> int:
        if offset + len(data) > 60_000:
            raise OSError(28, "No space left on device")
        return write(descriptor, data, offset)

    monkeypatch.setattr(os, "pwrite", full)
    for _ in range(10):
        publisher.publish(String(data=os.urandom(10_000).hex()))
    graph.until(lambda: recorder.closed.done() and bool(states) and not states[-1].recording)
    assert recorder.failed
    assert "No space left on device" in states[-1].message
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count < 10


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_closed_bag_with_all_that_has_come(
    single_graph: Any,
    tmp_path: Path,
    number: int,
    task_state: Callable[[int], TaskState],
    trial_state: Callable[..., TrialState],
) -> None:
    graph = single_graph
    states: list[RecorderState] = []
    graph.node.create_subscription(RecorderState, "recorder/state", states.append, LATCHED)
    # Latched: from here it cannot be seen when the other process has found this publisher. Of a history that is full,
    # as this one is by the last message, acknowledgements are asked for at once, and not every 3 s.
    latched = QoSProfile(depth=40, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = graph.node.create_publisher(TaskState, "task/state", latched)
    # In a trial that is paced by wall time it looks for messages only now and then.
    trial = graph.node.create_publisher(TrialState, "trial/state", LATCHED)
    trial.publish(trial_state(TrialState.PHASE_RUNNING))
    bag = tmp_path / "bag"
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "rig_bag.recorder", "--ros-args", "-r", "__ns:=/rig"),
            *("-p", f"uri:={bag}", "-p", "topics:=[task/state]", "-p", "per_tick_topics:=[task/state]"),
        ],
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain)},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        for tick in range(30):
            publisher.publish(task_state(tick))
        graph.until(lambda: bool(states) and states[-1].messages == 31, limit=120.0)
        for tick in range(30, 40):
            publisher.publish(task_state(tick))
        assert publisher.wait_for_all_acked(Duration(seconds=10))
        process.send_signal(number)
        graph.until(lambda: process.poll() is not None, limit=120.0)
    finally:
        process.kill()
        _, errors = process.communicate()
    assert process.returncode == 0, errors
    assert len(read(bag)["/rig/task/state"]) == 40
    assert info(bag).metadata.custom_data["closed_because"] == "the recorder was told to end"
    with AnyReader([bag]) as reader:
        assert reader.message_count == 41
