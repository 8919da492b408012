"""Analysis: a planted effect is found, a null cohort is not, what is left out is listed, twice gives the same."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hand_written import write
from made_up_study import cohort
from scipy import stats

from mig_interfaces.msg import TrialState
from rig_study import study_cli, study_statistics
from rig_study.analyze_cli import main
from rig_study.declared import StudyError
from rig_study.power import needed, power, sizes_for
from rig_study.recorded import load
from rig_study.statistics_anova import cells
from rig_study.study_figures import Example, example
from rig_study.study_statistics import compute
from rig_study.tables import subjects


def test_a_planted_effect_is_found_and_a_null_is_not() -> None:
    planted, null = (compute(cohort(effect), ("set1", "set3")) for effect in (0.06, 0.0))
    assert planted["mixed_anova"]["rms_error"]["effects"]["interaction"]["p"] < 0.001
    assert null["mixed_anova"]["rms_error"]["effects"]["interaction"]["p"] > 0.05
    effects = planted["mixed_anova"]["rms_error"]["effects"]
    assert {(row["df"], row["error_df"]) for row in effects.values()} == {(1, 26)}
    assert planted["factorial_anova"]["success_rate"]["effects"]["set"]["error_df"] == 52
    correlation = planted["correlation"]["success_rate, all trials of set1, PRA of trials"]
    assert correlation["n"] == 18 * 6
    assert correlation["high"] < 0.0
    assert planted["paired"]["rms_error, training, set3 less set1"]["df"] == 17
    table = subjects(cohort(0.06)).query("set == 'set3'")
    by_group = [table[table["group"] == group]["rms_error"] for group in ("training", "control")]
    assert planted["two_sample"]["rms_error, set3, training less control"]["normality"] == [
        (pytest.approx(shapiro.statistic), pytest.approx(shapiro.pvalue)) for shapiro in map(stats.shapiro, by_group)
    ]
    assert planted["two_sample_of_trials"]["rms_error, set3, training less control"]["n"] == (18 * 6, 10 * 6)


def test_the_corrected_p_is_of_its_family() -> None:
    family = compute(cohort(0.06), ("set1", "set3"))["paired"]
    raw = {name: test["p"] for name, test in family.items() if "p" in test}
    smallest = min(raw, key=lambda name: raw[name])
    assert family[smallest]["p_holm"] == pytest.approx(min(1.0, len(raw) * raw[smallest]))


def test_a_missing_cell_is_named_in_the_results() -> None:
    table = cohort(0.0)
    found = compute(table[~((table["subject"] == "S03") & (table["set"] == "set3"))], ("set1", "set3"))
    assert "subject S03 (group control), set set3" in found["mixed_anova"]["rms_error"]["error"]
    assert "S03 lack set set1 or set3" in found["paired"]["rms_error, control, set3 less set1"]["error"]
    assert "p" in found["paired"]["rms_error, training, set3 less set1"]


def test_a_study_becomes_a_report_and_twice_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cohort(0.06).to_parquet(tmp_path / "trials.parquet")
    for out in ("first", "second"):
        assert main([str(tmp_path / "trials.parquet"), "--out", str(tmp_path / out)]) == 0
    assert "504 trials, 0 left out" in capsys.readouterr().out
    files = sorted(path.relative_to(tmp_path / "first") for path in (tmp_path / "first").rglob("*") if path.is_file())
    names = {str(path) for path in files}
    assert {"report.html", "statistics.json", "subjects.parquet", "trials.parquet", "figures/groups.png"} <= names
    for file in files:
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "second" / file).read_bytes(), file
    page = (tmp_path / "first" / "report.html").read_text()
    assert page.count("<svg") == 2
    assert "<script" not in page
    assert 'src="' not in page
    assert "1, 26" in page
    assert json.loads((tmp_path / "first" / "statistics.json").read_text())["study"]["groups"] == {
        "control": 10,
        "training": 18,
    }


def test_bags_that_cannot_be_used_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    who = {"subject": "S01", "group": "training", "set": "set1", "pacing": TrialState.PACING_LOCKSTEP}
    write(tmp_path / "bags" / "good", 400, trial=1, **who)
    write(tmp_path / "bags" / "other", 400, trial=1, **{**who, "set": "set2"})
    write(tmp_path / "bags" / "aborted", 400, phase=TrialState.PHASE_ABORTED, message="on request", trial=2, **who)
    write(tmp_path / "bags" / "S01_set2_002_a9", 400, trial=2, **{**who, "set": "set2"})
    write(tmp_path / "bags" / "S01_set2_002_a10", 400, trial=2, **{**who, "set": "set2"})
    write(tmp_path / "bags" / "short", 300, ticks_planned=400, trial=3, **who)
    cut = next(write(tmp_path / "bags" / "cut", 400, trial=4, **who).glob("*.mcap"))
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    assert main([str(tmp_path / "bags"), "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "statistics.json").read_text())
    reasons = dict(found["left_out"])
    assert set(reasons) == {"aborted", "short", "cut", "S01_set2_002_a9"}
    assert reasons["S01_set2_002_a9"] == "done again as S01_set2_002_a10"
    assert "aborted, on request" in reasons["aborted"]
    assert "100 of 400 ticks" in reasons["short"]
    assert not any(str(tmp_path) in reason for reason in reasons.values())
    assert "left out: cut" in capsys.readouterr().err
    page = (tmp_path / "out" / "report.html").read_text()
    assert all(name in page for name in reasons)
    # Again from elsewhere, with the bags under another path: the same bytes, reasons included.
    (tmp_path / "bags").rename(tmp_path / "moved")
    assert main([str(tmp_path / "moved"), "--out", str(tmp_path / "again")]) == 0
    for file in (path for path in (tmp_path / "out").rglob("*") if path.is_file()):
        assert file.read_bytes() == (tmp_path / "again" / file.relative_to(tmp_path / "out")).read_bytes(), file
    (tmp_path / "moved").rename(tmp_path / "bags")
    capsys.readouterr()
    row = pd.read_parquet(tmp_path / "out" / "trials.parquet").set_index("name").loc["good"]
    assert (row["subject"], row["success"], row["time_to_success"]) == ("S01", True, 1.0)
    assert main([str(tmp_path / "bags" / "short"), "--out", str(tmp_path / "none")]) == 1
    assert main([str(tmp_path / "nowhere"), "--out", str(tmp_path / "none")]) == 2
    assert "there is no such file" in capsys.readouterr().err


def test_the_example_shows_the_force_and_how_much_of_it_was_allowed(tmp_path: Path) -> None:
    shown = Example.recorded(load(write(tmp_path / "bag", 400)))
    assert shown.force.tolist() == [[4.0, 0.0, 0.0]] * 400
    force, state = example(shown).axes
    assert force.get_ylabel() == "force of the user, x\n[N]"
    assert state.get_ylabel() == "theta\n[rad]"
    (filled,) = force.collections
    areas = [np.ptp(path.vertices[:, 0]) * np.ptp(path.vertices[:, 1]) for path in filled.get_paths()]
    # Three ticks of four, each 10 ms of 4 N.
    assert (len(areas), sum(areas)) == (100, pytest.approx(300 * 0.01 * 4.0))


def test_power_grows_and_the_null_is_found_at_the_level() -> None:
    from rig_study.power import changes

    pilot = changes(cells(subjects(cohort(0.05, seed=3)), "rms_error", ["set1", "set3"]))
    small, large = power(pilot, [8, 56], effect=0.8, cohorts=1000)
    assert small.rate < large.rate
    assert small.low < small.rate < small.high
    null = power(pilot, [28], effect=0.0, cohorts=4000)[0]
    assert null.sizes == (10, 18)
    assert null.low <= 0.05 <= null.high
    # d = 0.8 with 10 and 18 subjects: power of the two-sided t test, from the noncentral t.
    delta, limit = 0.8 * np.sqrt(10 * 18 / 28), stats.t.ppf(0.975, 26)
    exact = stats.nct.sf(limit, 26, delta) + stats.nct.cdf(-limit, 26, delta)
    # The pilot's changes are not normal: near, not equal.
    assert power(pilot, [28], effect=0.8, cohorts=4000)[0].rate == pytest.approx(exact, abs=0.05)
    with pytest.raises(StudyError, match="at least 4"):
        sizes_for(3, [1, 1])


def test_how_many_subjects_are_needed() -> None:
    random = np.random.default_rng(4)
    pilot = {name: random.standard_normal(400) for name in ("a", "b")}
    found = needed(pilot, 0.8, effect=0.8, cohorts=4000)
    # Cohen, Statistical Power Analysis for the Behavioral Sciences, 1988, table 2.4.1: 26 in each group for d = 0.8.
    assert found.low <= 52 <= found.high
    assert found.low <= found.subjects <= found.high < found.low + 8
    assert power(pilot, [found.subjects], effect=0.8, cohorts=4000)[0].rate >= 0.8
    assert needed(pilot, 0.8, effect=8.0, cohorts=500).subjects <= 6
    assert needed(pilot, 0.8, effect=0.0, cohorts=500, most=100) is None
    with pytest.raises(StudyError, match="between 0 and 1"):
        needed(pilot, 1.0, effect=0.8)


def test_the_study_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cohort(0.05).to_parquet(tmp_path / "trials.parquet")
    assert study_cli.main(["power", str(tmp_path), "--subjects", "28", "--effect", "0.8", "--cohorts", "200"]) == 0
    said = capsys.readouterr().out
    assert "10 control + 18 training" in said
    assert "to find it 0.8 of the time: " in said
    assert study_cli.main(["power", str(tmp_path), "--measure", "speed"]) == 2
    assert "'speed' is not there" in capsys.readouterr().err
    assert study_cli.main(["plan", "demo", "--subject", "S01"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 9
    assert study_cli.main(["plan", "dmo"]) == 2
    assert study_statistics.outer_sets(cohort(0.0)) == ("set1", "set3")
