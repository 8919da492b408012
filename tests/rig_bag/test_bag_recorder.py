"""The recorder node on real rclpy, under both executors, and in a process of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from mig_interfaces.msg import EndEffectorState, FilterDecision, NodeReport, RecorderState, TaskState, TrialState
from rig_bag import BagError, info, messages, read
from rig_bag.mcap_scan import scan
from rig_bag.opening import place_of
from rig_bag.recorder import RecorderNode
from rig_bag.recording import Trial
from rig_bag.verify import verify

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EPOCH = 1_000_000_000_000
STEP = 10_000_000
LOOP = {
    "task/state": TaskState,
    "force_sensor/wrench": WrenchStamped,
    "mig_filter/command": WrenchStamped,
    "mig_filter/decision": FilterDecision,
    "admittance/end_effector": EndEffectorState,
    "mig_filter/accepted": WrenchStamped,
}


def _overrides(**values: Any) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]


def _recorder(graph: Any, **values: Any) -> Any:
    return graph.add(RecorderNode(namespace="/rig", context=graph.context, parameter_overrides=_overrides(**values)))


def _matched(recorder: RecorderNode, *publishers: Any) -> Callable[[], bool]:
    """Whether both sides have found each other: a message sent before that may be lost."""
    return lambda: all(
        publisher.get_subscription_count() and recorder.matched().get(publisher.topic_name) for publisher in publishers
    )


def _written(recorder: Any) -> int:
    return 0 if recorder.recording is None else recorder.recording.writer.messages


class Loop:
    """The rig's per-tick topics, a trial's state, and a listener of the recorder's."""

    def __init__(self, graph: Any, trial_state: Callable[..., TrialState]) -> None:
        self._graph = graph
        self._trial_state = trial_state
        self.publishers = {
            name: graph.node.create_publisher(kind, name, QoSProfile(depth=200)) for name, kind in LOOP.items()
        }
        self.trial = graph.node.create_publisher(TrialState, "trial/state", LATCHED)
        self.states: list[RecorderState] = []
        graph.node.create_subscription(RecorderState, "recorder/state", self.states.append, LATCHED)

    def announce(self, phase: int, ticks: int = 0, uid: int = 1) -> None:
        self.trial.publish(self._trial_state(phase, ticks, uid))

    def tick(self, tick: int, *left_out: str) -> None:
        for name, publisher in self.publishers.items():
            if name not in left_out:
                message = LOOP[name]()
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(EPOCH + tick * STEP, 1_000_000_000)
                publisher.publish(message)


def test_it_records_what_is_published(graph: Any, tmp_path: Path, task_state: Callable[[int], TaskState]) -> None:
    best_effort = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
    states = graph.node.create_publisher(TaskState, "task/state", QoSProfile(depth=50))
    texts = graph.node.create_publisher(String, "/text", best_effort)
    latched = graph.node.create_publisher(String, "latched", LATCHED)
    latched.publish(String(data="before the recorder"))
    recorder = _recorder(
        graph,
        uri=str(tmp_path / "bag"),
        topics=["task/state", "/text", "latched", "late"],
        follow_trial=False,
        per_tick_topics=["task/state"],
    )
    assert recorder.intake.wanted == ("/rig/task/state", "/text", "/rig/latched", "/rig/late")
    assert recorder.matched()["/rig/late"] == 0
    graph.until(_matched(recorder, states, texts, latched))
    sent = [task_state(tick) for tick in range(20)]
    for message in sent:
        states.publish(message)
        texts.publish(String(data=f"text {message.tick}"))
    graph.until(lambda: _written(recorder) >= 41)
    late = graph.node.create_publisher(String, "late", LATCHED)
    late.publish(String(data="late"))
    graph.until(lambda: _written(recorder) >= 42)
    recorder.close()
    recorder.close()
    assert recorder.closed.done()
    assert not recorder.failed

    stored: dict[str, list[bytes]] = {}
    for message in messages(tmp_path / "bag"):
        stored.setdefault(message.topic, []).append(message.data)
    assert [deserialize_message(data, TaskState) for data in stored["/rig/task/state"]] == sent
    assert [deserialize_message(data, String).data for data in stored["/text"]] == [f"text {k}" for k in range(20)]
    assert [deserialize_message(data, String).data for data in stored["/rig/latched"]] == ["before the recorder"]
    assert [deserialize_message(data, String).data for data in stored["/rig/late"]] == ["late"]
    with AnyReader([tmp_path / "bag"]) as reader:
        decoded = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/rig/task/state"
        ]
    assert [list(item.state) for item in decoded] == [list(item.state) for item in sent]

    entries = {entry.name: entry for entry in info(tmp_path / "bag").metadata.topics}
    assert [entries[name].qos[0].reliability for name in ("/rig/task/state", "/text")] == ["reliable", "best_effort"]
    assert entries["/rig/latched"].qos[0].durability == "transient_local"
    assert entries["/rig/task/state"].type_hash.startswith("RIHS01_")
    log_times = [message.log_time for message in messages(tmp_path / "bag")]
    assert log_times[0] > 1_600_000_000_000_000_000


def test_each_trial_gets_a_bag_of_its_own(graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]) -> None:
    loop = Loop(graph, trial_state)
    recorder = _recorder(graph, uri=str(tmp_path / "bags"), split="trial", pacing="lockstep")
    graph.until(_matched(recorder, loop.trial, *loop.publishers.values()))
    assert recorder.recording is None
    assert recorder.make_report().error == ""
    for uid, ticks in ((1, 3), (2, 5)):
        loop.announce(TrialState.PHASE_ARMING, uid=uid)
        graph.until(lambda: recorder.recording is not None)
        loop.announce(TrialState.PHASE_RUNNING, uid=uid)
        for tick in range(ticks):
            loop.tick(tick)
        loop.announce(TrialState.PHASE_FINISHED, ticks, uid=uid)
        graph.until(lambda: recorder.recording is None)
        assert not recorder.closed.done()
    # The same subject, set and trial: another attempt. A trial that never ran leaves a bag that says so.
    loop.announce(TrialState.PHASE_ARMING, uid=3)
    graph.until(lambda: recorder.recording is not None)
    loop.announce(TrialState.PHASE_ARMING, uid=4)
    graph.until(lambda: recorder.path.name.endswith("a4"))
    recorder.finish()
    assert recorder.closed.done()
    graph.until(lambda: loop.states[-1].uri.endswith("a4") and not loop.states[-1].recording)
    bags = sorted((tmp_path / "bags").iterdir())
    assert [bag.name for bag in bags] == [f"s07_b_003_a{attempt}" for attempt in (1, 2, 3, 4)]
    for bag, ticks in zip(bags, (3, 5, 0, 0), strict=True):
        counts = {topic.name: topic.count for topic in info(bag).metadata.topics}
        assert counts["/rig/task/state"] == counts["/rig/mig_filter/decision"] == ticks
        assert info(bag).metadata.custom_data["subject"] == "s07"


def test_an_attempt_that_is_started_again_has_a_bag_too(tmp_path: Path, trial_state: Callable[..., TrialState]) -> None:
    message = trial_state(TrialState.PHASE_ARMING)
    message.attempt = 2
    names = []
    for _ in range(3):
        place = place_of(Trial.from_message(message), tmp_path)
        place.mkdir()
        names.append(place.name)
    assert names == ["s07_b_003_a2", "s07_b_003_a2_2", "s07_b_003_a2_3"]


def test_a_trial_whose_bag_cannot_be_made_is_refused_by_report(
    single_graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]
) -> None:
    loop = Loop(single_graph, trial_state)
    (tmp_path / "bags").write_text("a file where a directory is wanted")
    recorder = _recorder(single_graph, uri=str(tmp_path / "bags"), split="trial")
    single_graph.until(_matched(recorder, loop.trial))
    loop.announce(TrialState.PHASE_ARMING)
    single_graph.until(lambda: bool(recorder.make_report().error))
    assert "bags" in recorder.make_report().error
    (tmp_path / "bags").unlink()
    loop.announce(TrialState.PHASE_ARMING, uid=2)
    single_graph.until(lambda: recorder.recording is not None)
    assert recorder.make_report().error == ""


def test_a_lockstep_trial_ends_the_bag(graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]) -> None:
    scenario = tmp_path / "cart.yaml"
    scenario.write_text("seed: 11\n")
    loop = Loop(graph, trial_state)
    recorder = _recorder(
        graph, uri=str(tmp_path / "bag"), pacing="lockstep", progress_ticks=10, attachments=[str(scenario)]
    )
    graph.until(_matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_ARMING)
    loop.announce(TrialState.PHASE_RUNNING)
    for tick in range(60):
        loop.tick(tick)
    graph.until(lambda: _written(recorder) >= 360)
    loop.announce(TrialState.PHASE_FINISHED, 60)
    graph.until(lambda: recorder.closed.done() and not loop.states[-1].recording)

    assert recorder.closed.result() == "trial finished"
    assert loop.states[-1].message == "trial finished"
    assert loop.states[-1].lost == 0
    assert loop.states[-1].uri == str(tmp_path / "bag")
    stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in loop.states]
    assert stamps == sorted(stamps)
    assert stamps[-1] == EPOCH + 59 * STEP
    assert set(stamps[1:-1]) <= {EPOCH + tick * STEP for tick in (9, 19, 29, 39, 49, 59)}

    metadata = info(tmp_path / "bag").metadata
    assert (metadata.start, metadata.duration) == (EPOCH, 59 * STEP)
    assert metadata.custom_data["complete"] == "true"
    assert metadata.custom_data["subject"] == "s07"
    contents = scan(tmp_path / "bag" / "bag_0.mcap")
    assert [(name, data) for name, _, data in contents.attachments] == [("cart.yaml", b"seed: 11\n")]
    # What the trial was, where, and with what: in the record as in metadata.yaml.
    record = dict(contents.metadata)["trial"]
    for key in ("subject", "group", "set", "trial", "seed", "scenario", "configuration_hash"):
        assert record[key] == metadata.custom_data[key] != ""
    for key in ("host", "scheduling", "rmw", "python", "version numpy", "version rclpy"):
        assert record[key] == metadata.custom_data[key] != ""
    account = dict(contents.metadata)["completeness"]
    assert json.loads(account["ticks /rig/task/state"])["received"] == 60
    arrays = read(tmp_path / "bag")
    assert len(arrays["/rig/mig_filter/decision"]) == 60
    assert (arrays["/rig/task/state"]["log_time"] >= arrays["/rig/task/state"]["stamp"]).all()


def test_a_lost_tick_is_said(graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]) -> None:
    loop = Loop(graph, trial_state)
    recorder = _recorder(graph, uri=str(tmp_path / "bag"), settle_limit=0.1)
    graph.until(_matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_RUNNING)
    for tick in range(10):
        loop.tick(tick, *(["mig_filter/decision"] if tick in (4, 9) else []))
    graph.until(lambda: _written(recorder) >= 58)
    loop.announce(TrialState.PHASE_FINISHED, 10)
    graph.until(lambda: recorder.closed.done() and not loop.states[-1].recording)
    assert loop.states[-1].lost == 2
    assert info(tmp_path / "bag").metadata.custom_data["complete"] == "false"


def test_a_report_that_was_cut_takes_nothing_from_what_its_node_has_said(
    single_graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]
) -> None:
    graph = single_graph
    loop = Loop(graph, trial_state)
    reports = graph.node.create_publisher(NodeReport, "trial/reports", LATCHED)
    recorder = _recorder(graph, uri=str(tmp_path / "bag"), settle_limit=0.1)
    graph.until(_matched(recorder, *loop.publishers.values(), loop.trial, reports))
    loop.announce(TrialState.PHASE_RUNNING)
    for tick in range(5):
        loop.tick(tick, *(["force_sensor/wrench"] if tick == 3 else []))
    graph.until(lambda: recorder.recording.trial is not None)
    report = NodeReport(node="/rig/user_sim", armed_uid=1, publishes=["/rig/force_sensor/wrench"])
    for report.ticks_done in (3, 5):
        reports.publish(report)
    # All that stands before the topics is whole, so it says who speaks.
    cut = bytes(serialize_message(report))[:72]
    assert b"/rig/user_sim" in cut
    reports.publish(cut)
    graph.until(lambda: recorder.refused == 1)
    loop.announce(TrialState.PHASE_FINISHED, 5)
    graph.until(recorder.closed.done)
    account = dict(scan(tmp_path / "bag" / "bag_0.mcap").metadata)["completeness"]
    ticks = json.loads(account["ticks /rig/force_sensor/wrench"])
    assert (ticks["answered"], ticks["received"], ticks["missing"]) == (5, 4, 1)
    assert json.loads(account["ticks /rig/task/state"])["answered"] is None
    # The cut one is recorded as it came.
    assert cut in [message.data for message in messages(tmp_path / "bag", ["/rig/trial/reports"])]


def test_an_ended_trial_is_waited_for_while_its_ticks_still_come(
    graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [100.0]
    monkeypatch.setattr("rig_bag.recorder._now", lambda: clock[0])
    loop = Loop(graph, trial_state)
    recorder = _recorder(graph, uri=str(tmp_path / "bag"), settle_limit=5.0)
    graph.until(_matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_RUNNING)
    loop.announce(TrialState.PHASE_FINISHED, 5)
    graph.until(lambda: recorder.recording.trial is not None and recorder.recording.trial.ended)
    for tick in range(4):
        clock[0] += 4.0
        before = _written(recorder)
        loop.tick(tick)
        graph.until(lambda before=before: _written(recorder) >= before + len(LOOP))

    def silent() -> bool:
        clock[0] += 1.0
        return bool(recorder.closed.done())

    graph.until(silent)
    graph.until(lambda: not loop.states[-1].recording)
    assert loop.states[-1].lost == len(LOOP)


def test_an_old_trial_does_not_end_a_new_bag(
    single_graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]
) -> None:
    graph = single_graph
    loop = Loop(graph, trial_state)
    loop.trial.publish(trial_state(TrialState.PHASE_FINISHED, 100, uid=1))
    recorder = _recorder(graph, uri=str(tmp_path / "bag"))
    graph.until(lambda: _written(recorder) >= 1)
    loop.trial.publish(trial_state(TrialState.PHASE_RUNNING, 0, uid=2))
    graph.until(lambda: _written(recorder) >= 2)
    loop.trial.publish(trial_state(TrialState.PHASE_ABORTED, 0, uid=2))
    graph.until(recorder.closed.done)
    assert recorder.closed.result() == "trial aborted"


def test_a_trial_that_cannot_be_is_counted_and_ends_nothing(
    single_graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]
) -> None:
    graph = single_graph
    loop = Loop(graph, trial_state)
    recorder = _recorder(graph, uri=str(tmp_path / "bag"))
    graph.until(_matched(recorder, loop.trial))
    for phase, data in ((200, None), (TrialState.PHASE_RUNNING, b"short")):
        before = recorder.refused
        loop.trial.publish(data or trial_state(phase, 0, uid=1))
        graph.until(lambda before=before: recorder.refused == before + 1)
    loop.announce(TrialState.PHASE_RUNNING)
    loop.announce(TrialState.PHASE_ABORTED)
    graph.until(recorder.closed.done)
    assert recorder.closed.result() == "trial aborted"


def test_patterns_and_types_that_are_not_there(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    publishers = {
        name: graph.node.create_publisher(String, name, LATCHED)
        for name in ("a/one", "a/two", "a/not", "b", "_hidden/a")
    }
    for publisher in publishers.values():
        publisher.publish(String(data="x"))
    recorder = _recorder(
        graph, uri=str(tmp_path / "bag"), topics=[""], regex="/a/", exclude_regex="not", follow_trial=False
    )
    graph.until(lambda: _written(recorder) >= 2)
    late = graph.node.create_publisher(String, "a/late", LATCHED)
    late.publish(String(data="y"))
    graph.until(lambda: _written(recorder) >= 3)
    recorder.close()
    assert {message.topic for message in messages(tmp_path / "bag")} == {"/rig/a/one", "/rig/a/two", "/rig/a/late"}


def test_a_bag_is_split_and_labelled_as_asked_for(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    (tmp_path / "qos.yaml").write_text("/text: {reliability: best_effort, depth: 7}\n")
    publishers = [graph.node.create_publisher(String, name, QoSProfile(depth=100)) for name in ("/text", "/other")]
    recorder = _recorder(
        graph,
        uri=str(tmp_path / "bag"),
        topics=[""],
        regex="^/(text|other)$",
        exclude_topics=["/other"],
        follow_trial=False,
        max_bag_size=1,
        custom_data=["subject=s07", "note=a=b"],
        qos_profile_overrides_path=str(tmp_path / "qos.yaml"),
    )
    graph.until(_matched(recorder, publishers[0]))
    readers = graph.node.get_subscriptions_info_by_topic("/text")
    assert [reader.qos_profile.reliability for reader in readers] == [ReliabilityPolicy.BEST_EFFORT]
    for number in range(3):
        publishers[0].publish(String(data=f"{number}"))
        before = recorder.recording.writer.file
        graph.until(lambda number=number: recorder.recording.writer.messages >= number + 1)
        recorder.recording.writer.flush()
        assert number == 0 or recorder.recording.writer.file != before
    recorder.close()
    metadata = info(tmp_path / "bag").metadata
    assert len(metadata.files) == 3
    assert [topic.name for topic in metadata.topics] == ["/text"]
    assert (metadata.custom_data["subject"], metadata.custom_data["note"]) == ("s07", "a=b")
    assert [message.data[8:9] for message in messages(tmp_path / "bag", ["/text"])] == [b"0", b"1", b"2"]


def test_a_clock_that_is_set_does_not_move_the_bags_times(
    single_graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    graph = single_graph
    set_by = [0]
    monkeypatch.setattr("rig_bag.recorder._wall", lambda: time.time_ns() + set_by[0])
    publisher = graph.node.create_publisher(String, "text", QoSProfile(depth=100))
    recorder = _recorder(graph, uri=str(tmp_path / "bag"), topics=["text"], follow_trial=False)
    graph.until(_matched(recorder, publisher))
    for hours in (0, -5, 3):
        set_by[0] = hours * 3_600_000_000_000
        recorder._watch()
        before = _written(recorder)
        publisher.publish(String(data="x"))
        graph.until(lambda before=before: _written(recorder) == before + 1)
    recorder.close()
    said = capfd.readouterr().err
    assert "clock was set by -18000." in said
    assert "clock was set by +28800." in said
    times = [message.log_time for message in messages(tmp_path / "bag")]
    assert times == sorted(times)
    assert times[-1] - times[0] < 3_600_000_000_000
    account = dict(scan(tmp_path / "bag" / "bag_0.mcap").metadata)["completeness"]
    jumps = json.loads(account["clock jumps [ns]"])
    assert [round(jump / 3_600_000_000_000) for jump in jumps] == [-5, 8]
    assert verify(tmp_path / "bag").ok


def test_publishers_that_vanish_are_named_and_a_trial_without_its_pacemaker_ends_its_bag(
    single_graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState], capfd: pytest.CaptureFixture[str]
) -> None:
    graph = single_graph
    loop = Loop(graph, trial_state)
    recorder = _recorder(graph, uri=str(tmp_path / "bag"), settle_limit=0.2)
    graph.until(_matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_ARMING)
    loop.announce(TrialState.PHASE_RUNNING)
    for tick in range(10):
        loop.tick(tick)
    graph.until(lambda: _written(recorder) >= 62)
    recorder._watch()
    graph.node.destroy_publisher(loop.publishers["mig_filter/decision"])
    graph.until(lambda: not recorder.matched()["/rig/mig_filter/decision"])
    recorder._watch()
    assert "no longer published: /rig/mig_filter/decision" in capfd.readouterr().err
    assert not recorder.closed.done()
    graph.node.destroy_publisher(loop.trial)
    graph.until(recorder.closed.done)
    assert recorder.closed.result() == "the publisher of /rig/trial/state vanished during the trial"
    assert not recorder.failed
    found = verify(tmp_path / "bag")
    assert found.ok, found.text()
    assert found.counts["/rig/task/state"] == 10
    assert info(tmp_path / "bag").metadata.custom_data["complete"] == "false"


def test_a_topic_is_recorded_on_when_its_publisher_comes_back(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    recorder = _recorder(graph, uri=str(tmp_path / "bag"), topics=["text"], follow_trial=False)
    for number in range(2):
        publisher = graph.node.create_publisher(String, "text", QoSProfile(depth=100))
        graph.until(_matched(recorder, publisher))
        publisher.publish(String(data="x"))
        graph.until(lambda number=number: _written(recorder) == number + 1)
        graph.node.destroy_publisher(publisher)
        graph.until(lambda: not recorder.matched()["/rig/text"])
    recorder.close()
    assert len(list(messages(tmp_path / "bag"))) == 2


def test_faults_at_the_start_leave_no_node(single_graph: Any, tmp_path: Path) -> None:
    graph = single_graph
    (tmp_path / "there").mkdir()
    for values, says in (
        ({"uri": str(tmp_path / "there")}, "exists already"),
        ({"uri": str(tmp_path / "a"), "regex": "("}, "not a regular expression"),
        ({"uri": str(tmp_path / "a"), "exclude_regex": "("}, "not a regular expression"),
        ({"uri": str(tmp_path / "a"), "qos_profile_overrides_path": str(tmp_path / "none")}, "cannot be read"),
        ({"uri": "/proc/bag"}, "cannot make the bag /proc/bag"),
        ({"uri": str(tmp_path / "b"), "attachments": [str(tmp_path / "none.yaml")]}, "cannot attach"),
    ):
        with pytest.raises(BagError, match=says):
            RecorderNode(namespace="/rig", context=graph.context, parameter_overrides=_overrides(**values))
    assert graph.node.get_node_names() == ["probe"]


def test_a_disk_that_fills_closes_the_bag_and_says_so(
    single_graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = single_graph
    states: list[RecorderState] = []
    graph.node.create_subscription(RecorderState, "recorder/state", states.append, LATCHED)
    publisher = graph.node.create_publisher(String, "text", QoSProfile(depth=100))
    recorder = _recorder(graph, uri=str(tmp_path / "bag"), topics=["text"], follow_trial=False)
    graph.until(_matched(recorder, publisher))
    write = os.pwrite

    def full(descriptor: int, data: bytes, offset: int) -> int:
        if offset + len(data) > 60_000:
            raise OSError(28, "No space left on device")
        return write(descriptor, data, offset)

    monkeypatch.setattr(os, "pwrite", full)
    for _ in range(10):
        publisher.publish(String(data=os.urandom(10_000).hex()))
    graph.until(lambda: recorder.closed.done() and bool(states) and not states[-1].recording)
    assert recorder.failed
    assert "No space left on device" in states[-1].message
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count < 10


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_closed_bag(
    single_graph: Any, tmp_path: Path, number: int, task_state: Callable[[int], TaskState]
) -> None:
    graph = single_graph
    states: list[RecorderState] = []
    graph.node.create_subscription(RecorderState, "recorder/state", states.append, LATCHED)
    # Latched: from here it cannot be seen when the other process has found this publisher.
    latched = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = graph.node.create_publisher(TaskState, "task/state", latched)
    bag = tmp_path / "bag"
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "rig_bag.recorder", "--ros-args", "-r", "__ns:=/rig"),
            *("-p", f"uri:={bag}", "-p", "topics:=[task/state]", "-p", "per_tick_topics:=[task/state]"),
            *("-p", "progress_ticks:=1", "-p", "follow_trial:=false"),
        ],
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain)},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        for tick in range(30):
            publisher.publish(task_state(tick))
        graph.until(lambda: bool(states) and states[-1].messages == 30, limit=120.0)
        process.send_signal(number)
        graph.until(lambda: process.poll() is not None, limit=120.0)
    finally:
        process.kill()
        _, errors = process.communicate()
    assert process.returncode == 0, errors
    assert len(read(bag)["/rig/task/state"]) == 30
    assert info(bag).metadata.custom_data["closed_because"] == "the recorder was told to end"
    with AnyReader([bag]) as reader:
        assert reader.message_count == 30
