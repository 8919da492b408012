"""`./rig reproduce`: rows into the page's tables, what is measured stays, the study's rows are its statistics."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from made_up_study import cohort

from rig_study import reproduce_cli
from rig_study.declared import StudyError
from rig_study.null_cohorts import false_positives
from rig_study.paper_rows import paper_rows
from rig_study.reproduce_study import MEASUREMENTS, Measurement, Options
from rig_study.results_page import update
from rig_study.study_statistics import compute, finite

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
    tables = {measurement.table for measurement in reproduce_cli.measurements().values()} - {""}
    assert tables == set(re.findall(r"<!-- table (\w+):", page))


def test_what_is_measured_is_not_measured_again_until_the_sources_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[str] = []

    def measured(name: str, fails: bool = False) -> Measurement:
        def rows(options: Options) -> list[tuple[str, ...]]:
            if fails and not ran.count(name):
                ran.append(name)
                raise KeyboardInterrupt
            ran.append(name)
            return [(name, "w", f"m{options.at_most(100)}", "x")]

        return Measurement("claims", rows)

    there = {"a/1": measured("a/1"), "a/2": measured("a/2", fails=True), "b": measured("b")}
    monkeypatch.setattr(reproduce_cli, "measurements", lambda: there)
    page = tmp_path / "results.md"
    page.write_text(PAGE)
    common = ["--out", str(tmp_path / "out"), "--page", str(page)]
    assert reproduce_cli.main(common) == 130
    assert page.read_text() == PAGE
    with (tmp_path / "out" / "journal.jsonl").open("a") as journal:
        journal.write('{"key": "b:')  # as a kill leaves it
    assert reproduce_cli.main(common) == 0
    assert ran == ["a/1", "a/2", "a/2", "b"]
    assert "| a/1 | w | m100 | x |\n| a/2 | w | m100 | x |\n| b | w | m100 | x |\n<!-- end -->" in page.read_text()
    assert reproduce_cli.main(["a", *common]) == 0
    assert len(ran) == 4
    before = page.read_text()
    assert reproduce_cli.main(["a/1", "--seeds", "3", *common]) == 0
    assert "| a/1 | w | m3 | x |" in capsys.readouterr().out
    assert page.read_text() == before
    monkeypatch.setattr(reproduce_cli, "_sources", lambda study: "other")
    assert reproduce_cli.main(["b", *common]) == 0
    assert ran[-1] == "b"
    assert reproduce_cli.main(["c", *common]) == 2
    assert "nothing begins with c; there are: a/1, a/2, b" in capsys.readouterr().err


def test_the_rows_of_a_study_are_its_statistics() -> None:
    found = finite(compute(cohort(0.06), ("set1", "set3")))
    rows = {question: here for question, _, here in paper_rows(found)}
    effect = found["mixed_anova"]["rms_error"]["effects"]["interaction"]
    assert rows["group x set, RMS error"] == f"F(1, 26) = {effect['f']:.2f}, p < 0.001"
    test = found["two_sample"]["rms_error, set3, training less control"]
    assert f"RMS p = {test['p']:.3f}" in rows["groups in set 3"].split("by subjects")[1] or test["p"] < 0.001
    assert rows["success rate, set 1 and set 3"].count("; training ") == 1


def test_a_few_trials_of_the_judges_become_rows_and_a_report(tmp_path: Path) -> None:
    rows = MEASUREMENTS["study/judges"].rows(Options(tmp_path, trials=1, workers=2))
    assert len({row[0] for row in rows}) == len(rows) == 14
    assert rows[0][0] == "noise, off, -"
    assert float(rows[0][-1]) == 0.0
    assert (tmp_path / "judges" / "report" / "report.html").exists()


def test_null_cohorts_are_found_at_the_nominal_rate() -> None:
    found = false_positives(400, seed=7)
    assert found.low <= 0.05 <= found.high
    assert found.cohorts == 400
