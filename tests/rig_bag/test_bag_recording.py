"""The recording without ROS: log times, progress, the account of ticks."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from recorded_loop import EPOCH, STEP
from std_msgs.msg import String

from mig_interfaces.msg import TaskState, TrialState
from rig_bag import BagWriter, messages
from rig_bag.mcap_scan import scan
from rig_bag.recording import Recording, Stream, Trial

NOW = 1_700_000_000_000_000_000


@pytest.fixture
def make(tmp_path: Path, trial_state: Callable[..., TrialState]) -> Callable[..., Rig]:
    return lambda **options: Rig(tmp_path / "bag", trial_state, **options)


class Rig:
    """A recording with two per-tick topics, one that two share, and one without a stamp."""

    def __init__(self, path: Path, trial_state: Callable[..., TrialState], **options: Any) -> None:
        self.path = path
        self._trial_state = trial_state
        self.progress: list[int] = []
        options = {"per_tick": ["/state", "/wrench", "/yes|/no"], "progress_ticks": 25, **options}
        self.recording = Recording(BagWriter(path), on_progress=self._note, **options)
        add = self.recording.add_topic
        self.state = add("/state", "mig_interfaces/msg/TaskState")
        self.wrench = add("/wrench", "geometry_msgs/msg/WrenchStamped")
        self.yes = add("/yes", "geometry_msgs/msg/WrenchStamped")
        self.no = add("/no", "geometry_msgs/msg/WrenchStamped")
        self.text = add("/text", "std_msgs/msg/String")
        self.diagnostics = add("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        self.now = NOW

    def _note(self) -> None:
        self.progress.append(self.recording.progress)

    def send(self, stream: Stream, tick: int | None = None, sent: int = 0) -> None:
        types = {"/state": TaskState, "/text": String, "/diagnostics": DiagnosticArray}
        message = types.get(stream.name, WrenchStamped)()
        if tick is not None:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(EPOCH + tick * STEP, 1_000_000_000)
        self.now += 1000
        self.recording.receive(stream, serialize_message(message), self.now, sent)

    def tick(self, tick: int) -> None:
        for stream in (self.state, self.wrench, self.yes if tick % 2 else self.no):
            self.send(stream, tick)

    def follow(self, phase: int, ticks: int = 0, uid: int = 1) -> None:
        self.recording.follow(Trial.from_message(self._trial_state(phase, ticks, uid)))

    def account(self) -> dict[str, str]:
        self.recording.close()
        return dict(scan(self.recording.writer.file).metadata)["completeness"]


def test_log_time_is_the_time_of_reception(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.tick(0)
    rig.send(rig.text)
    rig.send(rig.text, sent=NOW - 7)
    rig.send(rig.state, 1, sent=NOW - 7)
    rig.send(rig.diagnostics)
    rig.send(rig.diagnostics, sent=NOW - 7)
    rig.recording.close()
    stored = list(messages(rig.path))
    assert [message.log_time for message in stored] == [NOW + 1000 * k for k in (1, 2, 3, 4, 5, 6, 7, 8)]
    # That of publication is the stamp; without one, or with one that was never set, it is what the middleware says, or
    # the other.
    published = [EPOCH, EPOCH, EPOCH, NOW + 4000, NOW - 7, EPOCH + STEP, NOW + 7000, NOW - 7]
    assert [message.publish_time for message in stored] == published


def test_in_lockstep_log_time_is_the_newest_tick(make: Callable[..., Rig]) -> None:
    rig = make(lockstep=True)
    rig.send(rig.text)
    rig.send(rig.diagnostics, 777)
    rig.tick(0)
    rig.send(rig.state, 1)
    rig.send(rig.diagnostics, 777)
    rig.send(rig.wrench, 1)
    rig.send(rig.diagnostics, sent=NOW)
    rig.recording.close()
    times = [(message.log_time, message.publish_time) for message in messages(rig.path)]
    assert times.pop() == (EPOCH + STEP, EPOCH + STEP)
    stored = [(message.topic, message.log_time) for message in messages(rig.path)][:-1]
    assert stored[:2] == [("/text", EPOCH), ("/diagnostics", EPOCH)]
    assert stored[-3:] == [("/state", EPOCH + STEP), ("/diagnostics", EPOCH + STEP), ("/wrench", EPOCH + STEP)]


def test_in_lockstep_an_armed_trial_gives_the_time(make: Callable[..., Rig]) -> None:
    rig = make(lockstep=True)
    rig.follow(TrialState.PHASE_ARMING)
    rig.send(rig.text, sent=NOW)
    rig.recording.close()
    assert [(message.log_time, message.publish_time) for message in messages(rig.path)] == [(EPOCH, EPOCH)]


@pytest.mark.parametrize("limit", [0, 1, 2, 100])
def test_in_lockstep_without_any_tick_nothing_is_lost(
    make: Callable[..., Rig], limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether more comes than is held back or not."""
    monkeypatch.setattr("rig_bag.recording._PENDING_LIMIT", limit)
    rig = make(lockstep=True)
    rig.send(rig.text)
    rig.send(rig.text, sent=NOW - 7)
    rig.recording.close()
    times = [(message.log_time, message.publish_time) for message in messages(rig.path)]
    assert times == [(NOW + 1000, NOW + 1000), (NOW + 2000, NOW - 7)]


def test_progress_is_that_of_the_slowest_topic_and_told_at_each_interval(make: Callable[..., Rig]) -> None:
    rig = make(progress_ticks=5)
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in range(12):
        rig.send(rig.state, tick)
    assert rig.recording.progress == -1
    for tick in range(12):
        rig.send(rig.wrench, tick)
        assert rig.recording.progress == EPOCH + tick * STEP
    assert rig.progress == [EPOCH + 4 * STEP, EPOCH + 9 * STEP]
    rig.recording.close()


def test_a_whole_trial_is_complete(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in range(50):
        rig.tick(tick)
    assert not rig.recording.complete() or rig.recording.trial is None or not rig.recording.trial.ended
    rig.follow(TrialState.PHASE_FINISHED, 50)
    assert rig.recording.complete()
    account = rig.account()
    assert (account["complete"], account["lost"], account["messages"]) == ("true", "0", "150")
    union = json.loads(account["ticks /yes|/no"])
    assert (union["expected"], union["received"], union["missing"]) == (50, 50, 0)
    assert account["count /yes"] == account["count /no"] == "25"


@pytest.mark.parametrize(
    ("skip", "lost"), [({0}, 1), ({7, 8}, 2), ({49}, 1), (set(range(50)), 50), ({0, 20, 48, 49}, 4)]
)
def test_what_is_missing_is_counted_wherever_it_is(make: Callable[..., Rig], skip: set[int], lost: int) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in range(50):
        rig.send(rig.state, tick)
        rig.send(rig.yes, tick)
        if tick not in skip:
            rig.send(rig.wrench, tick)
    rig.follow(TrialState.PHASE_FINISHED, 50)
    assert rig.recording.lost() == lost
    account = rig.account()
    assert (account["complete"], account["lost"]) == ("false", str(lost))
    assert json.loads(account["ticks /wrench"])["missing"] == lost
    assert json.loads(account["ticks /state"])["missing"] == 0


def test_duplicates_are_not_complete(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in (0, 1, 1, 2):
        rig.tick(tick)
    rig.follow(TrialState.PHASE_FINISHED, 3)
    account = rig.account()
    assert (account["complete"], account["lost"]) == ("false", "0")
    assert json.loads(account["ticks /state"])["duplicates"] == 1


def test_what_the_middleware_lost_is_not_complete(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in range(5):
        rig.tick(tick)
    rig.follow(TrialState.PHASE_FINISHED, 5)
    rig.recording.note_lost("/text", 2)
    rig.recording.note_lost("/text", 1)
    assert rig.recording.lost() == 3
    account = rig.account()
    assert (account["complete"], account["lost"], account["lost by the middleware /text"]) == ("false", "3", "3")


def test_what_publishers_say_that_they_sent_is_in_the_account(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in range(5):
        rig.send(rig.state, tick)
        rig.send(rig.yes, tick)
        if tick != 3:
            rig.send(rig.wrench, tick)
    for uid, ticks in ((1, 5), (1, 4), (7, 99)):
        rig.recording.note_answers(uid, ticks, ["/wrench", "/other"])
    rig.recording.note_answers(1, 5, ["/yes"])
    rig.follow(TrialState.PHASE_FINISHED, 5)
    account = rig.account()
    answered = {name: json.loads(account[f"ticks {name}"])["answered"] for name in ("/state", "/wrench", "/yes|/no")}
    assert answered == {"/state": None, "/wrench": 5, "/yes|/no": None}


def test_an_aborted_trial_owes_no_answer_to_its_last_tick(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in range(5):
        rig.tick(tick)
    rig.send(rig.state, 5)
    rig.follow(TrialState.PHASE_ABORTED, 6)
    assert rig.recording.lost() == 0
    rig.recording.close()


def test_the_trial_is_in_the_bag(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_FINISHED, 9)
    rig.recording.close("trial finished")
    rig.recording.close()
    trial = dict(scan(rig.recording.writer.file).metadata)["trial"]
    custom = rig.recording.writer.metadata().custom_data
    for record in (trial, custom):
        expected = {"subject": "s07", "group": "training", "set": "b", "trial": "3", "seed": "11", "scenario": "cart"}
        assert expected.items() <= record.items()
        assert record["configuration_hash"] == "ab" * 32
        assert record["phase"] == "finished"
    assert custom["closed_because"] == "trial finished"
    assert trial["closed_because"] == "trial finished"


def test_a_new_trial_begins_a_new_account(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.follow(TrialState.PHASE_RUNNING)
    for tick in range(3):
        rig.tick(tick)
    rig.follow(TrialState.PHASE_RUNNING, uid=2)
    assert rig.recording.progress == -1
    rig.tick(0)
    assert (rig.recording.progress, rig.recording.lost()) == (EPOCH, 0)
    rig.recording.close()


def test_big_endian_stamps_are_understood(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.recording.receive(rig.wrench, b"\0\0\0\0" + (7).to_bytes(4, "big") + (5).to_bytes(4, "big") + bytes(60), NOW)
    rig.recording.close()
    assert [message.publish_time for message in messages(rig.path)] == [7_000_000_005]


def test_recordings_take_every_stream(make: Callable[..., Rig]) -> None:
    rig = make()
    assert [name for name, stream in rig.recording.streams().items() if not stream.stamped] == ["/text"]
    assert rig.recording.streams()["/yes"].ticks is rig.recording.streams()["/no"].ticks
    rig.recording.close()
