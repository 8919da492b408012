"""Playing, and the command line."""

from __future__ import annotations

import itertools
import os
import re
import signal
import subprocess
import sys
import termios
import threading
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock as Time
from std_msgs.msg import String
from std_srvs.srv import Trigger

from rig_bag import BagError, BagWriter, info, messages
from rig_bag.cli import main
from rig_bag.keyboard import keys
from rig_bag.player import Player
from rig_bag.player_services import offer, timing
from rig_bag.qos import Qos, load_overrides

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


def test_a_part_of_it_plays_under_other_names_with_a_clock(single_graph: Any, bag: Path) -> None:
    graph = single_graph
    received: list[String] = []
    moments: list[Time] = []
    texts = graph.node.create_subscription(String, "/other", received.append, QoSProfile(depth=100))
    times = graph.node.create_subscription(Time, "/clock", moments.append, QoSProfile(depth=100))
    clock = Clock()
    player = Player(graph.node, bag, start_offset=0.1, duration=0.4, remap={"/a": "/other"}, clock_rate=50, clock=clock)
    graph.until(lambda: bool(texts.get_publisher_count() and times.get_publisher_count()))
    assert player.play(clock.stop) == 4
    graph.until(lambda: len(received) == 4 and len(moments) == 16)
    assert [message.data for message in received] == ["1", "2", "3", "4"]
    offsets = [moment.clock.sec * 10**9 + moment.clock.nanosec - START for moment in moments]
    assert offsets == pytest.approx([100_000_000 + 20_000_000 * tick for tick in range(16)], abs=2)
    assert max(player.lateness) == pytest.approx(0.0, abs=1e-9)


def test_it_pauses_steps_and_goes_on_by_service(single_graph: Any, bag: Path) -> None:
    graph = single_graph
    player = Player(graph.node, bag)
    offer(graph.node, player)

    def call(name: str) -> Any:
        return graph.call(Trigger, f"/rig/probe/{name}", Trigger.Request())

    assert call("play_next").message == "it steps only while it is paused"
    assert call("pause").message == "paused"
    thread = threading.Thread(target=player.play)
    thread.start()
    for count in (1, 2, 3):
        assert call("play_next").success
        graph.until(lambda count=count: len(player.lateness) == count)
    assert player.paused
    assert call("toggle_paused").message == "playing"
    graph.until(lambda: not thread.is_alive())
    assert len(player.lateness) == 10
    assert "10 messages played; late by" in timing(player.lateness)


def test_a_pause_moves_what_comes_after_it(single_graph: Any, bag: Path) -> None:
    clock = Clock()
    player = Player(single_graph.node, bag, clock=clock)
    sent: list[float] = []

    def note(data: bytes) -> None:
        sent.append(clock.now)
        if len(sent) == 4:
            player.pause()
            clock.now += 5.0
            player.resume()

    for name in player.publishers:
        player.publishers[name] = type("Sink", (), {"publish": staticmethod(note)})
    assert player.play(clock.stop) == 10
    steps = [after - before for before, after in itertools.pairwise(sent)]
    assert steps == pytest.approx([0.1] * 3 + [5.1] + [0.1] * 5)


def test_the_rate_may_change_on_the_way(single_graph: Any, bag: Path) -> None:
    clock = Clock()
    player = Player(single_graph.node, bag, clock=clock)
    sent: list[float] = []

    def note(data: bytes) -> None:
        sent.append(clock.now)
        if len(sent) == 4:
            player.set_rate(4.0)
        if len(sent) == 7:
            player.pause()
            player.set_rate(0.5)
            clock.now += 5.0
            player.resume()

    for name in player.publishers:
        player.publishers[name] = type("Sink", (), {"publish": staticmethod(note)})
    assert player.play(clock.stop) == 10
    steps = [after - before for before, after in itertools.pairwise(sent)]
    assert steps == pytest.approx([0.1] * 3 + [0.025] * 3 + [5.2] + [0.2] * 2)
    assert max(player.lateness) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(BagError, match="rate above 0"):
        player.set_rate(0.0)


def test_keys_of_a_terminal_control_it(single_graph: Any, bag: Path) -> None:
    graph = single_graph
    player = Player(graph.node, bag)
    main_end, terminal = os.openpty()
    try:
        before = termios.tcgetattr(terminal)
        with keys(player, terminal) as obeyed:
            assert obeyed
            assert not termios.tcgetattr(terminal)[3] & (termios.ICANON | termios.ECHO)
            os.write(main_end, b" ")
            graph.until(lambda: player.paused)
            thread = threading.Thread(target=player.play)
            thread.start()
            os.write(main_end, b"x\x1b[C")
            graph.until(lambda: len(player.lateness) == 1)
            os.write(main_end, b"\x1b[A\x1b[A\x1b[B")
            graph.until(lambda: player.rate == pytest.approx(1.1 * 1.1 * 0.9))
            assert len(player.lateness) == 1
            os.write(main_end, b" ")
            graph.until(lambda: not thread.is_alive())
        assert termios.tcgetattr(terminal) == before
        assert len(player.lateness) == 10
    finally:
        os.close(main_end)
        os.close(terminal)
    with keys(player, -1) as obeyed:
        assert not obeyed


def test_the_quality_of_service_is_as_recorded_or_as_asked_for(single_graph: Any, bag: Path, tmp_path: Path) -> None:
    graph = single_graph

    def offered(topic: str) -> Qos:
        graph.until(lambda: bool(graph.node.get_publishers_info_by_topic(topic)))
        return Qos.from_rclpy(graph.node.get_publishers_info_by_topic(topic)[0].qos_profile)

    Player(graph.node, bag, topics=["/b"])
    assert (offered("/b").durability, offered("/b").reliability) == ("transient_local", "reliable")
    file = tmp_path / "qos.yaml"
    file.write_text(
        "/a: {reliability: best_effort, history: keep_last, depth: 5, deadline: {sec: 1, nsec: 500}}\n/elsewhere: {}\n"
    )
    Player(graph.node, bag, topics=["/a"], qos=load_overrides(file))
    assert (offered("/a").reliability, offered("/a").deadline) == ("best_effort", 1_000_000_500)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("- 1", "a map of topics"),
        ("{", "cannot be read"),
        ("/a: 3", "/a: a map of policies is wanted"),
        ("/a: {relibility: reliable}", "there is no policy relibility; there are history, depth, reliability"),
        ("/a: {reliability: sometimes}", "reliability is one of reliable, best_effort"),
        ("/a: {deadline: 3}", "deadline is written {sec: 1, nsec: 0}"),
        ("/a: {depth: -1}", "depth is a number of messages, not -1"),
        ("/a: {avoid_ros_namespace_conventions: 1}", "is true or false"),
    ],
)
def test_overrides_that_are_none_are_said(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "qos.yaml").write_text(text)
    with pytest.raises(BagError, match=re.escape(says)):
        load_overrides(tmp_path / "qos.yaml")
    with pytest.raises(BagError, match=r"none\.yaml"):
        load_overrides(tmp_path / "none.yaml")


def test_the_command_plays_the_topics_of_a_pattern(
    single_graph: Any, bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    play = ["play", str(bag), "--rate", "1000"]
    assert main([*play, "--regex", "/[ax]$"]) == 0
    assert "8 messages played" in capsys.readouterr().err
    assert main([*play, "--exclude-topics", "/a", "--start", "0.1", "--duration", "5"]) == 0
    assert "1 messages played" in capsys.readouterr().err
    assert main([*play, "--exclude-regex", "."]) == 1
    assert "no topic is left to play of /a, /b" in capsys.readouterr().err
    assert main([*play, "--regex", "("]) == 1
    assert "is not a regular expression" in capsys.readouterr().err


def test_what_cannot_be_played_is_said(single_graph: Any, bag: Path, tmp_path: Path) -> None:
    node = single_graph.node
    for values, says in (
        ({"topics": ["/c"]}, "has no topic /c; it has /a, /b"),
        ({"rate": 0.0}, "rate above 0"),
        ({"start_offset": -1.0}, "at least 0 s"),
        ({"duration": 0.0}, "more than 0 s"),
        ({"remap": {"/c": "/d"}}, "has no topic /c"),
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
    for wrong in (["play", "--rate", "0", "x"], ["play", "x", "--remap", "a"], ["fly"], []):
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
