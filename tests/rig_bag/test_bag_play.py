"""Playing, and the command line."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from rig_bag import BagError, BagWriter, info, messages
from rig_bag.cli import main
from rig_bag.player import Player
from rig_bag.qos import Qos

START = 1_700_000_000_000_000_000


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        a = writer.add_topic("/a", "std_msgs/msg/String", [Qos()])
        b = writer.add_topic("/b", "std_msgs/msg/String", [Qos(durability="transient_local", depth=3)])
        for number in range(10):
            data = serialize_message(String(data=f"{number}"))
            writer.write(b if number % 5 == 0 else a, data, START + number * 100_000_000, 0)
    return path


class Clock:
    """Time that passes only by waiting."""

    def __init__(self) -> None:
        self.now = 100.0
        self.stop = threading.Event()
        self.waits: list[float] = []
        self.stop.wait = self._wait  # type: ignore[method-assign]

    def __call__(self) -> float:
        return self.now

    def _wait(self, timeout: float | None = None) -> bool:
        assert timeout is not None
        self.waits.append(timeout)
        self.now += timeout
        return False


def test_the_stored_bytes_are_published(graph: Any, bag: Path) -> None:
    received: dict[str, list[bytes]] = {"/a": [], "/b": []}
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    readers = [
        graph.node.create_subscription(String, name, received[name].append, qos, raw=True)
        for name, qos in (("/a", QoSProfile(depth=100)), ("/b", latched))
    ]
    clock = Clock()
    player = Player(graph.node, bag, clock=clock)
    writers = player.publishers.values()
    graph.until(
        lambda: (
            all(reader.get_publisher_count() for reader in readers)
            and all(writer.get_subscription_count() for writer in writers)
        )
    )
    assert player.play(clock.stop) == 10
    graph.until(lambda: sum(map(len, received.values())) == 10)
    for name, data in received.items():
        assert data == [message.data for message in messages(bag, [name])]


@pytest.mark.parametrize(("rate", "offset", "first"), [(1.0, 0.0, 0), (4.0, 0.0, 0), (0.5, 0.35, 4)])
def test_it_keeps_the_times(single_graph: Any, bag: Path, rate: float, offset: float, first: int) -> None:
    clock = Clock()
    player = Player(single_graph.node, bag, rate=rate, start_offset=offset, clock=clock)
    assert player.play(clock.stop) == 10 - first
    assert clock.now - 100.0 == pytest.approx((0.9 - offset) / rate)
    steps = [wait for wait in clock.waits if wait > 1e-9]
    assert steps[1:] == pytest.approx([0.1 / rate] * (len(steps) - 1))


def test_it_plays_only_what_is_asked_for_and_stops_when_told(single_graph: Any, bag: Path) -> None:
    player = Player(single_graph.node, bag, topics=["/b"])
    assert [message.topic for message in player.messages] == ["/b", "/b"]
    stop = threading.Event()
    stop.set()
    assert player.play(stop) == 0


def test_what_cannot_be_played_is_said(single_graph: Any, bag: Path, tmp_path: Path) -> None:
    node = single_graph.node
    for values, says in (
        ({"topics": ["/c"]}, "has no topic /c; it has /a, /b"),
        ({"rate": 0.0}, "rate above 0"),
        ({"start_offset": -1.0}, "at least 0 s"),
        ({"start_offset": 5.0}, r"nothing to play after 5\.0 s"),
    ):
        with pytest.raises(BagError, match=says):
            Player(node, bag, **values)
    with pytest.raises(BagError, match="there is no bag"):
        Player(node, tmp_path / "none")


def test_info_prints_what_ros2_bag_info_prints(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(bag)]) == 0
    size = info(bag).size / 1024
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == ""
    assert lines[1:6] == [
        "Files:             bag_0.mcap",
        f"Bag size:          {size:.1f} KiB",
        "Storage id:        mcap",
        f"ROS Distro:        {os.environ.get('ROS_DISTRO') or 'jazzy'}",
        "Duration:          0.900000000s",
    ]
    moment = r"[A-Z][a-z]{2} [ \d]\d \d{4} \d\d:\d\d:\d\d\.\d{9} "
    assert re.fullmatch(rf"Start:             {moment}\(1700000000\.000000000\)", lines[6])
    assert re.fullmatch(rf"End:               {moment}\(1700000000\.900000000\)", lines[7])
    assert lines[8:] == [
        "Messages:          10",
        "Topic information: Topic: /a | Type: std_msgs/msg/String | Count: 8 | Serialization Format: cdr",
        "                   Topic: /b | Type: std_msgs/msg/String | Count: 2 | Serialization Format: cdr",
        "Service:           0",
        "Service information: ",
    ]
    assert main(["info", "-t", str(bag)]) == 0
    assert capsys.readouterr().out == "/a\n/b\n"


def test_errors_are_one_sentence_and_a_status(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(tmp_path / "none")]) == 1
    assert capsys.readouterr().err == f"error: there is no bag {tmp_path / 'none'}\n"
    assert main(["record"]) == 1
    assert "--all or --regex" in capsys.readouterr().err
    for wrong in (["play", "--rate", "0", "x"], ["fly"], []):
        with pytest.raises(SystemExit) as ended:
            main(wrong)
        assert ended.value.code == 2


def test_record_on_the_command_line_flushes_within_its_period_and_closes(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    publisher = graph.node.create_publisher(
        String, "/text", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    publisher.publish(String(data="x" * 2000))
    path = tmp_path / "bag"
    process = subprocess.Popen(
        [sys.executable, "-m", "rig_bag.cli", "record", "-o", str(path), "/text"],
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain)},
        stderr=subprocess.PIPE,
        text=True,
    )
    file = path / "bag_0.mcap"
    try:
        # The message is far smaller than a chunk: only the flush brings it to the disk.
        graph.until(lambda: file.exists() and b"\x28\xb5\x2f\xfd" in file.read_bytes(), limit=120.0)
        process.send_signal(signal.SIGINT)
        graph.until(lambda: process.poll() is not None, limit=120.0)
    finally:
        process.kill()
        _, errors = process.communicate()
    assert process.returncode == 0, errors
    assert [message.topic for message in messages(path)] == ["/text"]
    node_name = re.search(r"\[(\w+)\]: recording to", errors)
    assert node_name is not None
    assert node_name[1] == "rosbag2_recorder"
