"""Faults done to a live graph of separate processes: what must follow does. How soon is for `./rig faults` to say."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from rig_bringup.faults.cli import main

#: One of each kind: a bad wrench, none, too many; a node stopped, killed and started again; the pacemaker; the bag.
ROWS = ("wrench/nan", "wrench/silent", "wrench/duplicated", "filter/stopped", "filter/killed", "task/killed")


def test_each_kind_of_fault_is_followed_by_what_must_follow(tmp_path: Path) -> None:
    out = tmp_path / "faults.json"
    command = [sys.executable, "-m", "rig_bringup", "faults", *ROWS, "recorder/killed", "--untimed", "--out", str(out)]
    surroundings = {**os.environ, "ROS_DOMAIN_ID": str(62 + os.getpid() % 30)}
    done = subprocess.run(command, env=surroundings, capture_output=True, text=True, timeout=550, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads(out.read_text())
    assert set(results) == {*ROWS, "recorder/killed"}
    assert all(
        result["zero"] for name, result in results.items() if name not in ("wrench/duplicated", "recorder/killed")
    )


def test_what_there_is_no_row_for_is_said(capsys) -> None:
    assert main(["wrench/purple"]) == 2
    assert "no row begins with wrench/purple; rows: wrench/nan" in capsys.readouterr().err
    assert main(["--repeats", "0"]) == 2


def test_the_rows_are_listed(capsys) -> None:
    assert main(["--list", "filter"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["filter/stopped", "filter/killed"]
