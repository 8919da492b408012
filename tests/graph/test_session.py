"""`./rig study run` over the real graph: every trial in a verified bag, from wherever the last conductor was killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import rig_bag
from rig_bag.verify import verify
from rig_study import cohort as cohorts
from rig_study.protocol import load_protocol
from rig_study.recorded import load
from rig_study.session import LOG, events
from shared_control.trial import run_trial

PROTOCOL = """
study: {scenario: SCENARIO, duration: DURATION, seed: 3}
groups: {all: {subjects: 1, modes: ["off", training, assistance]}}
sets: {first: {trials: 1}, second: {trials: 1, break_before: 3.0}, third: {trials: 1}}
"""
MODES = {"off": 0, "training": 1, "assistance": 2}


class Study:
    """The command line of a study of one subject and three trials, and the log of its session."""

    def __init__(self, folder: Path, duration: float = 1.0) -> None:
        (folder / "noise.yaml").write_text("/**/user_sim: {ros__parameters: {user: noise}}\n")
        self.protocol = folder / "short.yaml"
        self.protocol.write_text(
            PROTOCOL.replace("SCENARIO", str(folder / "noise.yaml")).replace("DURATION", str(duration))
        )
        self.sessions = folder / "sessions"
        self.log = self.sessions / "S01" / LOG
        self.surroundings = {**os.environ, "ROS_DOMAIN_ID": str(62 + os.getpid() % 30)}

    def command(self, verb: str, *more: str) -> list[str]:
        out = ["--out", str(self.sessions)]
        return [sys.executable, "-m", "rig_bringup", "study", verb, str(self.protocol), *out, *more]

    @property
    def run(self) -> list[str]:
        return self.command("run", "--subject", "S01", "--pacing", "lockstep", "--compose")

    def events(self, *kinds: str) -> list[dict[str, Any]]:
        return [event for event in events(self.log) if event["event"] in kinds] if self.log.exists() else []

    def kill_when(self, due: Callable[[], bool]) -> None:
        """Start a conductor and kill it as soon as something is so; it may have come to its end by then."""
        conductor = subprocess.Popen(
            self.run,
            env=self.surroundings,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        limit = time.monotonic() + 240.0
        while not (seen := due()) and conductor.poll() is None and time.monotonic() < limit:
            with suppress(subprocess.TimeoutExpired):
                conductor.wait(0.02)
        conductor.send_signal(signal.SIGKILL)
        conductor.wait()
        assert seen or due(), "the conductor did not come so far"


COHORT = "cohort: {user: human, seed: 4, skill_mean: 0.5, pace_mean: 2.0, trial_sd: 0.05, replan: 5}\n"


def test_a_virtual_cohort_through_the_graph_is_the_cohort_headless(tmp_path: Path) -> None:
    made = Study(tmp_path)
    made.protocol.write_text(made.protocol.read_text().replace("subjects: 1", "subjects: 2"))
    (tmp_path / "cohort.yaml").write_text(COHORT)
    simulate = made.command("simulate", "--cohort", str(tmp_path / "cohort.yaml"), "--graph")
    for _ in range(2):  # the second finds everything done
        done = subprocess.run(simulate, env=made.surroundings, capture_output=True, text=True, timeout=400, check=False)
        assert done.returncode == 0, done.stderr
        assert "all subjects have done all trials" in done.stdout
    jobs = cohorts.jobs(load_protocol(made.protocol), cohorts.load_cohort(tmp_path / "cohort.yaml"))
    assert len({job.scenario.user.skill for job in jobs}) == len(jobs) == 6
    for job in jobs:
        where = job.labels
        name = f"{where['subject']}_{where['set']}_{where['trial']:03d}_a1"
        recorded = load(made.sessions / str(where["subject"]) / "bags" / name)
        headless = run_trial(job.scenario, job.seed)
        np.testing.assert_array_equal(recorded.states, headless.states[:-1], err_msg=name)
        np.testing.assert_array_equal(recorded.verdict, headless.verdict, err_msg=name)
    noted = [event["skill"] for subject in ("S01", "S02") for event in events(made.sessions / subject / LOG)
             if event["event"] == "started"]  # fmt: skip
    assert noted == [job.scenario.user.skill for job in jobs]


def test_a_session_is_killed_at_every_stage_and_ends_in_three_bags_and_a_report(tmp_path: Path) -> None:
    # So long that a trial has not ended by when it is found to have begun.
    study = Study(tmp_path, duration=10.0)
    stages: dict[str, Callable[[], bool]] = {
        "before the first trial": lambda: bool(study.events("opened")),
        "in a trial": lambda: bool(study.events("started")),
        "in the break before the second": lambda: len(study.events("finished")) >= 1,
        "between two trials": lambda: len(study.events("finished")) >= 2,
        "after the last": lambda: len(study.events("finished")) == 3,
    }
    before = b""
    for stage, due in stages.items():
        study.kill_when(due)
        after = study.log.read_bytes()
        assert after.startswith(before), f"the log was written over when the conductor was killed {stage}"
        before = after
    done = subprocess.run(study.run, env=study.surroundings, capture_output=True, text=True, timeout=400, check=False)
    assert done.returncode == 0, done.stderr + (study.log.parent / "graph.log").read_text()
    assert study.log.read_bytes().startswith(before)
    assert "3/3" in subprocess.run(study.command("status"), capture_output=True, text=True, check=True).stdout

    started, ended = study.events("started"), study.events("finished")
    assert [event["position"] for event in ended] == [1, 2, 3]
    assert len({event["trial"] for event in started}) == len(started) > 3
    for event, (set_, mode) in zip(ended, zip(("first", "second", "third"), MODES, strict=True), strict=True):
        assert Path(event["bag"]).name == f"S01_{set_}_001_a{event['attempt']}"
        assert verify(event["bag"]).ok
        bag = rig_bag.read(event["bag"], ["/rig/mig_filter/decision", "/rig/trial/state"])
        assert len(bag["/rig/mig_filter/decision"]) == 1000
        assert set(bag["/rig/mig_filter/decision"]["mode"]) == {MODES[mode]}
        last = bag["/rig/trial/state"][-1]
        value = last.__getitem__ if hasattr(last, "dtype") else lambda name, last=last: getattr(last, name)
        said = value("subject"), value("set"), value("trial"), value("attempt")
        assert said == ("S01", set_, 1, event["attempt"])

    analyze = [sys.executable, "-m", "rig_bringup", "analyze", str(study.log.parent), "--out", str(tmp_path / "report")]
    said = subprocess.run(analyze, capture_output=True, text=True, check=True)
    table = pd.read_parquet(tmp_path / "report" / "trials.parquet")
    assert list(table["name"]) == [Path(event["bag"]).name for event in ended]
    assert set(table["mode"]) == set(MODES)
    found = json.loads((tmp_path / "report" / "statistics.json").read_text())
    # What a kill cut short is listed, and nothing else is left out.
    assert {name for name, _ in found["left_out"]} == {
        bag.name for bag in (study.log.parent / "bags").iterdir() if bag.name not in set(table["name"])
    }
    page = (tmp_path / "report" / "report.html").read_text()
    assert "3 trials" in page
    assert "<svg" in page
