"""What BagWriter writes, read back by two readers that are not ours, and what it does when it cannot write."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mcap.reader
import mcap.stream_reader
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader

from mig_interfaces.msg import TaskState
from rig_bag import BagError, BagWriter
from rig_bag.definitions import full_definition, type_hash
from rig_bag.qos import INFINITE, Qos, parse_profiles, profiles_text

TYPE = "mig_interfaces/msg/TaskState"
START = 1_700_000_000_000_000_000


def _write(path: Path, make: Callable[[int], TaskState], count: int = 300) -> list[TaskState]:
    sent = [make(tick) for tick in range(count)]
    with BagWriter(path, custom_data={"seed": "11"}, chunk_size=4096) as writer:
        channel = writer.add_topic("/rig/task/state", TYPE, [Qos(depth=7, durability="transient_local")])
        writer.add_topic("/silent", "std_msgs/msg/String")
        writer.attach("scenario.yaml", b"seed: 11\n", "application/yaml", 5)
        writer.add_metadata("trial", {"subject": "s07"})
        for tick, message in enumerate(sent):
            writer.write(channel, serialize_message(message), START + tick * 1000, START + tick)
        writer.set_custom_data({"subject": "s07"})
        assert (writer.messages, writer.topics()) == (count, ("/rig/task/state", "/silent"))
    assert writer.closed
    writer.close()
    return sent


def test_metadata_yaml_has_every_field_of_version_9(tmp_path: Path, task_state: Callable[[int], TaskState]) -> None:
    _write(tmp_path / "bag", task_state)
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    document = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    infinite = {"sec": 9223372036, "nsec": 854775807}
    assert document == {
        "rosbag2_bagfile_information": {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": 299_000},
            "starting_time": {"nanoseconds_since_epoch": START},
            "message_count": 300,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": "/rig/task/state",
                        "type": TYPE,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [
                            {
                                "history": "keep_last",
                                "depth": 7,
                                "reliability": "reliable",
                                "durability": "transient_local",
                                "deadline": infinite,
                                "lifespan": infinite,
                                "liveliness": "automatic",
                                "liveliness_lease_duration": infinite,
                                "avoid_ros_namespace_conventions": False,
                            }
                        ],
                        "type_description_hash": type_hash(TYPE),
                    },
                    "message_count": 300,
                },
                {
                    "topic_metadata": {
                        "name": "/silent",
                        "type": "std_msgs/msg/String",
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [],
                        "type_description_hash": type_hash("std_msgs/msg/String"),
                    },
                    "message_count": 0,
                },
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": ["bag_0.mcap"],
            "files": [
                {
                    "path": "bag_0.mcap",
                    "starting_time": {"nanoseconds_since_epoch": START},
                    "duration": {"nanoseconds": 299_000},
                    "message_count": 300,
                }
            ],
            "custom_data": {"seed": "11", "subject": "s07"},
            "ros_distro": os.environ.get("ROS_DISTRO") or "jazzy",
        }
    }


def test_mcap_reads_it(tmp_path: Path, task_state: Callable[[int], TaskState]) -> None:
    sent = _write(tmp_path / "bag", task_state)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = mcap.reader.make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        statistics = summary.statistics
        assert statistics.message_count == 300
        assert statistics.channel_message_counts == {1: 300}
        assert (statistics.message_start_time, statistics.message_end_time) == (START, START + 299_000)
        assert (statistics.schema_count, statistics.channel_count) == (2, 2)
        assert (statistics.attachment_count, statistics.metadata_count) == (1, 2)
        assert statistics.chunk_count == len(summary.chunk_indexes) > 3
        assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
        assert [channel.topic for channel in summary.channels.values()] == ["/rig/task/state", "/silent"]
        channel = summary.channels[1]
        assert channel.message_encoding == "cdr"
        assert channel.metadata["topic_type_hash"] == type_hash(TYPE)
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["durability"] == "transient_local"
        schema = summary.schemas[channel.schema_id]
        assert (schema.name, schema.encoding) == (TYPE, "ros2msg")
        assert schema.data.decode() == full_definition(TYPE)
        read = list(reader.iter_messages())
        assert [deserialize_message(item.data, TaskState) for _, _, item in read] == sent
        assert [(item.log_time, item.publish_time, item.sequence) for _, _, item in read] == [
            (START + tick * 1000, START + tick, tick) for tick in range(300)
        ]
        window = list(reader.iter_messages(starting_at=START + 100_000, ending_before=START + 110_000))
        assert len(window) == 10
        assert [(a.name, a.media_type, a.data, a.create_time) for a in reader.iter_attachments()] == [
            ("scenario.yaml", "application/yaml", b"seed: 11\n", 5)
        ]
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        assert records["trial"] == {"subject": "s07"}
        document = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
        assert yaml.safe_load(records["rosbag2"]["serialized_metadata"]) == document["rosbag2_bagfile_information"]
        stream.seek(0)
        kinds = [
            type(record).__name__ for record in mcap.stream_reader.StreamReader(stream, validate_crcs=True).records
        ]
    assert kinds.count("Message") == 300
    assert kinds[-1] == "Footer"


def test_rosbags_reads_it(tmp_path: Path, task_state: Callable[[int], TaskState]) -> None:
    sent = _write(tmp_path / "bag", task_state)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 300
        assert reader.start_time == START
        assert set(reader.topics) == {"/rig/task/state", "/silent"}
        for message, (connection, log_time, raw) in zip(sent, reader.messages(), strict=True):
            decoded = reader.deserialize(raw, connection.msgtype)
            assert decoded.tick == message.tick
            assert log_time == START + message.tick * 1000
            assert decoded.header.frame_id == "task"
            assert list(decoded.state) == list(message.state)
            assert list(decoded.control) == list(message.control)


def test_an_empty_bag_is_a_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/silent", "std_msgs/msg/String")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 0
    with writer.file.open("rb") as stream:
        summary = mcap.reader.make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 0


def test_what_is_flushed_can_be_read_before_the_close(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/a", "std_msgs/msg/String")
        writer.write(channel, b"\0\1\0\0\2\0\0\0a\0", START, START)
        writer.flush()
        with writer.file.open("rb") as stream:
            records = mcap.stream_reader.StreamReader(stream, skip_magic=False).records
            kinds = [type(next(records)).__name__ for _ in range(4)]
        assert kinds == ["Header", "Schema", "Channel", "Message"]


def test_a_definition_carries_what_it_needs_once() -> None:
    text = full_definition("mig_interfaces/msg/EndEffectorState")
    header = (Path(get_package_share_directory("std_msgs")) / "msg" / "Header.msg").read_text().rstrip("\n")
    separator = "=" * 80
    assert text.count(separator) == 3
    assert f"{separator}\nMSG: std_msgs/Header\n{header}\n{separator}" in text
    assert text.count("MSG: geometry_msgs/Vector3\n") == text.count("MSG: builtin_interfaces/Time\n") == 1


def test_the_hash_is_that_of_the_installed_type() -> None:
    path = Path(get_package_share_directory("mig_interfaces")) / "msg" / "TaskState.json"
    assert type_hash(TYPE) == json.loads(path.read_text())["type_hashes"][0]["hash_string"]
    assert type_hash(TYPE).startswith("RIHS01_")


def test_profiles_round_trip_and_older_numbers_are_understood() -> None:
    profiles = (
        Qos(),
        Qos("keep_all", 0, "best_effort", "transient_local", 5, 2_000_000_001, "manual_by_topic", INFINITE, True),
    )
    assert parse_profiles(profiles_text(profiles)) == profiles
    old = "- {history: 1, depth: 3, reliability: 2, durability: 1, liveliness: 1}"
    assert parse_profiles(old) == (Qos("keep_last", 3, "best_effort", "transient_local"),)
    assert parse_profiles("") == ()


# -- what goes wrong -------------------------------------------------------------------------------------------------


def test_an_existing_bag_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path / "bag")
    assert not any((tmp_path / "bag").iterdir())


@pytest.mark.parametrize("parent", ["file", "proc"])
def test_an_unwritable_folder_is_named(tmp_path: Path, parent: str) -> None:
    (tmp_path / "file").write_text("")
    path = {"file": tmp_path / "file" / "bag", "proc": Path("/proc/bag")}[parent]
    with pytest.raises(BagError, match=str(path)):
        BagWriter(path)


def test_unknown_types_and_changed_types_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        with pytest.raises(BagError, match="no_such_msgs is not installed"):
            writer.add_topic("/a", "no_such_msgs/msg/A")
        with pytest.raises(BagError, match="std_msgs"):
            writer.add_topic("/a", "std_msgs/msg/NoSuch")
        first = writer.add_topic("/a", "std_msgs/msg/String")
        assert writer.add_topic("/a", "std_msgs/msg/String") is first
        with pytest.raises(BagError, match="has the type std_msgs/msg/String"):
            writer.add_topic("/a", "std_msgs/msg/Bool")
    with pytest.raises(BagError, match="is closed"):
        writer.write(first, b"", 0, 0)


_FILL = """
import os, resource, signal, sys
from rig_bag import BagError, BagWriter
limit, path = int(sys.argv[1]), sys.argv[2]
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
writer = BagWriter(path)
channel = writer.add_topic("/a", "std_msgs/msg/UInt8MultiArray")
try:
    for number in range(100_000):
        writer.write(channel, bytes(4) + os.urandom(1000), number, number)
except BagError as error:
    print(error)
try:
    writer.close()
except BagError as error:
    print("again", error)
try:
    writer.write(channel, b"", 0, 0)
except BagError as error:
    print(error)
"""


def _check_what_is_left(bag: Path, output: str, capacity: int) -> None:
    lines = output.splitlines()
    assert len(lines) == 2, output
    assert f"cannot write {bag / 'bag_0.mcap'}: " in lines[0]
    assert " messages)" in lines[0]
    assert lines[0] == lines[1]
    with AnyReader([bag]) as reader:
        count = reader.message_count
        assert [log_time for _, log_time, _ in reader.messages()] == list(range(count))
    # All that fits: at most two chunks gave way to the summary.
    assert count * 1000 > capacity - 3 * 70_000
    with (bag / "bag_0.mcap").open("rb") as stream:
        assert sum(1 for _ in mcap.reader.make_reader(stream, validate_crcs=True).iter_messages()) == count


def test_a_file_that_may_not_grow_is_closed_in_order(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    command = [sys.executable, "-c", _FILL, "500000", str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    _check_what_is_left(bag, done.stdout, 500_000)


def test_a_full_disk_leaves_a_closed_bag(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", disk], capture_output=True, check=False)
    if mount.returncode:
        pytest.skip("mounting a file system is not permitted here")
    try:
        command = [sys.executable, "-c", _FILL, "0", str(disk / "bag")]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        _check_what_is_left(disk / "bag", done.stdout, 512 * 1024)
    finally:
        subprocess.run(["umount", disk], check=True)
