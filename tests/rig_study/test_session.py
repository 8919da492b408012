"""A session's log: it resumes from anything, and no name is used twice."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_study.declared import StudyError
from rig_study.protocol import load_protocol
from rig_study.session import LOG, Progress, Session, events

PROTOCOL = """
study: {scenario: cart_pendulum_study, duration: 2.0, seed: 3}
groups: {all: {subjects: 2, modes: ["off", training]}}
sets:
  a: {trials: 2}
  b: {trials: 1, break_before: 5.0}
"""


def protocol_in(folder: Path):
    path = folder / "short.yaml"
    path.write_text(PROTOCOL)
    return load_protocol(path)


def test_a_session_goes_through_its_plan(tmp_path):
    protocol = protocol_in(tmp_path)
    with Session(protocol, "S01", tmp_path / "S01") as session:
        assert session.progress.remaining == 3 * 2.0 + 5.0
        for planned in protocol.plan("S01"):
            trial = session.progress.next()
            assert trial == planned
            session.start(trial)
            session.finish(trial, "bag")
        assert session.progress.next() is None
        assert session.progress.remaining == 0.0
        again = session.repeat()
        assert again == planned
        assert session.progress.next() == planned.again()
    found = Progress(protocol, "S01")
    found.read(tmp_path / "S01" / LOG)
    assert (found.done, found.last.split()[2]) == ({1, 2}, "closed")


def test_one_conductor_at_a_time_and_one_protocol_a_folder(tmp_path):
    protocol = protocol_in(tmp_path)
    with Session(protocol, "S01", tmp_path / "log"), pytest.raises(StudyError, match="another conductor"):
        Session(protocol, "S01", tmp_path / "log")
    with pytest.raises(StudyError, match=r"is the session of S01 in short-.*, not of S02"):
        Session(protocol, "S02", tmp_path / "log")
    with pytest.raises(StudyError, match="subject 'S99' is not in"):
        Session(protocol, "S99", tmp_path / "log")


@given(st.lists(st.sampled_from(["finish", "abort", "crash", "repeat", "cut"]), max_size=25), st.data())
def test_whatever_happens_no_name_is_used_twice_and_it_goes_on_where_it_stopped(tmp_path_factory, steps, data):
    folder = tmp_path_factory.mktemp("session")
    protocol = protocol_in(folder)
    log = folder / "log" / LOG
    started: list[str] = []
    session = Session(protocol, "S01", folder / "log")
    for step in steps:
        trial = session.progress.next()
        if step == "repeat":
            session.repeat()
            continue
        if trial is not None:
            session.start(trial)
            started.append(trial.name)
            if step == "finish":
                session.finish(trial, "bag")
            elif step == "abort":
                session.abort(trial, "asked for")
        if step in ("crash", "cut"):
            # The process is gone without a last word; of a cut line, some of the bytes are there.
            session._log.close()
            if step == "cut":
                line = json.dumps({"event": "finished", "position": 1, "time": "t", "study": protocol.name}).encode()
                with log.open("ab") as file:
                    file.write(line[: data.draw(st.integers(1, len(line) - 1))])
            before = session.progress
            session = Session(protocol, "S01", folder / "log")
            assert (session.progress.done, session.progress.attempts) == (before.done, before.attempts)
    session.close()
    assert len(set(started)) == len(started)
    assert [event["trial"] for event in events(log) if event["event"] == "started"] == started
