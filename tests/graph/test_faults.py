"""Faults done to a live graph of separate processes: what must follow does. How soon is for `./rig faults` to say."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from argparse import Namespace
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from rig_bringup.faults import cli
from rig_bringup.faults.cli import main
from rig_bringup.faults.marked import Marked
from rig_bringup.faults.people import PersonGraph
from rig_bringup.faults.rows import ROWS, Row, Seen

#: Some that make the force zero: a wrench that is bad, or none; a node stopped, killed, started again.
ZERO = ("wrench/nan", "wrench/silent", "filter/stopped", "filter/killed", "task/killed", "person/filter killed")

#: Some that do not: too much; the bag; the clock; a second graph.
OTHERS = ("wrench/duplicated", "recorder/killed", "clock/back", "graph/two in one namespace")


def test_each_kind_of_fault_is_followed_by_what_must_follow(tmp_path: Path) -> None:
    out = tmp_path / "faults.json"
    command = [sys.executable, "-m", "rig_bringup", "faults", *ZERO, *OTHERS, "--untimed", "--out", str(out)]
    surroundings = {**os.environ, "ROS_DOMAIN_ID": str(62 + os.getpid() % 30)}
    done = subprocess.run(command, env=surroundings, capture_output=True, text=True, timeout=550, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads(out.read_text())
    bags = {name for name in results if name.endswith(": the bag")}
    assert bags == {"plain: the bag", "person: the bag", "clock: the bag"}
    assert set(results) - bags == {*ZERO, *OTHERS}
    assert not any(result.get("needs") for result in results.values()), (
        "wherever the rig was built all of this can be done"
    )
    assert all(results[name]["zero"] for name in ZERO)


def test_what_there_is_no_row_for_is_said(capsys) -> None:
    assert main(["wrench/purple"]) == 2
    assert f"no row begins with wrench/purple; rows: {', '.join(ROWS)}" in capsys.readouterr().err
    assert main(["--repeats", "0"]) == 2


def test_a_row_that_was_not_come_to_has_failed_and_the_others_are_done(capfd, monkeypatch, tmp_path: Path) -> None:
    # The process that does the rows does not know of it, and ends.
    monkeypatch.setenv("ROS_DOMAIN_ID", str(62 + os.getpid() % 30))
    monkeypatch.setitem(ROWS, "unknown", Row("a row", "nothing", lambda *_: Seen([]), on=PersonGraph))
    out = tmp_path / "faults.json"
    assert main(["unknown", "start/node interrupted", "--out", str(out)]) == 1
    assert "KeyError: 'unknown'" in capfd.readouterr().err
    results = json.loads(out.read_text())
    assert {name: result["passed"] for name, result in results.items()} == {
        "start/node interrupted": True,
        "plain: the bag": True,
        "unknown": False,
    }
    assert results["unknown"]["remark"] == "not done: what stands above ended it"


def _ends_after_its_rows(results: Connection, names: list[str], _: Namespace) -> None:
    results.send({name: {"passed": True, "zero": [], "stalls": [], "remark": ""} for name in names})
    os._exit(3)


def test_rows_whose_process_ends_before_their_bag_is_checked_are_not_all_well(capsys, monkeypatch) -> None:
    monkeypatch.setattr(cli, "_work", _ends_after_its_rows)
    assert main(["wrench/nan", "wrench/huge"]) == 1
    said = capsys.readouterr()
    assert "error: the process of these rows has ended too early" in said.err
    assert "wrench/nan and what came with it FAILED" in said.out
    assert said.out.endswith("2 of 3 rows are as they must be\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_of_the_command_alone_ends_all_that_it_has_started(
    monkeypatch, tmp_path: Path, number: signal.Signals
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(62 + os.getpid() % 30))
    command = [sys.executable, "-m", "rig_bringup", "faults", "wrench/nan", "filter/killed", "--repeats", "50"]
    with Marked(command, tmp_path / "output.log") as running:
        assert running.wait_for(lambda: "wrench/nan " in running.words(), 120.0), running.words()
        running.signal(number)
        assert running.end(60.0) == 130, running.words()
        assert not running.left(30.0)
    said = (tmp_path / "output.log").read_text()
    assert said.endswith("interrupted\n")
    assert "Traceback" not in said


@pytest.mark.parametrize(("then", "code"), [("signal.raise_signal(signal.SIGTERM)", 0), ("pass", 1)])
def test_an_interrupt_of_which_the_middleware_makes_an_error_is_no_error(then: str, code: int) -> None:
    program = f"""
import signal
from rig_bringup.faults import cli

def do(*_):
    try:
        {then}
    except KeyboardInterrupt as error:
        raise RuntimeError("converted") from error
    raise RuntimeError("failed")

cli._do = do
cli._work(None, [], None)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stderr.endswith("RuntimeError: failed\n") if code else not done.stderr


def test_the_rows_are_listed(capsys) -> None:
    assert main(["--list", "filter"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "filter/stopped",
        "filter/killed",
        "filter/overruns",
    ]
