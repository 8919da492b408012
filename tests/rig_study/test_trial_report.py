"""The report of a bag that was written by hand: what it says is what the bag holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_written import write

import rig_bag
from mig_interfaces.msg import FilterDecision, TrialState
from rig_bag.cli import main as bag_command
from rig_bringup.__main__ import trial_of
from rig_study.hops import hops
from rig_study.recorded import TrialError, load
from rig_study.trial_report import summarize, write_report


def test_a_trial_is_joined_by_tick(tmp_path: Path) -> None:
    trial = load(write(tmp_path / "bag", 400))
    assert trial.ticks_recorded == trial.decisions_recorded == 400
    assert trial.states.shape == (400, 4)
    assert trial.user_control.shape == (400, 1)
    assert trial.shares() == {"accepted": 0.75, "rejected": 0.25, "replaced": 0.0}
    assert trial.sample_time == pytest.approx(0.01)
    np.testing.assert_array_equal(trial.criterion > 0, trial.verdict == FilterDecision.VERDICT_REJECTED)


def test_the_summary_has_the_measures(tmp_path: Path) -> None:
    rows = {" ".join(line.split()) for line in summarize(write(tmp_path / "bag", 400)).splitlines()}
    assert {"Task success yes", "time to success 1.00 s", "Filter accepted 75.0 %"} <= rows
    assert "Loop ticks, decisions 400, 400 of 400" in rows
    assert {"Latency percentiles 50 / 90 / 99", "loop, state out to motion in 270 / 270 / 270 us"} <= rows


def test_hops_are_the_differences_of_what_was_recorded(tmp_path: Path) -> None:
    found = load(write(tmp_path / "bag", 50)).hops
    us = {name: 1e6 * seconds for name, seconds in found.items()}
    assert us.pop("state, due to out") == pytest.approx(np.full(50, 30.0))
    expected = {"state to filter": 20, "state to decision, by way of the user": 40, "decision": 10}
    expected |= {"decision to robot": 70, "robot": 50, "robot to task": 100, "loop, state out to motion in": 270}
    for name, value in (expected | {"spare, motion in to next state": 9720}).items():
        assert us[name][:-1] == pytest.approx(np.full(49, float(value))), name
    # Nothing tells when the last motion was back.
    assert np.isnan(us["robot to task"][-1])


def test_the_user_s_hop_is_how_much_later_the_recorder_got_the_wrench() -> None:
    ticks, stamp = np.arange(4), 10_000_000 * np.arange(1, 5)

    def table(**columns: Any) -> Any:
        return np.rec.fromarrays(list(columns.values()), names=",".join(columns)).view(np.ndarray)

    times = {"tick": ticks, "delay": [1e-4] * 4, "compute_time": [1e-5] * 4}
    state = table(**times, stamp=stamp, log_time=stamp + 120_000, motion_age=[9e-3] * 4, held=[0.0] * 4)
    decision = table(**times, state_age=[2e-5] * 4)
    # That of tick 2 is missing, and they have come out of order.
    stamps = stamp[[3, 0, 1]]
    wrench = table(stamp=stamps, log_time=stamps + 190_000)
    name = "user and one way, at the recorder"
    found = hops(state, decision, table(**times), 0.01, wrench)[name]
    assert found[[0, 1, 3]] == pytest.approx([7e-5] * 3)
    assert np.isnan(found[2])
    assert name not in hops(state, decision, table(**times), 0.01)


def test_in_lockstep_there_are_no_hops(tmp_path: Path) -> None:
    trial = load(write(tmp_path / "bag", 50, TrialState.PACING_LOCKSTEP))
    assert trial.hops == {}
    assert "Latency" not in summarize(trial.bag)


@pytest.mark.parametrize(("pacing", "figures"), [(TrialState.PACING_REALTIME, 5), (TrialState.PACING_LOCKSTEP, 4)])
def test_the_page_is_self_contained_and_escaped(tmp_path: Path, pacing: int, figures: int) -> None:
    page = write_report(write(tmp_path / "bag", 400, pacing), tmp_path / "report.html").read_text()
    assert page.count("<svg") == figures
    assert "by &lt;hand&gt;" in page
    assert "<script" not in page
    assert 'src="http' not in page


def test_the_same_bag_gives_the_same_page(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", 300)
    first = write_report(bag, tmp_path / "first.html").read_text()
    assert write_report(bag, tmp_path / "second.html").read_text() == first


def test_a_bag_without_ticks_says_so(tmp_path: Path) -> None:
    with pytest.raises(TrialError, match=r"holds no tick.*ran to its end"):
        load(write(tmp_path / "bag", 0))


def test_info_ends_with_the_trial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write(tmp_path / "bag", 400)
    assert bag_command(["info", str(bag)], about=trial_of) == 0
    said = capsys.readouterr().out
    assert said.index("Service information:") < said.index("accepted")
    for words in ("75.0 %", "missed deadlines", "decision, p50 / p99", "10 / 10 us"):
        assert words in said
    with rig_bag.BagWriter(tmp_path / "other") as other:
        other.add_topic("/a", "std_msgs/msg/String")
    assert bag_command(["info", str(tmp_path / "other")], about=trial_of) == 0
    assert capsys.readouterr().out.endswith("Service information: \n")
