"""The recorder and trials: when a bag begins, when it ends, and what it says of its ticks."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import serialize_message
from recorded_loop import EPOCH, LATCHED, LOOP, STEP, Loop, make_recorder, matched, written

from mig_interfaces.msg import NodeReport, TrialState
from rig_bag import info, messages, read
from rig_bag.mcap_scan import scan
from rig_bag.opening import place_of
from rig_bag.recording import Trial


def test_each_trial_gets_a_bag_of_its_own(graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]) -> None:
    loop = Loop(graph, trial_state)
    recorder = make_recorder(graph, uri=str(tmp_path / "bags"), split="trial", pacing="lockstep")
    graph.until(matched(recorder, loop.trial, *loop.publishers.values()))
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
    recorder = make_recorder(single_graph, uri=str(tmp_path / "bags"), split="trial")
    single_graph.until(matched(recorder, loop.trial))
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
    recorder = make_recorder(
        graph, uri=str(tmp_path / "bag"), pacing="lockstep", progress_ticks=10, attachments=[str(scenario)]
    )
    # What it says once a second it says whatever the progress.
    recorder._watching.cancel()
    graph.until(matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_ARMING)
    loop.announce(TrialState.PHASE_RUNNING)
    for tick in range(60):
        loop.tick(tick)
    graph.until(lambda: written(recorder) >= 360)
    loop.announce(TrialState.PHASE_FINISHED, 60)
    graph.until(lambda: recorder.closed.done() and not loop.states[-1].recording)

    assert recorder.closed.result() == "trial finished"
    assert loop.states[-1].message == "trial finished"
    assert loop.states[-1].lost == 0
    assert loop.states[-1].uri == str(tmp_path / "bag")
    stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in loop.states]
    assert stamps == sorted(stamps)
    assert stamps[-1] == EPOCH + 59 * STEP
    said = set(stamps[:-1]) - {0}
    assert said
    assert said <= {EPOCH + tick * STEP for tick in (9, 19, 29, 39, 49, 59)}

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


def test_in_real_time_it_says_how_far_it_is_once_a_second(
    graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]
) -> None:
    loop = Loop(graph, trial_state)
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), topics=list(LOOP))
    # That second is over when this test says so.
    recorder._watching.cancel()
    graph.until(matched(recorder, *loop.publishers.values(), loop.trial))
    graph.until(lambda: bool(loop.states))
    loop.announce(TrialState.PHASE_RUNNING)
    graph.until(lambda: written(recorder) == 1)
    before = len(loop.states)
    for tick in range(60):
        loop.tick(tick)
    graph.until(lambda: written(recorder) == 361)
    assert recorder.recording.progress == EPOCH + 59 * STEP
    recorder._watch()
    graph.until(lambda: loop.states[-1].messages == 361)
    assert len(loop.states) == before + 1


def test_a_lost_tick_is_said(graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]) -> None:
    loop = Loop(graph, trial_state)
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), settle_limit=0.1)
    graph.until(matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_RUNNING)
    for tick in range(10):
        loop.tick(tick, *(["mig_filter/decision"] if tick in (4, 9) else []))
    graph.until(lambda: written(recorder) >= 58)
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
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), settle_limit=0.1)
    graph.until(matched(recorder, *loop.publishers.values(), loop.trial, reports))
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
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"), settle_limit=5.0)
    graph.until(matched(recorder, *loop.publishers.values(), loop.trial))
    loop.announce(TrialState.PHASE_RUNNING)
    loop.announce(TrialState.PHASE_FINISHED, 5)
    graph.until(lambda: recorder.recording.trial is not None and recorder.recording.trial.ended)
    for tick in range(4):
        clock[0] += 4.0
        before = written(recorder)
        loop.tick(tick)
        graph.until(lambda before=before: written(recorder) >= before + len(LOOP))

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
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"))
    graph.until(lambda: written(recorder) >= 1)
    loop.trial.publish(trial_state(TrialState.PHASE_RUNNING, 0, uid=2))
    graph.until(lambda: written(recorder) >= 2)
    loop.trial.publish(trial_state(TrialState.PHASE_ABORTED, 0, uid=2))
    graph.until(recorder.closed.done)
    assert recorder.closed.result() == "trial aborted"


def test_a_trial_that_cannot_be_is_counted_and_ends_nothing(
    single_graph: Any, tmp_path: Path, trial_state: Callable[..., TrialState]
) -> None:
    graph = single_graph
    loop = Loop(graph, trial_state)
    recorder = make_recorder(graph, uri=str(tmp_path / "bag"))
    graph.until(matched(recorder, loop.trial))
    for phase, data in ((200, None), (TrialState.PHASE_RUNNING, b"short")):
        before = recorder.refused
        loop.trial.publish(data or trial_state(phase, 0, uid=1))
        graph.until(lambda before=before: recorder.refused == before + 1)
    loop.announce(TrialState.PHASE_RUNNING)
    loop.announce(TrialState.PHASE_ABORTED)
    graph.until(recorder.closed.done)
    assert recorder.closed.result() == "trial aborted"
