"""The conductor beside the real nodes, on one executor: pause, resume, repeat, abort, and what it says of itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from node_graph import Graph
from std_srvs.srv import Trigger
from whole_graph import sections

from mig_interfaces.msg import SessionState, TrialState
from mig_interfaces.srv import AbortTrial, ChooseSession, StartTrial
from rig_bag.verify import verify
from rig_bringup.compose import graph as graph_of
from rig_runtime import topics
from rig_study.conductor import ConductorNode
from rig_study.protocol import load_protocol
from rig_study.session import LOG, Session, events
from rig_study.studies import Studies

PROTOCOL = """
study: {scenario: SCENARIO, duration: DURATION, seed: 3, instructions: Stay upright.}
groups: {all: {subjects: 1, modes: ["off", training]}}
sets: {first: {trials: 2, instructions: Alone.}, second: {trials: 1, break_before: 0.3, instructions: With the filter.}}
"""


class Conducted:
    """A graph in lockstep that waits for its trials, and a session that has not begun."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.graph = Graph("events")
        self.trials: list[TrialState] = self.graph.collect(topics.TRIAL_STATE)
        self.told: list[SessionState] = self.graph.collect(topics.SESSION_STATE)
        (folder / "noise.yaml").write_text("/**/user_sim: {ros__parameters: {user: noise}}\n")
        described = sections(folder / "bags")
        described["/**/task_sim"]["ros__parameters"]["autostart"] = False
        described["/**/recorder"]["ros__parameters"]["split"] = "trial"
        (folder / "graph.yaml").write_text(yaml.safe_dump(described))
        for factory in graph_of(record=True):
            self.graph.make(factory, params_file=folder / "graph.yaml")
        self.session: Session | None = None

    def conduct(self, duration: float = 0.2, **options: Any) -> ConductorNode:
        path = self.folder / "short.yaml"
        text = PROTOCOL.replace("SCENARIO", str(self.folder / "noise.yaml"))
        path.write_text(text.replace("DURATION", str(duration)))
        self.session = Session(load_protocol(path), "S01", self.folder / "S01")
        node = ConductorNode(self.session, namespace="rig", context=self.graph.context, **options)
        self.graph.add(node)
        return node

    def ask(self, name: str) -> Any:
        return self.graph.call(Trigger, f"/rig/{name}", Trigger.Request())

    def until_told(self, **wanted: Any) -> SessionState:
        """Wait until the newest state says so."""
        self.graph.until(lambda: bool(self.told) and all(getattr(self.told[-1], k) == v for k, v in wanted.items()))
        return self.told[-1]

    def said(self, *kinds: str) -> list[tuple[str, int, int]]:
        """What the log says: event, position, attempt."""
        found = events(self.folder / "S01" / LOG)
        return [(e["event"], e.get("position", 0), e.get("attempt", 0)) for e in found if e["event"] in kinds]


@pytest.fixture
def conducted(tmp_path: Path) -> Iterator[Conducted]:
    made = Conducted(tmp_path)
    yield made
    made.graph.close()
    if made.session is not None:
        made.session.close()


def test_it_leads_through_the_plan_and_says_how_far_it_is(conducted: Conducted) -> None:
    node = conducted.conduct()
    last = conducted.until_told(over=True)
    assert (last.trials_done, last.trials_planned, last.remaining.sec) == (3, 3, 0)
    assert last.doing == node.doing == "done"
    assert (last.subject, last.protocol) == ("S01", node.session.progress.protocol.name)
    done = [state.trials_done for state in conducted.told]
    assert sorted(done) == done
    assert {0, 3} <= set(done)
    # Instructions stand before a set, and not while one of its trials is going on.
    shown = list(dict.fromkeys((state.set, state.instructions) for state in conducted.told if state.instructions))
    assert shown == [("first", "Stay upright. Alone."), ("second", "With the filter.")]
    assert any(state.doing.startswith("break") for state in conducted.told)
    ran = {(t.set, t.trial, t.attempt, t.seed) for t in conducted.trials if t.phase == TrialState.PHASE_FINISHED}
    assert ran == {(p.set, p.trial, 1, p.seed) for p in node.session.progress.plan}
    for bag in ("S01_first_001_a1", "S01_first_002_a1", "S01_second_001_a1"):
        assert verify(conducted.folder / "bags" / bag).ok


def test_with_a_person_each_trial_waits_and_the_last_can_be_done_again(conducted: Conducted) -> None:
    conducted.conduct(wait_for_person=True)
    conducted.until_told(waiting=True, set="first", trial=1)
    assert not conducted.ask(topics.REPEAT_SERVICE).success
    assert conducted.ask(topics.RESUME_SERVICE).success
    conducted.until_told(waiting=True, trial=2, trials_done=1)
    again = conducted.ask(topics.REPEAT_SERVICE)
    assert (again.success, again.message) == (True, "first 1 will be done again")
    conducted.until_told(waiting=True, trial=1, attempt=2, trials_done=0)
    for trial, done in ((2, 1), (1, 2)):
        assert conducted.ask(topics.RESUME_SERVICE).success
        conducted.until_told(waiting=True, trial=trial, trials_done=done)
    assert conducted.ask(topics.RESUME_SERVICE).success
    conducted.until_told(over=True)
    assert conducted.said("started", "repeat") == [
        ("started", 1, 1),
        ("repeat", 1, 1),
        ("started", 1, 2),
        ("started", 2, 1),
        ("started", 3, 1),
    ]
    assert sorted(bag.name for bag in (conducted.folder / "bags").iterdir()) == [
        "S01_first_001_a1",
        "S01_first_001_a2",
        "S01_first_002_a1",
        "S01_second_001_a1",
    ]


def test_a_pause_lets_the_trial_end_and_holds_the_next(conducted: Conducted) -> None:
    conducted.conduct(duration=20.0)
    conducted.graph.until(lambda: conducted.trials[-1].phase == TrialState.PHASE_RUNNING)
    assert conducted.ask(topics.PAUSE_SERVICE).success
    refused = conducted.ask(topics.REPEAT_SERVICE)
    assert not refused.success
    assert "trial/abort" in refused.message
    conducted.until_told(waiting=True, trials_done=1)
    assert conducted.said("started") == [("started", 1, 1)]
    assert conducted.ask(topics.RESUME_SERVICE).success
    assert conducted.ask(topics.RESUME_SERVICE).message == "nothing was waiting"
    conducted.until_told(over=True)
    assert conducted.said("paused", "resumed") == [("paused", 0, 0), ("resumed", 0, 0)]


def test_an_aborted_trial_is_done_again_and_the_third_time_waits_for_a_person(conducted: Conducted) -> None:
    conducted.conduct(duration=30.0)
    for attempt in (1, 2, 3):
        conducted.graph.until(
            lambda attempt=attempt: (
                conducted.trials[-1].phase == TrialState.PHASE_RUNNING and conducted.trials[-1].attempt == attempt
            )
        )
        asked = AbortTrial.Request(reason="the subject let go")
        assert conducted.graph.call(AbortTrial, f"/rig/{topics.ABORT_SERVICE}", asked).success
    conducted.until_told(waiting=True, attempt=4, trials_done=0)
    assert conducted.ask(topics.RESUME_SERVICE).success
    conducted.until_told(over=True)
    assert conducted.said("aborted", "finished") == [
        *(("aborted", 1, attempt) for attempt in (1, 2, 3)),
        ("finished", 1, 4),
        ("finished", 2, 1),
        ("finished", 3, 1),
    ]
    why = [e["reason"] for e in events(conducted.folder / "S01" / LOG) if e["event"] == "aborted"]
    assert all("the subject let go" in reason for reason in why)


def test_a_trial_that_cannot_be_started_is_tried_again_and_then_waits(conducted: Conducted) -> None:
    by_hand = StartTrial.Request(subject="nobody", set="by hand", trial=1, duration=60.0)
    assert conducted.graph.call(StartTrial, f"/rig/{topics.START_SERVICE}", by_hand).success
    conducted.graph.until(lambda: conducted.trials[-1].phase == TrialState.PHASE_RUNNING)
    conducted.conduct()
    conducted.until_told(waiting=True, attempt=4)
    reasons = [e["reason"] for e in events(conducted.folder / "S01" / LOG) if e["event"] == "aborted"]
    assert len(reasons) == 3
    assert all(reason.startswith("it could not be started") for reason in reasons)
    conducted.graph.until(lambda: conducted.trials[-1].phase == TrialState.PHASE_FINISHED)
    assert conducted.ask(topics.RESUME_SERVICE).success
    conducted.until_told(over=True)
    assert [name for name, _, _ in conducted.said("finished")] == ["finished"] * 3


def test_a_trial_that_another_took_the_place_of_is_done_again(conducted: Conducted) -> None:
    node = conducted.conduct(duration=30.0)
    conducted.graph.until(lambda: bool(conducted.trials) and conducted.trials[-1].phase == TrialState.PHASE_RUNNING)
    by_hand = StartTrial.Request(subject="nobody", set="by hand", trial=1, duration=0.2)
    # The conductor does not look between the two.
    look, node._step = node._step, node._idle
    assert conducted.graph.call(AbortTrial, f"/rig/{topics.ABORT_SERVICE}", AbortTrial.Request()).success
    assert conducted.graph.call(StartTrial, f"/rig/{topics.START_SERVICE}", by_hand).success
    conducted.graph.until(lambda: node._state.subject == "nobody")
    node._step = look
    conducted.until_told(over=True)
    reasons = [e["reason"] for e in events(conducted.folder / "S01" / LOG) if e["event"] == "aborted"]
    assert reasons[0] == "another trial was started in its place"
    assert [name for name, _, _ in conducted.said("finished")] == ["finished"] * 3


def test_another_session_is_chosen_between_two_trials_and_not_during_one(conducted: Conducted) -> None:
    told = conducted.graph.collect(topics.STUDY_CHOICES)
    other = conducted.folder / "other.yaml"
    node = conducted.conduct(
        duration=20.0, studies=Studies([other, conducted.folder / "short.yaml"], lambda _: conducted.folder)
    )
    other.write_text((conducted.folder / "short.yaml").read_text())

    def choose(protocol: str, subject: str) -> Any:
        asked = ChooseSession.Request(protocol=protocol, subject=subject)
        return conducted.graph.call(ChooseSession, f"/rig/{topics.CHOOSE_SERVICE}", asked)

    conducted.graph.until(lambda: bool(conducted.trials) and conducted.trials[-1].phase == TrialState.PHASE_RUNNING)
    assert conducted.ask(topics.PAUSE_SERVICE).success
    refused = choose("other", "S01")
    assert (refused.success, "a trial is going on" in refused.message) == (False, True)
    conducted.until_told(waiting=True, trials_done=1)
    conducted.graph.until(lambda: {each.protocol: each.trials_done for each in told[-1].subjects}.get("short") == 1)
    for protocol, subject, words in (
        ("third", "S01", "there is no protocol 'third'; there are other, short"),
        ("other", "S99", "subject 'S99' is not in other"),
        ("short", "S01", "being led already"),
    ):
        refused = choose(protocol, subject)
        assert not refused.success
        assert words in refused.message
    assert node.choice is None
    # The log in that folder is of the other protocol.
    assert "is the session of S01 in short-" in choose("other", "S01").message
    (conducted.folder / "S01" / LOG).rename(conducted.folder / "elsewhere.jsonl")
    accepted = choose("other", "S01")
    assert (accepted.success, accepted.message) == (True, "S01 of other begins: the graph is being started")
    assert node.choice is not None
    assert (node.choice.protocol.file.path, node.choice.subject) == (other, "S01")
    conducted.graph.until(lambda: told[-1].message == accepted.message)
    assert "begins already" in choose("other", "S01").message
    # This session starts no more trials.
    assert conducted.ask(topics.RESUME_SERVICE).success
    trials, told_before = len(conducted.trials), len(conducted.told)
    conducted.graph.until(lambda: len(conducted.told) > told_before + 1)
    assert len(conducted.trials) == trials
