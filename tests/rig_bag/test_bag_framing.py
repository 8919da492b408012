"""All messages of a file framed at once by its index are those found from record to record, whatever the index says."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mcap.writer
import pytest

from rig_bag import BagError
from rig_bag.contents import Contents
from rig_bag.mcap_framing import frame
from rig_bag.mcap_records import CHUNK, MAGIC, MESSAGE_INDEX, frames, parse_chunk
from rig_bag.mcap_scan import scan_bytes


def _foreign(path: Path, **options: Any) -> bytes:
    """Three topics, one of them declared late, without a checksum anywhere."""
    chance = random.Random(3)
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(
            stream, chunk_size=600, compression=mcap.writer.CompressionType.NONE, enable_crcs=False, **options
        )
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channels = [writer.register_channel(name, "cdr", schema) for name in ("/a", "/b")]
        for number in range(60):
            if number == 30:
                channels.append(writer.register_channel("/late", "cdr", schema))
            writer.add_message(chance.choice(channels), number, chance.randbytes(chance.randrange(40)), number + 1)
        writer.finish()
    return path.read_bytes()


def _frame(data: bytes) -> Any:
    section = list(frames(data, len(MAGIC), len(data) - len(MAGIC)))
    chunks = [parse_chunk(data[start:end]).unpack(at) for opcode, at, start, end in section if opcode == CHUNK]
    return frame(data, section, chunks)


def _by_records(data: bytes, monkeypatch: pytest.MonkeyPatch) -> Contents | None:
    with monkeypatch.context() as patch:
        patch.setattr("rig_bag.mcap_scan.frame", lambda *_: None)
        return _scan(data)


def _scan(data: bytes) -> Contents | None:
    try:
        return scan_bytes(data, "it")
    except BagError:
        return None


def test_both_ways_find_the_same(
    trial_bag: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = (trial_bag() / "bag_0.mcap").read_bytes()
    foreign = _foreign(tmp_path / "foreign.mcap")
    for data in (ours, foreign):
        found = _frame(data)
        assert found is not None
        right = _by_records(data, monkeypatch)
        assert right is not None
        assert sum(len(places.begins) for places in found.places.values()) == found.count == right.count > 50
        assert _scan(data) == right


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"index_types": mcap.writer.IndexType.NONE}])
def test_a_file_without_an_index_is_read_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]
) -> None:
    data = _foreign(tmp_path / "foreign.mcap", **options)
    assert _frame(data) is None
    found = _scan(data)
    assert found is not None
    assert found.count == 60
    assert found == _by_records(data, monkeypatch)


def test_an_index_that_lies_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = _foreign(tmp_path / "foreign.mcap")
    right = _scan(whole)
    chance = random.Random(5)
    indexes = [(a, b) for opcode, _, a, b in frames(whole, len(MAGIC), len(whole) - 8) if opcode == MESSAGE_INDEX]
    for _ in range(400):
        data = bytearray(whole)
        a, b = chance.choice(indexes)
        data[chance.randrange(a, b)] ^= 1 << chance.randrange(8)
        assert _scan(bytes(data)) == right


def test_damage_without_a_checksum_is_read_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = _foreign(tmp_path / "foreign.mcap")
    chance = random.Random(6)
    read = 0
    for _ in range(1500):
        data = bytearray(whole)
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        right = _by_records(bytes(data), monkeypatch)
        if right is not None:
            read += 1
            assert _scan(bytes(data)) == right
    assert read > 500
