"""Exported tables hold what the bag holds, number by number."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from pyarrow import parquet
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader

from rig_bag import BagError, BagWriter, read
from rig_bag.cli import main
from rig_bag.export import export


def _table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_csv_equals_an_independent_reader(trial_bag: Callable[..., Path], tmp_path: Path) -> None:
    bag = trial_bag()
    assert main(["export", str(bag), "--to", str(tmp_path / "out")]) == 0
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == [
        *("rig.mig_filter.accepted.csv", "rig.mig_filter.rejected.csv", "rig.task.state.csv", "rig.trial.state.csv"),
        "text.csv",
    ]
    rows = _table(tmp_path / "out" / "rig.task.state.csv")
    with AnyReader([bag]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == "/rig/task/state"]
        for row, (connection, log_time, raw) in zip(rows, reader.messages(wanted), strict=True):
            message = reader.deserialize(raw, connection.msgtype)
            assert int(row["log_time"]) == log_time
            assert int(row["stamp"]) == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert [float(row[f"state.{index}"]) for index in range(4)] == list(message.state)
            assert (int(row["tick"]), float(row["time"])) == (message.tick, message.time)
    assert "wrench.force.x" in _table(tmp_path / "out" / "rig.mig_filter.accepted.csv")[0]
    assert _table(tmp_path / "out" / "rig.trial.state.csv")[-1]["subject"] == "s07"


def test_npz_holds_the_arrays(trial_bag: Callable[..., Path], tmp_path: Path) -> None:
    bag = trial_bag()
    (path,) = export(bag, tmp_path, "npz", ["/rig/task/state"])
    state = read(bag, ["/rig/task/state"])["/rig/task/state"]
    with np.load(path) as columns:
        np.testing.assert_array_equal(columns["state.2"], state["state"][:, 2])
        np.testing.assert_array_equal(columns["tick"], state["tick"])
        np.testing.assert_array_equal(columns["frame_id"], state["frame_id"])


def test_messages_of_changing_length_have_empty_cells(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        for number in (1, 2):
            status = [DiagnosticStatus(name=f"n{index}") for index in range(number)]
            writer.write(channel, serialize_message(DiagnosticArray(status=status)), number, number)
    (path,) = export(tmp_path / "bag", tmp_path / "out")
    assert [row["status.1.name"] for row in _table(path)] == ["", "n1"]
    assert [row["status.0.name"] for row in _table(path)] == ["n0", "n0"]


def test_parquet_holds_the_columns(trial_bag: Callable[..., Path], tmp_path: Path) -> None:
    bag = trial_bag()
    (path,) = export(bag, tmp_path, "parquet", ["/rig/task/state"])
    table = parquet.read_table(path)
    assert table["state.0"].to_pylist() == read(bag, ["/rig/task/state"])["/rig/task/state"]["state"][:, 0].tolist()


def test_what_cannot_be_exported_is_said(
    trial_bag: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = trial_bag()
    with pytest.raises(BagError, match="csv, npz, parquet"):
        export(bag, tmp_path, "xls")
    with pytest.raises(BagError, match="has no topic /none"):
        export(bag, tmp_path, "csv", ["/none"])
    export(bag, tmp_path, "csv", ["/text"])
    with pytest.raises(BagError, match="exists already"):
        export(bag, tmp_path, "csv", ["/text"])
    with pytest.raises(BagError, match="cannot write"):
        export(bag, "/proc/none", "csv")
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(BagError, match="pip install pyarrow"):
        export(bag, tmp_path, "parquet")
