"""The graph as people start it: `./rig up`, separate processes, one composed process, Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rosbags.highlevel
from mcap.reader import make_reader
from whole_graph import assert_same, data

import rig_bag

SHORT = ["--pacing", "lockstep", "--duration", "2", "--seed", "7"]


def environment() -> dict[str, str]:
    root = Path(__file__).resolve().parents[2]
    return {**os.environ, "RIG_ROOT": str(root), "ROS_DOMAIN_ID": str(62 + os.getpid() % 30)}


def up(out: Path, *arguments: str, limit: float = 200.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rig_bringup", "up", *arguments, "--out", str(out)]
    return subprocess.run(
        command, env=environment(), capture_output=True, text=True, timeout=limit, check=False, stdin=subprocess.DEVNULL
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, subprocess.CompletedProcess[str]]]:
    """The same trial as separate processes and composed."""
    folder = tmp_path_factory.mktemp("runs")
    return {
        "processes": (folder / "processes", up(folder / "processes", *SHORT)),
        "composed": (folder / "composed", up(folder / "composed", *SHORT, "--compose", "--no-report")),
    }


def test_separate_and_composed_are_identical(runs: dict[str, Any]) -> None:
    for _, result in runs.values():
        assert result.returncode == 0, result.stderr
    assert_same(*(data(out / "bag") for out, _ in runs.values()))


def test_what_a_run_leaves(runs: dict[str, Any]) -> None:
    out, result = runs["processes"]
    assert str(out / "bag") in result.stdout
    assert "accepted" in result.stdout
    assert "200, 200 of 200" in result.stdout
    page = (out / "report.html").read_text()
    assert page.count("<svg") >= 4
    assert "time to success" in page
    assert (out / "scenario.yaml").exists()
    assert not (runs["composed"][0] / "report.html").exists()


def test_independent_readers_read_the_bag(runs: dict[str, Any]) -> None:
    bag = runs["processes"][0] / "bag"
    ours = {topic: len(table) for topic, table in rig_bag.read(bag).items()}
    with rosbags.highlevel.AnyReader([bag]) as reader:
        theirs = {connection.topic: connection.msgcount for connection in reader.connections}
        ticks = [
            reader.deserialize(raw, connection.msgtype).tick
            for connection, _, raw in reader.messages(
                [c for c in reader.connections if c.topic == "/rig/mig_filter/decision"]
            )
        ]
    assert theirs == ours
    assert ticks == list(range(200))
    with next(bag.glob("*.mcap")).open("rb") as stream:
        statistics = make_reader(stream).get_summary().statistics
    assert statistics.message_count == sum(ours.values())


def ignore_interrupts() -> None:
    """As a shell has it for what it starts in the background."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.mark.parametrize(("number", "before"), [(signal.SIGINT, None), (signal.SIGTERM, ignore_interrupts)])
def test_interrupted_it_leaves_a_closed_bag_and_no_process(
    tmp_path: Path, number: signal.Signals, before: Callable[[], None] | None
) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "rig_bringup", "up", "--duration", "3600", "--out", str(out), "--no-report"]
    process = subprocess.Popen(
        command,
        env=environment(),
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        preexec_fn=before,  # noqa: PLW1509
    )
    assert process.stderr is not None
    seen = []
    for line in process.stderr:
        seen.append(line)
        if " of 3600.00 s" in line and not line.startswith("  0.00"):
            break
    else:
        pytest.fail("it never ran: " + "".join(seen))
    process.send_signal(number)
    said = process.stderr.read()
    assert process.wait(timeout=60) == 130, said
    assert _processes_with(str(out)) == []
    trial = rig_bag.read(out / "bag", ["/rig/trial/state"])["/rig/trial/state"][-1]
    assert getattr(trial, "message", None) or trial["message"]
    assert len(rig_bag.read(out / "bag", ["/rig/task/state"])["/rig/task/state"]) > 0


def _processes_with(text: str) -> list[str]:
    found = []
    for entry in Path("/proc").iterdir():
        try:
            line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except (OSError, NotADirectoryError):
            continue
        if text in line and entry.name != str(os.getpid()):
            found.append(line)
    return found
