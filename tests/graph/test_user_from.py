"""`up --user-from`: the recorded user in front of the live graph gives the same messages, tick for tick."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from whole_graph import assert_same, data, sections

import rig_bag
from rig_bag import BagWriter
from rig_bag.verify import verify
from rig_bringup import up
from rig_bringup.scenario import Checked
from rig_study.recorded_inputs import load_inputs
from rig_study.rederive import rederive
from shared_control import scenario as science

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RIG_ROOT", str(ROOT))


def test_the_same_messages_come_again(run_composed: Callable[..., Path], tmp_path: Path) -> None:
    recorded = run_composed("recorded", duration=1.0)
    content = {key: value for key, value in sections(tmp_path, duration=1.0).items() if key.endswith(("**", "filter"))}
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(Checked(science.load(content), {}).text())
    out = tmp_path / "again"
    command = [sys.executable, "-m", "rig_bringup", "up", str(scenario), "--compose", "--no-report"]
    command += ["--user-from", str(recorded), "--out", str(out)]
    domain = str(62 + os.getpid() % 30)
    done = subprocess.run(
        command, env={**os.environ, "ROS_DOMAIN_ID": domain}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert_same(data(recorded), data(out / "bag"))
    assert "user: replay" in (out / "scenario.yaml").read_text()
    # What it needs to be understood later is in the bag.
    assert verify(out / "bag").ok
    assert rederive(load_inputs(out / "bag")).difference() is None
    attached = [name for contents in rig_bag.info(out / "bag").contents() for name, _, _ in contents.attachments]
    assert attached == ["scenario.yaml", "user_force.npy"]
    forces = np.load(out / "user_force.npy")
    np.testing.assert_array_equal(forces, data(recorded)["/rig/force_sensor/wrench"]["wrench.force"])
    # Without a scenario named, it is that of the bag, and so are its seed and its length.
    replay, _ = up._load(up.parser().parse_args(["--user-from", str(out / "bag")]))
    assert (replay.loop.seed, replay.loop.duration, replay.loop.pacing) == (7, 1.0, "lockstep")


def test_bad_bags_are_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert up.main(["--user-from", str(tmp_path / "none"), "--out", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err == f"error: --user-from: there is no bag {tmp_path / 'none'}\n"
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/rig/task/state", "mig_interfaces/msg/TaskState")
    assert up.main(["--user-from", str(tmp_path / "bag"), "--out", str(tmp_path / "run")]) == 2
    assert "force_sensor/wrench" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
