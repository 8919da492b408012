"""What the recorder node takes into a bag, on real rclpy, under both executors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from recorded_loop import LATCHED, make_recorder, matched, written
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from mig_interfaces.msg import TaskState
from rig_bag import info, messages


def test_it_records_what_is_published(graph: Any, tmp_path: Path, task_state: Callable[[int], TaskState]) -> None:
    best_effort = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
    states = graph.node.create_publisher(TaskState, "task/state", QoSProfile(depth=50))
    texts = graph.node.create_publisher(String, "/text", best_effort)
    latched = graph.node.create_publisher(String, "latched", LATCHED)
    latched.publish(String(data="before the recorder"))
    recorder = make_recorder(
        graph,
        uri=str(tmp_path / "bag"),
        topics=["task/state", "/text", "latched", "late"],
        follow_trial=False,
        per_tick_topics=["task/state"],
    )
    assert recorder.intake.wanted == ("/rig/task/state", "/text", "/rig/latched", "/rig/late")
    assert recorder.matched()["/rig/late"] == 0
    graph.until(matched(recorder, states, texts, latched))
    sent = [task_state(tick) for tick in range(20)]
    for message in sent:
        states.publish(message)
        texts.publish(String(data=f"text {message.tick}"))
    graph.until(lambda: written(recorder) >= 41)
    late = graph.node.create_publisher(String, "late", LATCHED)
    late.publish(String(data="late"))
    graph.until(lambda: written(recorder) >= 42)
    recorder.close()
    recorder.close()
    assert recorder.closed.done()
    assert not recorder.failed

    stored: dict[str, list[bytes]] = {}
    for message in messages(tmp_path / "bag"):
        stored.setdefault(message.topic, []).append(message.data)
    assert [deserialize_message(data, TaskState) for data in stored["/rig/task/state"]] == sent
    assert [deserialize_message(data, String).data for data in stored["/text"]] == [f"text {k}" for k in range(20)]
    assert [deserialize_message(data, String).data for data in stored["/rig/latched"]] == ["before the recorder"]
    assert [deserialize_message(data, String).data for data in stored["/rig/late"]] == ["late"]
    with AnyReader([tmp_path / "bag"]) as reader:
        decoded = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/rig/task/state"
        ]
    assert [list(item.state) for item in decoded] == [list(item.state) for item in sent]

    entries = {entry.name: entry for entry in info(tmp_path / "bag").metadata.topics}
    assert [entries[name].qos[0].reliability for name in ("/rig/task/state", "/text")] == ["reliable", "best_effort"]
    assert entries["/rig/latched"].qos[0].durability == "transient_local"
    assert entries["/rig/task/state"].type_hash.startswith("RIHS01_")
    log_times = [message.log_time for message in messages(tmp_path / "bag")]
    assert log_times[0] > 1_600_000_000_000_000_000


def test_patterns_and_types_that_are_not_there(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    publishers = {
        name: graph.node.create_publisher(String, name, LATCHED)
        for name in ("a/one", "a/two", "a/not", "b", "_hidden/a")
    }
    for publisher in publishers.values():
        publisher.publish(String(data="x"))
    recorder = make_recorder(
        graph, uri=str(tmp_path / "bag"), topics=[""], regex="/a/", exclude_regex="not", follow_trial=False
    )
    graph.until(lambda: written(recorder) >= 2)
    late = graph.node.create_publisher(String, "a/late", LATCHED)
    late.publish(String(data="y"))
    graph.until(lambda: written(recorder) >= 3)
    recorder.close()
    assert {message.topic for message in messages(tmp_path / "bag")} == {"/rig/a/one", "/rig/a/two", "/rig/a/late"}


def test_a_bag_is_split_and_labelled_as_asked_for(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    (tmp_path / "qos.yaml").write_text("/text: {reliability: best_effort, depth: 7}\n")
    publishers = [graph.node.create_publisher(String, name, QoSProfile(depth=100)) for name in ("/text", "/other")]
    recorder = make_recorder(
        graph,
        uri=str(tmp_path / "bag"),
        topics=[""],
        regex="^/(text|other)$",
        exclude_topics=["/other"],
        follow_trial=False,
        max_bag_size=1,
        custom_data=["subject=s07", "note=a=b"],
        qos_profile_overrides_path=str(tmp_path / "qos.yaml"),
    )
    graph.until(matched(recorder, publishers[0]))
    readers = graph.node.get_subscriptions_info_by_topic("/text")
    assert [reader.qos_profile.reliability for reader in readers] == [ReliabilityPolicy.BEST_EFFORT]
    for number in range(3):
        publishers[0].publish(String(data=f"{number}"))
        before = recorder.recording.writer.file
        graph.until(lambda number=number: recorder.recording.writer.messages >= number + 1)
        recorder.recording.writer.flush()
        assert number == 0 or recorder.recording.writer.file != before
    recorder.close()
    metadata = info(tmp_path / "bag").metadata
    assert len(metadata.files) == 3
    assert [topic.name for topic in metadata.topics] == ["/text"]
    assert (metadata.custom_data["subject"], metadata.custom_data["note"]) == ("s07", "a=b")
    assert [message.data[8:9] for message in messages(tmp_path / "bag", ["/text"])] == [b"0", b"1", b"2"]


def test_a_topic_is_recorded_on_when_its_publisher_comes_back(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), topics=["text"], follow_trial=False)
    for number in range(2):
        publisher = graph.node.create_publisher(String, "text", QoSProfile(depth=100))
        graph.until(matched(recorder, publisher))
        publisher.publish(String(data="x"))
        graph.until(lambda number=number: written(recorder) == number + 1)
        graph.node.destroy_publisher(publisher)
        graph.until(lambda: not recorder.matched()["/rig/text"])
    recorder.close()
    assert len(list(messages(tmp_path / "bag"))) == 2
