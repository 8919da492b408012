"""What an operator may choose from: every protocol and subject that is there, how far it is, and why not."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig_study import study_cli
from rig_study.declared import StudyError
from rig_study.protocol import load_protocol
from rig_study.session import LOG, Session
from rig_study.studies import Studies, Subject

PROTOCOL = """
study: {title: A study, scenario: cart_pendulum_study, duration: 2.0, seed: 3}
groups: {all: {subjects: 2, modes: ["off", training]}}
sets: {a: {trials: 2}, b: {trials: 1}}
"""


def studies_in(folder: Path, *more: Path) -> Studies:
    (folder / "protocols").mkdir(exist_ok=True)
    (folder / "protocols" / "one.yaml").write_text(PROTOCOL)
    return Studies([folder / "protocols", *more], lambda name: folder / name)


def do(folder: Path, subject: str, trials: int) -> None:
    """Have a subject's session run so many trials more."""
    with Session(load_protocol(folder / "protocols" / "one.yaml"), subject, folder / "one" / subject) as session:
        for _ in range(trials):
            trial = session.progress.next()
            assert trial is not None
            session.start(trial)
            session.finish(trial, "bag")


def test_it_says_how_far_each_subject_is(tmp_path: Path) -> None:
    studies = studies_in(tmp_path)
    first, second = (Subject("one", "A study", name, "all", 0, 3) for name in ("S01", "S02"))
    assert studies.listing() == (first, second)
    do(tmp_path, "S02", 2)
    assert studies.listing() == (first, Subject("one", "A study", "S02", "all", 2, 3))
    chosen = studies.choose("one", "S02")
    assert (chosen.subject, chosen.folder, str(chosen)) == ("S02", tmp_path / "one" / "S02", "S02 of one")
    do(tmp_path, "S02", 1)
    assert studies.listing()[1].problem == "has done all trials"
    with pytest.raises(StudyError, match="S02 of one has done all 3 trials"):
        studies.choose("one", "S02")


def test_what_cannot_be_led_says_why(tmp_path: Path) -> None:
    studies = studies_in(tmp_path)
    for protocol, subject, words in (
        ("two", "S01", "there is no protocol 'two'; there are one"),
        ("one", "S03", "subject 'S03' is not in one-.*; it has S01, S02"),
        ("one", "../S01", "is not in one-"),
    ):
        with pytest.raises(StudyError, match=words):
            studies.choose(protocol, subject)
    with (
        Session(load_protocol(tmp_path / "protocols" / "one.yaml"), "S01", tmp_path / "one" / "S01"),
        pytest.raises(StudyError, match="is being led already"),
    ):
        studies.choose("one", "S01")
    assert studies.choose("one", "S01").subject == "S01"


def test_files_that_come_change_and_go_are_seen(tmp_path: Path) -> None:
    studies = studies_in(tmp_path)
    do(tmp_path, "S01", 1)
    other = tmp_path / "protocols" / "another.yaml"
    other.write_text(PROTOCOL.replace("trials: 2", "trails: 2"))
    broken, *rest = studies.listing()
    assert (broken.protocol, broken.name) == ("another", "")
    assert "did you mean trials" in broken.problem
    assert [each.protocol for each in rest] == ["one", "one"]
    with pytest.raises(StudyError, match="did you mean trials"):
        studies.choose("another", "S01")
    other.unlink()
    (tmp_path / "protocols" / "one.yaml").write_text(PROTOCOL.replace("A study", "Another version"))
    first, second = studies.listing()
    assert "is the session of S01 in one-" in first.problem
    assert (second.title, second.problem) == ("Another version", "")
    with pytest.raises(StudyError, match="is the session of S01 in one-"):
        studies.choose("one", "S01")
    (tmp_path / "protocols" / "one.yaml").unlink()
    assert studies.listing() == ()
    with pytest.raises(StudyError, match="there is none"):
        studies.choose("one", "S01")


def test_two_files_of_one_name_are_not_told_apart_by_chance(tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "one.yaml").write_text(PROTOCOL)
    studies = studies_in(tmp_path, tmp_path / "more")
    (only,) = studies.listing()
    assert "2 files are named one" in only.problem
    # The same folder twice is one.
    assert len(studies_in(tmp_path, tmp_path / "protocols" / ".." / "protocols").listing()) == 2


def test_the_command_offers_what_it_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    studies_in(tmp_path)
    monkeypatch.chdir(tmp_path)

    def offered(*arguments: str) -> set[str]:
        options = study_cli.parser().parse_args(["run", *arguments])
        return {each.protocol for each in study_cli.studies(options).listing()}

    assert {"demo", "paper"} <= offered("--display")
    assert {"demo", "one"} <= offered("--display", "--protocols", "protocols")
    assert offered("protocols/one.yaml", "--display") == {"one"}
    for arguments, words in (
        ([], "are needed, as in"),
        (["demo"], "are needed, as in"),
        (["--display", "--protocols", "nowhere"], "nowhere: is no folder"),
        (["nothing", "--display"], "neither a file nor a name"),
    ):
        with pytest.raises(StudyError, match=words):
            offered(*arguments)
    options = study_cli.parser().parse_args(["run", "demo", "--display", "--out", "here"])
    assert study_cli.studies(options).choose("demo", "S01").folder == tmp_path / "here" / "S01"
    options = study_cli.parser().parse_args(["run", "--display", "--out", "here"])
    assert study_cli.studies(options).choose("demo", "S01").folder == tmp_path / "here" / "study_demo" / "S01"
    assert not (tmp_path / "here" / LOG).exists()
