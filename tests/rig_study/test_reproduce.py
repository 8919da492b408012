"""`./rig reproduce`: rows into the page's tables, what is measured stays, the study's rows are its statistics."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_study import cohort

from rig_study import bounds, graded_users, reproduce_cli, runs
from rig_study.changes import apply
from rig_study.claim_figures import figures, sentence
from rig_study.claims import CART, MAP, SLIP
from rig_study.claims import jobs as claim_jobs
from rig_study.declared import StudyError
from rig_study.measurements import Measurement, Options, measurements
from rig_study.null_cohorts import false_positives
from rig_study.paper_rows import paper_rows
from rig_study.results_page import update
from rig_study.runs import Job, run
from rig_study.study_statistics import compute, finite
from rig_study.sweep import montecarlo_jobs
from shared_control.trial import judged, run_trial

PAGE = """# Results
By hand.

<!-- table claims: written by ./rig reproduce -->
| claim | wanted | measured | with |
| --- | --- | --- | --- |
| old | 1 | 2 | x |
| kept | 3 | 4 | x |
<!-- end -->

Also by hand | not a row.
<!-- table study: written by ./rig reproduce -->
| question | paper | here |
| --- | --- | --- |
<!-- end -->
"""


def test_rows_are_replaced_where_they_stand_and_the_text_is_left_alone(tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    page.write_text(PAGE)
    update(page, {"claims": [("new", "5", "6", "x"), ("old", "1", "a|b", "x")]})
    expected = PAGE.replace("| old | 1 | 2 | x |", "| old | 1 | a\\|b | x |")
    expected = expected.replace("| kept | 3 | 4 | x |\n", "| kept | 3 | 4 | x |\n| new | 5 | 6 | x |\n")
    assert page.read_text() == expected
    update(page, {"claims": [("new", "5", "6", "x")], "study": [("q", "p", "h")]}, whole={"claims"})
    text = page.read_text()
    assert "kept" not in text
    assert "| new | 5 | 6 | x |\n<!-- end -->" in text
    assert "| q | p | h |\n<!-- end -->" in text
    with pytest.raises(StudyError, match="must have one place '<!-- table judges"):
        update(page, {"judges": []})
    with pytest.raises(StudyError, match=r"nowhere.md: No such file"):
        update(tmp_path / "nowhere.md", {})


def test_the_page_of_this_repository_has_every_table() -> None:
    page = (Path(__file__).parents[2] / "docs" / "results.md").read_text()
    tables = {measurement.table for measurement in measurements().values()} - {""}
    assert tables == set(re.findall(r"<!-- table (\w+):", page))


def made_up(name: str, ran: list[str]) -> Measurement:
    """Three short trials, and a row that counts those that are there."""

    def jobs(options: Options) -> list[Job]:
        from shared_control import scenario as science

        short = apply(science.load("cart_pendulum_noise_training"), {"loop.duration": 0.2}, "here")
        return [Job(f"{name}{job.seed}", short, job.seed) for job in montecarlo_jobs(short.name, 3, 0, 0)][
            : options.at_most(3)
        ]

    def rows(_: Options, trials: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
        ran.append(name)
        return [(name, "w", f"{len(trials)} trials", "-", "x")]

    return Measurement("claims", jobs, rows)


def test_what_is_measured_is_not_measured_again_until_the_sources_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[str] = []
    there = {name: made_up(name, ran) for name in ("a/1", "a/2", "b")}
    # The same trials as a/1, for another table: they are run once.
    there["c"] = Measurement("study", there["a/1"].jobs, lambda _, trials: [("q", "p", str(len(trials)))])
    there["d"] = Measurement("claims", lambda _: [], lambda _, trials: [("d", "w", "none", "-", "x")])
    monkeypatch.setattr(reproduce_cli, "measurements", lambda: there)
    original, seen = runs.run_job, list[str]()

    def watched(job: Job) -> dict[str, Any]:
        seen.append(job.name)
        if len(seen) == 5:
            raise KeyboardInterrupt
        return original(job)

    monkeypatch.setattr(runs, "run_job", watched)
    page = tmp_path / "results.md"
    page.write_text(PAGE)
    common = ["--workers", "1", "--out", str(tmp_path / "out"), "--page", str(page)]
    assert reproduce_cli.main(common) == 130
    assert "the same command goes on from here" in capsys.readouterr().err
    assert page.read_text() == PAGE
    # The first trial of each comes first.
    assert seen == ["a/10", "a/20", "b0", "a/11", "a/12"]
    with (tmp_path / "out" / "trials" / "journal.jsonl").open("a") as journal:
        journal.write('{"key": "b:')  # as a kill leaves it
    assert reproduce_cli.main(common) == 0
    assert seen[5:] == ["a/12", "a/21", "a/22", "b1", "b2"]
    assert "of 9 trials 4 were there" in capsys.readouterr().out
    rows = [f"| {name} | w | 3 trials | - | x |\n" for name in ("a/1", "a/2", "b")]
    assert "".join([*rows, "| d | w | none | - | x |\n", "<!-- end -->"]) in page.read_text()
    assert "| q | p | 3 |\n<!-- end -->" in page.read_text()
    before = page.read_text()
    assert reproduce_cli.main(["a/1", "--seeds", "2", *common]) == 0
    assert "| a/1 | w | 2 trials | - | x |" in capsys.readouterr().out
    assert (page.read_text(), len(seen)) == (before, 10)
    monkeypatch.setattr(runs, "science", lambda: "as it was edited")
    assert reproduce_cli.main(["b", *common]) == 0
    assert seen[10:] == ["b0", "b1", "b2"]
    assert reproduce_cli.main(["e", *common]) == 2
    assert "nothing begins with e; there are: a/1, a/2, b, c, d" in capsys.readouterr().err


def test_an_interrupt_ends_every_process_and_the_same_command_goes_on(tmp_path: Path) -> None:
    page, out = tmp_path / "results.md", tmp_path / "out"
    page.write_text(PAGE)
    command = [
        *(sys.executable, "-m", "rig_bringup", "reproduce", "cart/noise/off"),
        *("--workers", "2", "--out", str(out), "--page", str(page)),
    ]
    journal = out / "trials" / "journal.jsonl"
    kept = 0
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        # Its processes have its session; none of them may be left when it has ended.
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        wait_until(lambda least=kept + 3: journal.exists() and journal.read_bytes().count(b"\n") >= least, 120.0)
        # A terminal interrupts all of its processes at once; who kills means one.
        (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        said = process.communicate(timeout=60.0)[1]
        wait_until(lambda process=process: not alive(process.pid), 60.0)
        if number == signal.SIGKILL:
            assert process.returncode == -signal.SIGKILL
        else:
            assert process.returncode == 130
            assert "Traceback" not in said
            assert "the same command goes on from here" in said
        kept = journal.read_bytes().count(b"\n")
        assert kept < 100
    assert page.read_text() == PAGE
    again = subprocess.run(command, capture_output=True, text=True, check=True)
    assert f"of 100 trials {kept} were there" in again.stdout
    assert "0 of 100 inverted" in page.read_text()


def wait_until(true: Callable[[], object], limit: float) -> None:
    end = time.monotonic() + limit
    while not true():
        assert time.monotonic() < end, "it did not come to it in time"
        time.sleep(0.02)


def alive(session: int) -> list[int]:
    """Processes of a session that still run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, its = stat.read_text().rsplit(")", 1)[1].split()[:4]
        except OSError:
            continue
        if int(its) == session and state != "Z":
            found.append(int(stat.parent.name))
    return found


def test_met_or_missed_follows_from_the_bounds() -> None:
    wanted = (
        bounds.all_of("inverted"), bounds.none_of("fell"), bounds.near("rejected", 0.5, 0.02),
        bounds.at_most("cart p99", 15.0, "m"), bounds.at_least("speed correlation", 0.98),
    )  # fmt: skip
    assert bounds.wanted(wanted) == (
        "all inverted; none fell; rejected 0.5 +- 0.02; cart p99 at most 15 m; speed correlation at least 0.98"
    )
    edge = {"inverted": 1.0, "fell": 0.0, "rejected": 0.52, "cart p99": 15.0, "speed correlation": 0.98}
    assert bounds.result(wanted, edge) == "met"
    for figure, value in (("inverted", 0.999), ("fell", 0.003), ("rejected", 0.4799), ("rejected", 0.5201),
                          ("cart p99", 15.01), ("speed correlation", 0.979), ("cart p99", float("nan"))):  # fmt: skip
        assert bounds.result(wanted, {**edge, figure: value}) == f"**missed**: {figure}"
    assert bounds.result(wanted, {**edge, "fell": 1.0, "rejected": 0.6}) == "**missed**: fell, rejected"
    assert (bounds.wanted(()), bounds.result((), edge)) == ("reported", "-")


def test_every_claim_asks_for_figures_that_there_are() -> None:
    of = {
        "cart_pendulum": {"success": True, "upright_at_end": True, "pra": 0.5, "pra_trial": 0.4, "cart_excursion": 2.0,
                          "time_to_success": 3.0},
        "slip": {"fell": True, "fall_time": 5.5, "override": 0.3, "mean_speed": 1.0, "speed_rmse": float("nan"),
                 "speed_correlation": float("nan"), "stride_speed_rmse": 0.03, "stride_speed_correlation": 0.99},
    }  # fmt: skip
    for name, claim in {**CART, **SLIP, **MAP}.items():
        (job,) = claim_jobs(name, claim, 1)
        task = job.scenario.loop.task
        found = figures([{"task": task, **of[task]}] * 3)
        assert bounds.result(claim.wanted, found) in ("met", "-") or "**missed**" in bounds.result(claim.wanted, found)
        assert sentence(found, 3).startswith("3 of 3 inverted" if task == "cart_pendulum" else "3 of 3 fell")


def test_the_figures_of_a_claim_are_those_of_its_trials(tmp_path: Path) -> None:
    jobs = claim_jobs("x", CART["cart/noise/training"], 3)
    found = figures(run(jobs, tmp_path, workers=1))
    alone = [run_trial("cart_pendulum_noise_training", 40_000_000 + k) for k in range(3)]
    assert found["rejected"] == pytest.approx(sum(trial.measures.pra for trial in alone) / 3)
    angles = [abs(math.remainder(trial.states[-1, 0], 2.0 * math.pi)) for trial in alone]
    assert found["upright at the end"] == pytest.approx(sum(angle <= 0.4 for angle in angles) / 3)
    assert found["cart p99"] == pytest.approx(np.percentile([trial.measures.cart_excursion for trial in alone], 99))


def test_graded_users_are_judged_for_what_they_do_alone(tmp_path: Path) -> None:
    job = graded_users.jobs("cart/graded users", 1)[9]
    (row,) = run([job], tmp_path, workers=1)
    alone = run_trial(job.scenario, job.seed)
    assert row["judged_pra"] == judged(alone, graded_users.JUDGE).pra
    assert row["pra"] == 0.0
    assert row["success"] == alone.measures.success
    rows = [{"user": k, "success": k > 4, "judged_pra": 0.5 - 0.01 * k} for k in range(10)]
    assert graded_users.figures(rows)["Spearman"] == pytest.approx(-0.8703883, abs=1e-6)  # by hand: 5 ranks tied twice


def test_no_trial_of_the_graded_users_is_another() -> None:
    """Each user of each population has seeds of their own, and those drawn err by at most 30 % about the pendulum."""
    jobs = [job for name in graded_users.POPULATIONS for job in graded_users.jobs(name, 10)]
    assert len({job.seed for job in jobs}) == len({job.name for job in jobs}) == 10 * (32 + 48)
    drawn = graded_users.POPULATIONS["cart/graded users drawn"]
    assert all(abs(user.length / 2.0 - 1.0) <= 0.3 + 1e-9 for user in drawn)
    # As spread as a uniform distribution is: its mean and sd within four standard errors.
    skills = np.array([user.skill for user in drawn])
    assert abs(skills.mean() - 0.5) <= 4.0 * 0.289 / np.sqrt(len(drawn))
    assert abs(skills.std() - 0.289) <= 0.08


def test_the_rows_of_a_study_are_its_statistics() -> None:
    found = finite(compute(cohort(0.06), ("set1", "set3")))
    rows = {question: here for question, _, here in paper_rows(found)}
    effect = found["mixed_anova"]["rms_error"]["effects"]["interaction"]
    assert rows["group x set, RMS error"] == f"F(1, 26) = {effect['f']:.2f}, p < 0.001"
    test = found["two_sample"]["rms_error, set3, training less control"]
    assert f"RMS p = {test['p']:.3f}" in rows["groups in set 3"].split("by subjects")[1] or test["p"] < 0.001
    assert rows["success rate, set 1 and set 3"].count("; training ") == 1


def test_a_few_trials_of_the_judges_become_rows_and_a_report(tmp_path: Path) -> None:
    options = Options(tmp_path, trials=1)
    for name, count, first in (("judges", 14, "noise, off, -"), ("slip judges", 5, "off, -")):
        measurement = measurements()[f"study/{name}"]
        rows = measurement.rows(options, run(measurement.jobs(options), tmp_path / "runs" / name, workers=1))
        assert len({row[0] for row in rows}) == len(rows) == count
        assert rows[0][0] == first
        assert (tmp_path / name.replace(" ", "_") / "report" / "report.html").exists()


def test_null_cohorts_are_found_at_the_nominal_rate() -> None:
    found = false_positives(400, seed=7)
    assert found.low <= 0.05 <= found.high
    assert found.cohorts == 400
