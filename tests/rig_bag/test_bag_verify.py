"""Checking a bag: a good one passes, whoever wrote it; whatever is wrong with a bag is found and named."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rosbags.rosbag2
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.typesys import Stores, get_typestore

from mig_interfaces.msg import TaskState
from rig_bag import BagError, BagWriter
from rig_bag.cli import main
from rig_bag.mcap_audit import audit
from rig_bag.mcap_records import DATA_END, MAGIC, MESSAGE_INDEX, frames
from rig_bag.mcap_scan import scan_bytes
from rig_bag.verify import Verification, verify

#: RIG_FUZZ=1000000 tries that many damaged files instead.
MUTATIONS = int(os.environ.get("RIG_FUZZ", "10000"))


def _problems(found: Verification) -> dict[str, list[str]]:
    return {check.name: check.problems for check in found.checks if check.problems}


def test_a_good_bag_passes(trial_bag: Callable[..., Path]) -> None:
    found = verify(trial_bag())
    assert found.ok, found.text()
    assert {check.name: check.result for check in found.checks} == dict.fromkeys(
        ("structure", "checksums", "index", "summary", "metadata.yaml", "stamps", "ticks", "definitions"), "ok"
    )
    assert found.counts["/rig/task/state"] == 40
    for entry in found.ticks.values():
        assert (entry["expected"], entry["received"], entry["missing"]) == (40, 40, 0)
    assert list(found.ticks) == ["/rig/task/state", "/rig/mig_filter/accepted|/rig/mig_filter/rejected"]
    checksums = next(check for check in found.checks if check.name == "checksums")
    assert "data section, summary match" in checksums.notes[0]
    assert not any("carry none" in note for note in checksums.notes)


def test_bags_of_other_writers_pass(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    text = store.types["std_msgs/msg/String"]
    bag = tmp_path / "bag"
    with rosbags.rosbag2.Writer(bag, version=9, storage_plugin=rosbags.rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/text", text.__msgtype__, typestore=store)
        for number in range(20):
            writer.write(connection, number, store.serialize_cdr(text("x" * number), text.__msgtype__))
    found = verify(bag)
    assert found.ok, found.text()
    assert found.counts == {"/text": 20}


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_the_mcap_library_pass(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=200, compression=compression, enable_data_crcs=True)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channels = [writer.register_channel(f"/{name}", "cdr", schema) for name in "abc"]
        for number in range(50):
            writer.add_message(channels[number % 2], number, b"\0\1\0\0\1\0\0\0\0" + bytes(number), number)
        writer.add_attachment(1, 2, "note", "text/plain", b"hello")
        writer.add_metadata("m", {"a": "b"})
        writer.finish()
    found = audit(path.read_bytes(), "a.mcap")
    assert (found.structure, found.index, found.summary) == ([], [], [])
    assert found.checksums["data section"] == found.checksums["summary"] == 1
    assert found.contents is not None
    assert found.contents.count == 50


def test_missing_and_repeated_ticks_are_found(trial_bag: Callable[..., Path]) -> None:
    found = verify(trial_bag(lacks={0, 10, 11, 39}, twice={20}))
    assert set(_problems(found)) == {"ticks"}
    state = found.ticks["/rig/task/state"]
    assert (state["missing"], state["duplicates"], state["received"]) == (4, 1, 37)
    said = " ".join(_problems(found)["ticks"])
    assert "2 missing between the stamps 1000090000000 and 1000120000000 ns" in said
    assert "1 are there twice" in said


def test_a_count_that_is_not_the_recorders_is_found(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/a", "std_msgs/msg/Empty")
        writer.write(channel, b"\0\1\0\0\0", 1, 1)
        writer.add_metadata("completeness", {"count /a": "2", "count /b": "0"})
    assert _problems(verify(tmp_path / "bag")) == {"ticks": ["/a: the recorder counted 2, the files hold 1"]}


def test_stamps_that_go_back_are_found(tmp_path: Path, task_state: Callable[[int], TaskState]) -> None:
    from rclpy.serialization import serialize_message

    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/state", "mig_interfaces/msg/TaskState")
        for number, log_time in enumerate((5, 6, 4, 7)):
            writer.write(channel, serialize_message(task_state(number)), log_time, 0)
    found = verify(tmp_path / "bag")
    assert _problems(found) == {"stamps": ["/state: the time of reception goes back 1 times"]}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("message_count: 7\n", "message_count: 6\n", "/text: metadata.yaml says"),
        ("nanoseconds_since_epoch: 1000000001000", "nanoseconds_since_epoch: 1000000001001", "says start"),
        ("type: std_msgs/msg/String", "type: std_msgs/msg/Bool", "/text: metadata.yaml says std_msgs/msg/Bool"),
        ("seed: '11'", "seed: '12'", "is not what its copy"),
        ("name: /text", "name: /test", "/test: metadata.yaml says"),
    ],
)
def test_metadata_that_is_not_so_is_found(trial_bag: Callable[..., Path], old: str, new: str, says: str) -> None:
    path = trial_bag(ticks=45) / "metadata.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    problems = _problems(verify(path.parent))
    assert set(problems) == {"metadata.yaml"}
    assert any(says in problem for problem in problems["metadata.yaml"]), problems


def test_files_that_are_missing_or_too_many_are_found(trial_bag: Callable[..., Path]) -> None:
    bag = trial_bag()
    whole = (bag / "bag_0.mcap").read_bytes()
    (bag / "bag_1.mcap").write_bytes(whole)
    assert "does not name it" in _problems(verify(bag))["metadata.yaml"][0]
    (bag / "bag_1.mcap").unlink()
    (bag / "metadata.yaml").unlink()
    assert "bag repair" in _problems(verify(bag))["metadata.yaml"][0]
    (bag / "bag_0.mcap").write_bytes(whole[:-100])
    assert "structure" in _problems(verify(bag))
    (bag / "bag_0.mcap").unlink()
    with pytest.raises(BagError, match="holds no MCAP file"):
        verify(bag)


def test_other_definitions_are_found(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        for name, kind, text in (
            ("/same", "Empty", "# another comment\n"),
            ("/other", "String", "string text\n"),
            ("/unknown", "NoSuch", "int8 a\n"),
        ):
            writer.add_topic(name, f"std_msgs/msg/{kind}", definition=text, type_hash="")
    found = verify(tmp_path / "bag")
    check = next(check for check in found.checks if check.name == "definitions")
    assert check.problems == ["std_msgs/msg/String was recorded with other fields than the installed definition has"]
    assert any("only comments differ" in note for note in check.notes)
    assert any("NoSuch is not installed here" in note for note in check.notes)


def test_the_command_tells_by_its_status(trial_bag: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    bag = trial_bag(lacks={3})
    assert main(["verify", str(bag)]) == 1
    said = capsys.readouterr().out
    assert "NOT as it should be" in said
    assert "/rig/mig_filter/accepted|rejected" in said
    assert main(["verify", str(bag), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False
    assert document["ticks"]["/rig/task/state"]["missing"] == 1
    assert main(["verify", str(trial_bag("good"))]) == 0
    assert "undamaged" in capsys.readouterr().out
    assert main(["verify", str(bag / "none")]) == 1
    assert "there is no bag" in capsys.readouterr().err


# -- damage ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def small(trial_bag: Callable[..., Path]) -> bytes:
    """A file of a few chunks, whose every byte can be tried."""
    return (trial_bag(ticks=12, chunk_size=900) / "bag_0.mcap").read_bytes()


def _mutants(whole: bytes, count: int) -> Any:
    """Copies with flipped bits, overwritten runs, and cuts; reproducible."""
    chance = random.Random(4)
    for number in range(count):
        data = bytearray(whole)
        at = chance.randrange(len(data))
        kind = number % 4
        if kind < 2:
            data[at] ^= 1 << chance.randrange(8)
        elif kind == 2:
            data[at : at + 4] = chance.randbytes(4)
        else:
            del data[at:]
        if data != whole:
            yield bytes(data)


def test_a_damaged_file_is_an_error_or_read_rightly(small: bytes) -> None:
    right = scan_bytes(small, "it")
    refused = 0
    for data in _mutants(small, MUTATIONS):
        try:
            assert scan_bytes(data, "it") == right
        except BagError:
            refused += 1
    assert refused > MUTATIONS // 2


def test_every_kind_of_damage_is_found(small: bytes) -> None:
    for data in _mutants(small, MUTATIONS // 10):
        found = audit(data, "it")
        assert found.structure or found.index or found.summary


def _without_checksums(whole: bytes) -> tuple[bytearray, int]:
    """The file as a writer without checksums of data and summary leaves it, and where its data ends."""
    data = bytearray(whole)
    for opcode, offset, start, _ in frames(whole, len(MAGIC)):
        if opcode == DATA_END:
            data[start : start + 4] = bytes(4)
            data[-12:-8] = bytes(4)
            return data, offset
    raise AssertionError


def test_index_and_summary_are_checked_against_the_data_itself(small: bytes) -> None:
    whole, end = _without_checksums(small)
    assert audit(bytes(whole), "it").summary == []
    indexes = [
        range(start, stop) for opcode, _, start, stop in frames(small, len(MAGIC), end) if opcode == MESSAGE_INDEX
    ]
    assert len(indexes) > 5
    summary = range(end + 13, len(whole) - 12)
    for kind, places in (("index", [at for index in indexes for at in index]), ("summary", list(summary))):
        for at in places[:: max(1, 40 * len(places) // MUTATIONS)]:
            whole[at] ^= 0x11
            found = audit(bytes(whole), "it")
            assert getattr(found, kind) or found.structure, (kind, at)
            whole[at] ^= 0x11
