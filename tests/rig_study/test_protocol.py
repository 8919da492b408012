"""Protocols and cohorts: what they say follows from the file, and what they may not say is one clear sentence."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml

from rig_study.cohort import jobs, load_cohort
from rig_study.declared import StudyError
from rig_study.protocol import Protocol, balanced_square, load_protocol
from shared_control.parameters import ParameterError

SMALL: dict[str, Any] = {
    "study": {"scenario": "cart_pendulum_study", "seed": 3, "duration": 0.2},
    "groups": {
        "control": {"subjects": 4, "modes": ["off", "off", "off"]},
        "training": {"subjects": 6, "modes": ["off", "training", "off"]},
    },
    "sets": {"set1": {"trials": 2}, "set2": {"trials": 1, "break_before": 5.0}, "set3": {"trials": 2}},
}


def protocol(folder: Path, **changes: dict[str, Any]) -> Protocol:
    content = {key: {**value, **changes.get(key, {})} for key, value in SMALL.items()}
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return load_protocol(path)


def test_the_papers_protocol() -> None:
    paper = load_protocol("paper")
    assert Counter(paper.subjects.values()) == {"control": 10, "training": 18}
    trials = paper.trials()
    assert len(trials) == 28 * 90
    assert {trial.group for trial in trials if trial.mode != "off"} == {"training"}
    assert {trial.set for trial in trials if trial.mode != "off"} == {"set2"}
    assert len({trial.name for trial in trials}) == len({trial.seed for trial in trials}) == 2520


def test_the_demo_takes_five_minutes_of_a_subject() -> None:
    demo = load_protocol("demo")
    assert {demo.session_length(subject) for subject in demo.subjects} == {300.0}


def test_blocks_keep_the_ratio_of_the_groups(tmp_path: Path) -> None:
    order = list(protocol(tmp_path).subjects.values())
    assert Counter(order[:5]) == Counter(order[5:]) == {"control": 2, "training": 3}
    others = {tuple(protocol(tmp_path, study={"seed": seed}).subjects.values()) for seed in range(8)}
    assert len(others) > 1


def test_a_plan_follows_from_the_file(tmp_path: Path) -> None:
    first, second = protocol(tmp_path), protocol(tmp_path)
    assert first.trials() == second.trials()
    trial = first.plan("S01")[2]
    assert (trial.set, trial.trial, trial.position, trial.break_before) == ("set2", 1, 3, 5.0)
    assert first.scenario(trial).filter.mode == trial.mode
    assert first.scenario(trial).loop.seed == trial.seed
    again = trial.again()
    assert again.name != trial.name
    assert again.seed != trial.seed
    with pytest.raises(StudyError, match="S99"):
        first.plan("S99")


def test_a_comment_changes_names_and_no_seed(tmp_path: Path) -> None:
    before = protocol(tmp_path).plan("S01")[0]
    path = tmp_path / "small.yaml"
    path.write_text(path.read_text() + "# amended\n")
    after = load_protocol(path).plan("S01")[0]
    assert after.name != before.name
    assert after.seed == before.seed


@pytest.mark.parametrize("size", [2, 3, 4, 5])
def test_the_square_is_balanced(size: int) -> None:
    rows = balanced_square(size)
    times = len(rows) // size
    for place in range(size):
        assert Counter(row[place] for row in rows) == dict.fromkeys(range(size), times)
    pairs = Counter(pair for row in rows for pair in itertools.pairwise(row))
    assert set(pairs.values()) == {times}
    assert len(pairs) == size * (size - 1)


def test_balanced_orders_are_taken_in_turn(tmp_path: Path) -> None:
    made = protocol(tmp_path, study={"set_order": "balanced"})
    orders = {
        group: Counter(
            tuple(dict.fromkeys(trial.set for trial in made.plan(subject)))
            for subject, its in made.subjects.items()
            if its == group
        )
        for group in made.groups
    }
    assert len(orders["training"]) == 6
    assert set(orders["training"].values()) == {1}
    assert len(orders["control"]) == 4


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"study": {"duratoin": 3.0}}, r"study: unknown parameter duratoin = 3.0; did you mean duration\?"),
        (
            {"study": {"duration": -1.0}},
            r"study: duration: -1.0 is not allowed; it must be float from 0.01 to 3600 \[s\]",
        ),
        ({"study": {"allocation": "coin"}}, "allocation: 'coin' is not allowed; it must be str one of blocks, random"),
        ({"sets": {"set1": {"trials": "two"}}}, "sets.set1: trials: 'two' is not allowed; it must be int from 1"),
        (
            {"groups": {"control": {"subjects": 4, "modes": ["off"]}}},
            "groups.control: modes: .* 3 modes, one for each of set1",
        ),
        ({"groups": {"control": {"modes": [False, "off", "off"]}}}, 'a bare off as false: write "off"'),
        ({"groups": {"a_b": {"modes": ["off", "off", "off"]}}}, "groups.a_b: a name may hold letters"),
        ({"study": {"scenario": "nowhere"}}, "scenario 'nowhere' not found"),
    ],
)
def test_what_is_not_allowed_is_one_sentence(tmp_path: Path, changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        protocol(tmp_path, **changes)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"'papr' is neither a file nor a name.*paper"):
        load_protocol("papr")
    (tmp_path / "bad.yaml").write_text("study: [1,\n")
    with pytest.raises(StudyError, match=r"bad.yaml, line \d, column \d: not valid YAML"):
        load_protocol(tmp_path / "bad.yaml")
    (tmp_path / "odd.yaml").write_text("studdy: {}\n")
    with pytest.raises(StudyError, match="unknown section studdy; did you mean study"):
        load_protocol(tmp_path / "odd.yaml")


def test_subjects_differ_and_learn(tmp_path: Path) -> None:
    cohort = load_cohort("learners")
    drawn = [cohort.subject(f"S{k:02d}") for k in range(1, 201)]
    assert sum(s.skill for s in drawn) / 200 == pytest.approx(cohort.config.skill_mean, abs=0.03)
    assert cohort.subject("S07") == cohort.subject("S07")
    one = drawn[0]
    assert one.at(0.0) == pytest.approx(one.skill)
    assert one.at(1e6) == pytest.approx(one.ceiling)


def test_filtered_practice_is_what_is_planted(tmp_path: Path) -> None:
    made = protocol(tmp_path)

    def skills(name: str) -> dict[str, list[float]]:
        return {
            group: [job.labels["skill"] for job in jobs(made, load_cohort(name)) if job.labels["group"] == group]
            for group in made.groups
        }

    learners, null = skills("learners"), skills("null")
    assert learners["control"] == null["control"]
    assert learners["training"] != null["training"]
    changed = [a > b for a, b in zip(learners["training"], null["training"], strict=True) if a != b]
    # The two trials of set 3, which follow the filtered set, of each of six subjects.
    assert len(changed) == 12
    assert all(changed)


def test_instructions_come_before_what_they_are_for(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "study: {scenario: cart_pendulum_noise_off, instructions: 'Push. '}\n"
        "groups: {all: {subjects: 1, modes: ['off', training]}}\n"
        "sets: {first: {trials: 2, instructions: Gently.}, second: {trials: 1}}\n"
    )
    protocol = load_protocol(path)
    assert [protocol.instructions(trial) for trial in protocol.plan("S01")] == ["Push. Gently.", "", ""]
