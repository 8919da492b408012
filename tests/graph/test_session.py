"""`./rig study run` over the real graph: every trial in a verified bag, from wherever the last conductor stopped."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

import rig_bag
from rig_bag.verify import verify
from rig_study.session import LOG, events

PROTOCOL = """
study: {scenario: SCENARIO, duration: 1.0, seed: 3}
groups: {all: {subjects: 1, modes: ["off", training, assistance]}}
sets: {first: {trials: 1}, second: {trials: 1}, third: {trials: 1}}
"""
MODES = {"off": 0, "training": 1, "assistance": 2}


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    scenario = tmp_path / "noise.yaml"
    scenario.write_text("/**/user_sim: {ros__parameters: {user: noise}}\n")
    protocol = tmp_path / "short.yaml"
    protocol.write_text(PROTOCOL.replace("SCENARIO", str(scenario)))
    out = ["--out", str(tmp_path / "sessions")]
    return [sys.executable, "-m", "rig_bringup", "study", "{}", str(protocol), *out]


def words(command: list[str], verb: str, *more: str) -> list[str]:
    return [verb if word == "{}" else word for word in command] + list(more)


def surroundings() -> dict[str, str]:
    return {**os.environ, "ROS_DOMAIN_ID": str(62 + os.getpid() % 30)}


def finished(log: Path) -> list[dict[str, str]]:
    return [event for event in events(log) if event["event"] == "finished"] if log.exists() else []


def test_a_session_of_three_trials_survives_its_conductor(command: list[str], tmp_path: Path) -> None:
    log = tmp_path / "sessions" / "S01" / LOG
    run = words(command, "run", "--subject", "S01", "--pacing", "lockstep", "--compose")
    # The first conductor is killed while it has a trial under way, or just before the second one.
    first = subprocess.Popen(run, env=surroundings(), stdout=subprocess.DEVNULL, start_new_session=True)
    limit = time.monotonic() + 240.0
    while not finished(log) and first.poll() is None and time.monotonic() < limit:
        with suppress(subprocess.TimeoutExpired):
            first.wait(0.02)
    assert finished(log), "the first trial did not end"
    first.send_signal(signal.SIGKILL)
    first.wait()
    done = subprocess.run(run, env=surroundings(), capture_output=True, text=True, timeout=400, check=False)
    assert done.returncode == 0, done.stderr + (tmp_path / "sessions" / "S01" / "graph.log").read_text()

    ended = finished(log)
    assert [event["position"] for event in ended] == [1, 2, 3]
    assert len({event["trial"] for event in events(log) if event["event"] == "started"}) == sum(
        event["event"] == "started" for event in events(log)
    )
    for event, (set_, mode) in zip(ended, zip(("first", "second", "third"), MODES, strict=True), strict=True):
        assert verify(event["bag"]).ok
        bag = rig_bag.read(event["bag"], ["/rig/mig_filter/decision", "/rig/trial/state"])
        assert len(bag["/rig/mig_filter/decision"]) == 100
        assert set(bag["/rig/mig_filter/decision"]["mode"]) == {MODES[mode]}
        last = bag["/rig/trial/state"][-1]
        value = last.__getitem__ if hasattr(last, "dtype") else lambda name, last=last: getattr(last, name)
        assert (value("subject"), value("set"), value("trial")) == ("S01", set_, 1)
    status = subprocess.run(words(command, "status"), capture_output=True, text=True, check=True).stdout
    assert "3/3" in status
