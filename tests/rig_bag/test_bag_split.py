"""A bag of several files: split by size or by time, read as one by everybody, checked and repaired as one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mcap.reader
import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from rig_bag import BagError, BagWriter, info, messages, read
from rig_bag.describe import describe
from rig_bag.mcap_file import McapFile
from rig_bag.repair import repair
from rig_bag.verify import verify


def _fill(writer: BagWriter, count: int, step: int = 10) -> None:
    a = writer.add_topic("/a", "std_msgs/msg/Int64")
    for number in range(count):
        if number == count // 2:
            writer.add_topic("/late", "std_msgs/msg/Empty")
        writer.write(a, b"\0\1\0\0" + number.to_bytes(8, "little"), number * step, number * step)


def test_a_file_that_is_long_enough_is_followed_by_another(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", max_duration=300) as writer:
        _fill(writer, 100)
    bag = info(tmp_path / "bag")
    assert bag.metadata.files == ("bag_0.mcap", "bag_1.mcap", "bag_2.mcap", "bag_3.mcap")
    assert [(part.start, part.duration, part.messages) for part in bag.metadata.parts] == [
        (0, 290, 30),
        (300, 290, 30),
        (600, 290, 30),
        (900, 90, 10),
    ]
    assert (bag.metadata.start, bag.metadata.duration, bag.metadata.messages) == (0, 990, 100)
    document = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert [file["path"] for file in document["files"]] == list(bag.metadata.files)
    assert "bag_3.mcap" in describe(bag)
    np.testing.assert_array_equal(read(tmp_path / "bag")["/a"]["data"], np.arange(100))
    assert len(read(tmp_path / "bag")["/late"]) == 0
    with AnyReader([tmp_path / "bag"]) as reader:
        found = [reader.deserialize(raw, connection.msgtype).data for connection, _, raw in reader.messages()]
    assert found == list(range(100))
    # Each file is whole by itself.
    for number, file in enumerate(bag.files()):
        with file.open("rb") as stream:
            alone = mcap.reader.make_reader(stream, validate_crcs=True)
            assert sum(1 for _ in alone.iter_messages()) == (10 if number == 3 else 30)
    assert verify(tmp_path / "bag").ok, verify(tmp_path / "bag").text()


def test_a_file_that_is_large_enough_is_followed_by_another(trial_bag: Callable[..., Path], tmp_path: Path) -> None:
    bag = trial_bag(ticks=300, chunk_size=2000, max_size=8000)
    files = sorted(bag.glob("*.mcap"))
    assert len(files) > 3
    # A chunk, the index and the summary come on top; the definitions are in there twice, and not small.
    assert all(8000 <= file.stat().st_size < 40_000 for file in files[:-1])
    found = verify(bag)
    assert found.ok, found.text()
    assert found.ticks["/rig/task/state"]["received"] == 300
    np.testing.assert_array_equal(read(bag)["/rig/task/state"]["tick"], np.arange(300))
    times = [message.log_time for message in messages(bag)]
    assert times == sorted(times)


def test_what_metadata_says_of_each_file_is_checked(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", max_duration=300) as writer:
        _fill(writer, 100)
    file = tmp_path / "bag" / "metadata.yaml"
    text = file.read_text()
    file.write_text(text.replace("message_count: 30", "message_count: 29", 1))
    assert "metadata.yaml says of bag_0.mcap" in verify(tmp_path / "bag").text()
    file.write_text(text)
    (tmp_path / "bag" / "bag_1.mcap").unlink()
    assert not verify(tmp_path / "bag").ok
    with pytest.raises(BagError, match=r"bag_1\.mcap"):
        read(tmp_path / "bag")


def test_a_bag_of_several_files_that_was_cut_is_repaired(trial_bag: Callable[..., Path]) -> None:
    bag = trial_bag(ticks=300, chunk_size=2000, max_size=8000)
    (bag / "metadata.yaml").unlink()
    files = sorted(bag.glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))
    files[-1].write_bytes(files[-1].read_bytes()[:3000])
    done = repair(bag)
    assert done.out is not None
    ticks = read(done.out)["/rig/task/state"]["tick"]
    assert 200 < len(ticks) < 300
    np.testing.assert_array_equal(ticks, np.arange(len(ticks)))


def test_a_disk_that_refuses_the_next_file_leaves_a_closed_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = 0
    begin = McapFile.__init__

    def refuse(self: McapFile, *arguments: Any, **options: Any) -> None:
        nonlocal made
        made += 1
        if made == 3:
            raise OSError(28, "No space left on device")
        begin(self, *arguments, **options)

    monkeypatch.setattr(McapFile, "__init__", refuse)
    writer = BagWriter(tmp_path / "bag", max_duration=300)
    with pytest.raises(BagError, match="No space left on device"):
        _fill(writer, 100)
    writer.close()
    assert [message.log_time for message in messages(tmp_path / "bag")] == list(range(0, 600, 10))
    assert verify(tmp_path / "bag").ok
