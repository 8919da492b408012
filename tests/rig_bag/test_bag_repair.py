"""Repair: a bag cut anywhere becomes a valid one with every complete record; the original is left as it was."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader

from rig_bag import BagError, BagWriter, info, messages
from rig_bag.cli import main
from rig_bag.mcap_records import CHANNEL, CHUNK, MAGIC, MESSAGE, MESSAGE_FIXED, MESSAGE_INDEX, frames
from rig_bag.mcap_salvage import salvage
from rig_bag.repair import repair
from rig_bag.verify import verify

#: How many places a bag is cut at, and how many recorders are killed; RIG_CUTS=500 RIG_KILLS=50 make more of them.
CUTS = int(os.environ.get("RIG_CUTS", "16"))
KILLS = int(os.environ.get("RIG_KILLS", "4"))
MUTATIONS = int(os.environ.get("RIG_FUZZ", "10000")) // 10


def _complete(data: bytes) -> list[tuple[int, int, bytes]]:
    """The messages of the complete records of a cut file, as an independent reader finds them until it fails."""
    found = []
    with contextlib.suppress(Exception):  # of many kinds, at the cut
        for record in StreamReader(io.BytesIO(data), validate_crcs=True).records:
            if isinstance(record, Message):
                found.append((record.log_time, record.publish_time, record.data))
    return found


def _cut_bag(whole: Path, folder: Path, size: int, *, closed: bool) -> Path:
    """A copy whose file is cut; a bag that was not closed has no metadata.yaml."""
    folder.mkdir()
    (folder / "bag_0.mcap").write_bytes((whole / "bag_0.mcap").read_bytes()[:size])
    if closed:
        shutil.copy(whole / "metadata.yaml", folder)
    return folder


def test_a_bag_cut_anywhere_is_repaired(trial_bag: Callable[..., Path], tmp_path: Path) -> None:
    whole = trial_bag(ticks=60)
    data = (whole / "bag_0.mcap").read_bytes()
    chunks = [end for _, end in _chunks(data)]
    chance = random.Random(7)
    places = [chunks[0] + 1, *chunks[1:4], *(end - 1 for end in chunks[1:4]), len(data) - 1]
    places += [chance.randrange(chunks[0], len(data)) for _ in range(CUTS - len(places))]
    for number, size in enumerate(places):
        cut = _cut_bag(whole, tmp_path / f"cut{number}", size, closed=number % 2 == 0)
        before = {file.name: file.read_bytes() for file in cut.iterdir()}
        done = repair(cut)
        assert {file.name: file.read_bytes() for file in cut.iterdir()} == before
        assert done.out == tmp_path / f"cut{number}_repaired"
        expected = _complete(data[:size])
        with AnyReader([done.out]) as reader:
            assert reader.message_count == len(expected)
            assert len(list(reader.messages())) == len(expected)
        with next(done.out.glob("*.mcap")).open("rb") as stream:
            got = [
                (m.log_time, m.publish_time, m.data)
                for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()
            ]
        assert got == sorted(expected, key=lambda message: message[0])
        assert verify(done.out).ok, (size, verify(done.out).text())


def _chunks(data: bytes) -> list[tuple[int, int]]:
    """Begin and end of each chunk, up to where the footer says that the summary begins."""
    summary = int.from_bytes(data[-28:-20], "little")
    return [(begin, end) for kind, begin, _, end in frames(data, len(MAGIC), summary) if kind == CHUNK]


def test_what_was_lost_is_said(
    trial_bag: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = trial_bag(ticks=60)
    data = (whole / "bag_0.mcap").read_bytes()
    cut = _cut_bag(whole, tmp_path / "cut", _chunks(data)[4][0] + 50, closed=False)
    done = repair(cut, tmp_path / "new")
    lost = {entry.topic: entry for entry in done.lost}
    states = list(messages(whole, ["/rig/task/state"]))
    there = list(messages(tmp_path / "new", ["/rig/task/state"]))
    assert 0 < len(there) < len(states)
    assert there == states[: len(there)]
    assert lost["/rig/task/state"].after == there[-1].log_time
    assert info(tmp_path / "new").metadata.custom_data["repaired"] == "true"
    assert info(tmp_path / "new").metadata.custom_data["subject"] == "s07"
    assert main(["repair", str(cut)]) == 0
    said = capsys.readouterr().out
    assert "is cut" in said
    assert "/rig/task/state" in said
    assert main(["repair", str(cut), "--json", "--out", str(tmp_path / "third")]) == 0
    assert json.loads(capsys.readouterr().out)["messages"]["/rig/task/state"] == len(there)


def test_nothing_is_overwritten_and_a_whole_bag_is_left_alone(trial_bag: Callable[..., Path], tmp_path: Path) -> None:
    whole = trial_bag()
    assert repair(whole).out is None
    assert not (tmp_path / "bag_repaired").exists()
    (whole / "metadata.yaml").unlink()
    assert sum(repair(whole).messages.values()) == sum(1 for _ in messages(tmp_path / "bag_repaired"))
    for out in (None, whole):
        with pytest.raises(BagError, match="exists already"):
            repair(whole, out)


def test_what_cannot_be_repaired_is_said(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="there is no bag"):
        repair(tmp_path / "none")
    (tmp_path / "bag").mkdir()
    with pytest.raises(BagError, match="holds no MCAP file"):
        repair(tmp_path / "bag")
    for content, says in (
        (b"", "no MCAP file"),
        (MAGIC, "no complete record"),
        (MAGIC + b"\0" * 99, "no complete record"),
    ):
        (tmp_path / "bag" / "bag_0.mcap").write_bytes(content)
        with pytest.raises(BagError, match=says):
            repair(tmp_path / "bag")


def test_only_the_damaged_chunk_is_lost(trial_bag: Callable[..., Path]) -> None:
    whole = trial_bag(ticks=60)
    file = whole / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[sum(_chunks(bytes(data))[3]) // 2] ^= 4
    file.write_bytes(data)
    stream = io.BytesIO(trial_bag("again", ticks=60).joinpath("again_0.mcap").read_bytes())
    records = [record for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Chunk)]
    done = repair(whole)
    lost = {entry.topic: entry for entry in done.lost}["/rig/task/state"]
    states = [message.log_time for message in messages(whole.with_name("again"), ["/rig/task/state"])]
    gone = [time for time in states if records[3].message_start_time <= time <= records[3].message_end_time]
    assert lost.count == len(gone) > 0
    assert (lost.after, lost.until) == (states[states.index(gone[0]) - 1], states[states.index(gone[-1]) + 1])
    assert done.messages["/rig/task/state"] == 60 - len(gone)
    assert done.out is not None
    found = verify(done.out)
    assert found.ticks["/rig/task/state"]["missing"] == len(gone)
    assert [check.name for check in found.checks if check.problems] == ["ticks"]


def test_the_begin_of_a_cut_chunk_is_used(tmp_path: Path) -> None:
    chance = random.Random(1)
    sent = [bytes(4) + chance.randbytes(1000) for _ in range(900)]
    with BagWriter(tmp_path / "bag", chunk_size=1 << 30) as writer:
        channel = writer.add_topic("/a", "std_msgs/msg/UInt8MultiArray")
        for number, data in enumerate(sent):
            writer.write(channel, data, number, number)
    whole = writer.file.read_bytes()
    found = salvage(whole[:700_000], "it")
    got = found.contents.channels[1].data
    # zstd keeps bytes without pattern as they are, in blocks of at most 128 KiB.
    assert 500 < len(got) == found.unchecked < 700
    assert got == sent[: len(got)]
    assert found.losses[-1].end_time == 899


def _mutants(whole: bytes, count: int) -> Iterator[bytes]:
    chance = random.Random(5)
    for number in range(count):
        data = bytearray(whole)
        at = chance.randrange(len(MAGIC), len(data))
        if number % 3 == 0:
            data[at] ^= 1 << chance.randrange(8)
        elif number % 3 == 1:
            data[at : at + 9] = chance.randbytes(9)
        else:
            data[at:] = bytes(len(data) - at)
        yield bytes(data)


def test_nothing_that_was_not_recorded_comes_out_of_a_damaged_file(trial_bag: Callable[..., Path]) -> None:
    whole = (trial_bag(ticks=12, chunk_size=900) / "bag_0.mcap").read_bytes()

    def stored(contents: Any) -> set[tuple[int, int, bytes]]:
        return {
            row
            for channel in contents.channels.values()
            for row in zip(channel.log_times, channel.publish_times, channel.data, strict=True)
        }

    right = salvage(whole, "it")
    assert right.losses == []
    recorded = stored(right.contents)
    for data in _mutants(whole, MUTATIONS):
        assert stored(salvage(data, "it").contents) <= recorded


def test_an_index_that_became_a_message_is_a_loss(trial_bag: Callable[..., Path]) -> None:
    data = bytearray((trial_bag(ticks=12, chunk_size=900) / "bag_0.mcap").read_bytes())
    count = salvage(bytes(data), "it").contents.count
    indices = [
        (offset, end)
        for opcode, offset, start, end in frames(bytes(data), len(MAGIC), len(data) - len(MAGIC))
        if opcode == MESSAGE_INDEX and end - start >= MESSAGE_FIXED
    ]
    assert len(indices) > 10
    for offset, end in indices:
        data[offset] = MESSAGE
        found = salvage(bytes(data), "it")
        data[offset] = MESSAGE_INDEX
        assert found.contents.count == count
        assert [(loss.start, loss.end) for loss in found.losses] == [(offset, end)]


def test_an_index_that_became_a_message_is_a_loss_where_every_chunk_is_damaged_too(
    trial_bag: Callable[..., Path],
) -> None:
    data = bytearray((trial_bag(ticks=12, chunk_size=1 << 20) / "bag_0.mcap").read_bytes())
    [chunk] = _chunks(bytes(data))
    data[sum(chunk) // 2] ^= 4
    opcode, index, _, end = next(frames(bytes(data), chunk[1], len(data) - len(MAGIC)))
    assert opcode == MESSAGE_INDEX
    data[index] = MESSAGE
    found = salvage(bytes(data), "it")
    assert (found.contents.count, found.orphans) == (0, 0)
    assert [(loss.start, loss.end) for loss in found.losses] == [chunk, (index, end)]
    assert found.contents.channels


def test_a_record_that_became_a_chunk_takes_no_message_from_a_file_without_chunks() -> None:
    stream = io.BytesIO()
    writer = McapWriter(stream, use_chunking=False)
    writer.start()
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/a", "cdr", schema)
    for number in range(9):
        writer.add_message(channel, number, bytes(99), number)
    writer.finish()
    data = bytearray(stream.getvalue())
    for opcode, offset, *_ in list(frames(bytes(data), len(MAGIC), len(data) - len(MAGIC))):
        if opcode in (CHANNEL, MESSAGE):
            data[offset] = CHUNK
            found = salvage(bytes(data), "it")
            data[offset] = opcode
            assert found.contents.count == 9 - (opcode == MESSAGE)


#: It imports nothing of ROS, so that twenty of them start soon.
_RECORD = """
import struct, sys
from rig_bag import BagWriter
writer = BagWriter(sys.argv[1], chunk_size=4000)
channel = writer.add_topic("/text", "std_msgs/msg/String")
for number in range(10**9):
    text = f"{number} ".encode() * (number % 50) + bytes(1)
    writer.write(channel, struct.pack("<4BI", 0, 1, 0, 0, len(text)) + text, number, number)
    if number % 500 == 499:
        writer.flush()
        print(number + 1, flush=True)
        # It runs ahead of who kills it, but not by much.
        sys.stdin.read(1)
"""


@pytest.mark.parametrize("run", range(KILLS))
def test_a_killed_recorder_loses_nothing_that_it_had_flushed(tmp_path: Path, run: int) -> None:
    chance = random.Random(run)
    command = [sys.executable, "-c", _RECORD, str(tmp_path / "bag")]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        process.stdin.write("x" * 8)
        process.stdin.flush()
        # The moment lies anywhere between two lines: so much work of ours passes after one of them.
        for _ in range(chance.randrange(1, 8)):
            flushed = int(process.stdout.readline())
        sum(range(chance.randrange(100_000)))
        process.kill()
        flushed = max([flushed, *map(int, process.stdout.read().split())])
    process.wait()
    done = repair(tmp_path / "bag")
    assert done.out is not None
    times = [message.log_time for message in messages(done.out)]
    assert times == list(range(len(times)))
    assert len(times) >= flushed
    assert verify(done.out).ok
    with AnyReader([done.out]) as reader:
        assert reader.message_count == len(times)
        for connection, log_time, raw in reader.messages():
            assert reader.deserialize(raw, connection.msgtype).data == f"{log_time} " * (log_time % 50)
