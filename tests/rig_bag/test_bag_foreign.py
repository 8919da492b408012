"""Bags of others: ROS 1, sqlite3, compressed; other schemas; another version of our messages; all of them damaged."""

from __future__ import annotations

import contextlib
import random
import re
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rosbags.rosbag1
import rosbags.rosbag2
from mcap.writer import Writer as McapWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rig_bag import BagError, BagWriter, info, messages, read
from rig_bag.cli import main
from rig_bag.definitions import full_definition
from rig_bag.export import export
from rig_bag.player import Player
from rig_bag.verify import verify
from rig_study.recorded import TrialError, load
from rig_study.recorded_inputs import load_inputs

WRENCH = "geometry_msgs/msg/WrenchStamped"
TRIAL = "mig_interfaces/msg/TrialState"


def _wrenches(store: Any, *numbered: bool) -> list[Any]:
    kinds = store.types
    vector = kinds["geometry_msgs/msg/Vector3"]
    return [
        kinds[WRENCH](
            kinds["std_msgs/msg/Header"](
                *[number] * len(numbered), kinds["builtin_interfaces/msg/Time"](7, number), "sensor"
            ),
            kinds["geometry_msgs/msg/Wrench"](vector(number + 0.5, 2.0, 3.0), vector(4.0, 5.0, 6.0)),
        )
        for number in range(20)
    ]


def _ros1(folder: Path) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    with rosbags.rosbag1.Writer(folder / "old.bag") as writer:
        connection = writer.add_connection("/wrench", WRENCH, typestore=store)
        for number, message in enumerate(_wrenches(store, True)):
            writer.write(connection, 1000 + number, store.serialize_ros1(message, WRENCH))
    return folder / "old.bag"


def _ros2(folder: Path, **options: Any) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    plugin = options.pop("storage_plugin", rosbags.rosbag2.StoragePlugin.SQLITE3)
    writer = rosbags.rosbag2.Writer(folder / "bag", version=9, storage_plugin=plugin)
    if options:
        writer.set_compression(**options)
    with writer:
        connection = writer.add_connection("/wrench", WRENCH, typestore=store)
        for number, message in enumerate(_wrenches(store)):
            writer.write(connection, 1000 + number, store.serialize_cdr(message, WRENCH))
    return folder / "bag"


def _compressed(mode: rosbags.rosbag2.CompressionMode) -> Callable[[Path], Path]:
    return lambda folder: _ros2(folder, mode=mode, fmt=rosbags.rosbag2.CompressionFormat.ZSTD)


def _without_definitions(folder: Path) -> Path:
    """As sqlite3 bags were before Iron."""
    bag = _ros2(folder)
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3")
    database.close()
    return bag


FOREIGN = {
    "ROS 1": _ros1,
    "sqlite3": _ros2,
    "sqlite3 without definitions": _without_definitions,
    "compressed by message": _compressed(rosbags.rosbag2.CompressionMode.MESSAGE),
    "compressed by file": _compressed(rosbags.rosbag2.CompressionMode.FILE),
}


@pytest.mark.parametrize("make", FOREIGN.values(), ids=FOREIGN)
def test_bags_of_others_are_read_and_exported(make: Callable[[Path], Path], tmp_path: Path) -> None:
    bag = make(tmp_path)
    table = read(bag)["/wrench"]
    np.testing.assert_array_equal(table["log_time"], np.arange(1000, 1020))
    np.testing.assert_array_equal(table["stamp"], 7_000_000_000 + np.arange(20))
    np.testing.assert_array_equal(table["wrench.force"][:, 0], np.arange(20) + 0.5)
    assert set(table["frame_id"]) == {"sensor"}
    assert [message.log_time for message in messages(bag)] == list(range(1000, 1020))
    described = info(bag).metadata
    assert (described.start, described.duration, described.messages) == (1000, 19, 20)
    assert len(export(bag, tmp_path / "tables", "csv")) == 1


def test_a_ros_1_bag_is_described_and_not_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = _ros1(tmp_path)
    assert main(["info", str(bag)]) == 0
    said = capsys.readouterr().out
    assert "Storage id:        rosbag1" in said
    assert f"Topic: /wrench | Type: {WRENCH} | Count: 20" in said
    for verb in ("verify", "repair"):
        assert main([verb, str(bag)]) == 1
        assert "only MCAP bags" in capsys.readouterr().err


@pytest.mark.parametrize("make", [_ros1, _ros2])
def test_bags_of_others_are_played(make: Callable[[Path], Path], single_graph: Any, tmp_path: Path) -> None:
    player = Player(single_graph.node, make(tmp_path), rate=1e9)
    assert player.play() == 20


@pytest.mark.parametrize("make", [_ros1, _ros2])
def test_a_damaged_bag_of_others_is_an_error_or_read(make: Callable[[Path], Path], tmp_path: Path) -> None:
    bag = make(tmp_path)
    file = bag if bag.is_file() else bag / "bag.db3"
    whole = file.read_bytes()
    chance = random.Random(3)
    for _ in range(100):
        data = bytearray(whole)
        at = chance.randrange(1, len(data))
        if chance.random() < 0.5:
            data[at] ^= 1 << chance.randrange(8)
        else:
            del data[at:]
        file.write_bytes(data)
        with contextlib.suppress(BagError):
            read(bag)


def test_other_schemas_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        writer.add_topic("/a", "std_msgs/msg/String")
    with (folder / "bag_0.mcap").open("wb") as stream:
        other = McapWriter(stream)
        other.start(profile="", library="test")
        schema = other.register_schema("thing", "jsonschema", b"{}")
        channel = other.register_channel("/a", "json", schema)
        other.add_message(channel, 1, b'{"a": 1}', 1)
        other.finish()
    with pytest.raises(BagError, match="/a is stored as jsonschema/json; only ros2msg/cdr is read here"):
        read(folder)
    assert not verify(folder).ok


def test_a_type_that_is_nowhere_defined_is_named(tmp_path: Path) -> None:
    bag = _without_definitions(tmp_path)
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute("UPDATE topics SET type = 'no_such_msgs/msg/Thing'")
    database.close()
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(WRENCH, "no_such_msgs/msg/Thing"))
    with pytest.raises(BagError, match="no_such_msgs"):
        read(bag)


# -- another version of our messages ---------------------------------------------------------------------------------

STATE = "mig_interfaces/msg/TaskState"
OLD_STATE = """std_msgs/Header header
uint64 tick
float64 angle
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A bag of a rig whose TaskState had other fields, and a text."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = get_types_from_msg(OLD_STATE, STATE)
    store.register({key: value for key, value in types.items() if key not in store.fielddefs})
    with BagWriter(tmp_path / "old") as writer:
        state = writer.add_topic("/rig/task/state", STATE, definition=OLD_STATE)
        text = writer.add_topic("/text", "std_msgs/msg/String")
        for tick in range(5):
            header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](1, tick), "task")
            message = store.types[STATE](header, tick, 0.25 * tick)
            writer.write(state, bytes(store.serialize_cdr(message, STATE)), tick, tick)
            writer.write(text, b"\0\1\0\0\2\0\0\0a\0", tick, tick)
    return tmp_path / "old"


def test_another_version_of_our_messages_is_read_as_it_was(old: Path) -> None:
    table = read(old)["/rig/task/state"]
    np.testing.assert_array_equal(table["angle"], 0.25 * np.arange(5))
    assert f"{STATE} was recorded with other fields" in verify(old).text()


@pytest.mark.parametrize("lacks", [["surroundings"], ["surroundings", "attempt"]])
def test_a_trial_of_an_older_definition_keeps_its_account(trial_bag: Callable[..., Path], lacks: list[str]) -> None:
    bag = trial_bag(ticks=20, lacks={3})
    text = full_definition(TRIAL)
    for name in lacks:
        text, removed = re.subn(rf"^\S+ {name}\b.*\n", "", text, flags=re.MULTILINE)
        assert removed == 1
    ours, older = get_typestore(Stores.EMPTY), get_typestore(Stores.EMPTY)
    ours.register(get_types_from_msg(full_definition(TRIAL), TRIAL))
    older.register(get_types_from_msg(text, TRIAL))
    with BagWriter(bag.parent / "older") as writer:
        for message in messages(bag):
            of_trial = message.type == TRIAL
            channel = writer.add_topic(message.topic, message.type, definition=text if of_trial else None)
            data = message.data
            if of_trial:
                fields = vars(ours.deserialize_cdr(data, TRIAL))
                values = {name: fields[name] for name, _ in older.fielddefs[TRIAL][1]}
                data = bytes(older.serialize_cdr(older.types[TRIAL](**values), TRIAL))
            writer.write(channel, data, message.log_time, message.publish_time)
    old = verify(bag.parent / "older")
    assert old.ticks["/rig/task/state"] == verify(bag).ticks["/rig/task/state"]
    assert old.ticks["/rig/task/state"]["missing"] == 1
    wrong = {check.name: check.problems for check in old.checks if check.problems}
    assert set(wrong) == {"ticks", "definitions"}
    assert wrong["definitions"] == [f"{TRIAL} was recorded with other fields than the installed definition has"]
    assert read(bag.parent / "older")["/rig/trial/state"][-1].subject == "s07"


def test_what_cannot_be_published_any_more_is_left_out(
    old: Path, single_graph: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    player = Player(single_graph.node, old, rate=1e9)
    assert list(player.publishers) == ["/text"]
    assert "/rig/task/state is not played: " in capfd.readouterr().err
    assert player.play() == 5


@pytest.mark.parametrize("reads", [load, load_inputs])
def test_a_trial_of_another_version_is_a_clear_error(old: Path, reads: Callable[[Path], Any]) -> None:
    with pytest.raises(TrialError, match=r"/rig/task/state has no .*state.*: it was recorded with another version"):
        reads(old)
