"""The display's node on real topics, with pages that are no browsers."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import aiohttp
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from loop_messages import SAMPLE
from page_client import Web, drive, serve

from mig_interfaces.msg import FilterDecision, SessionState, StudyChoices, StudySubject, TrialState
from mig_interfaces.srv import AbortTrial, ChooseSession, StartTrial
from rig_display.hand import STALLED, STOPPED
from rig_display.node import DisplayNode
from rig_runtime import topics
from shared_control.parameters import ParameterError

TOKEN = "a-token-of-the-tests"


def test_the_hand_arrives_clipped_with_the_stamp_of_its_tick(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    assert at.tick().wrench.force.x == 0.0
    page = drive(at, web)
    page.hold(12.5)
    at.until_force(12.5)
    page.hold(-1000.0, z=7.0)
    # The cart takes 20 m/s^2 of 2 kg along x, and nothing along z.
    at.until_force(-40.0)
    assert at.wrenches[-1].header.frame_id == topics.SENSOR_FRAME
    assert at.node.latency.spread().count > 0
    at.until(lambda: bool(page.ticks) and page.ticks[-1][7] == [-40.0, 0.0, 0.0])


def test_a_hand_that_falls_silent_pushes_nothing(bench: Callable[..., Any], web: Web) -> None:
    at = bench("stale_after:=0.3")
    page = drive(at, web)
    page.hold(10.0)
    at.until_force(10.0)
    page.drop()
    at.until_force(0.0)
    at.until(lambda: page.status["hand"]["reason"] == STALLED)
    page.hold(11.0)
    at.until_force(11.0)


def test_a_page_that_says_so_pushes_nothing_at_once(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    page, operator = drive(at, web), web.page(at.node, operator=True)
    for what in ("hidden", "out of focus", "leaving"):
        page.push(10.0)
        at.until_force(10.0)
        page.say("idle", reason=what)
        at.until_force(0.0)
        at.until(lambda what=what: what in operator.status["hand"]["reason"])


def test_a_page_that_is_gone_pushes_nothing_and_its_seat_is_free(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    page, other = drive(at, web), web.page(at.node)
    page.hold(10.0)
    at.until_force(10.0)
    other.say("drive")
    at.until(lambda: bool(other.notes))
    assert "somebody else drives" in other.notes[0]["text"]
    other.hold(-30.0)
    at.until(lambda: other.status["watchers"] == 1)
    assert at.tick().wrench.force.x == 10.0
    page.close()
    at.until_force(0.0)
    at.until(lambda: "disconnected" in other.status["hand"]["reason"])
    other.say("drive")
    at.until_force(-30.0)


def test_many_watch_and_one_drives(bench: Callable[..., Any], web: Web) -> None:
    at = bench("max_clients:=11")
    page, watchers = drive(at, web), [web.page(at.node) for _ in range(10)]
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        web.page(at.node)
    assert refused.value.status == 503
    page.hold(10.0)
    for watcher in watchers:
        watcher.push(-30.0)
    at.until_force(10.0)
    at.until(lambda: all(watcher.ticks and watcher.ticks[-1][7] == [10.0, 0.0, 0.0] for watcher in watchers))
    assert {watcher.status["driving"] for watcher in watchers} == {False}
    assert page.status["watchers"] == 10
    # Whoever watches may stop.
    watchers[3].say("stop")
    at.until_force(0.0)
    at.until(lambda: page.status["hand"]["stopped"] == "a watcher")


def test_what_is_recorded_holds_the_latencies(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    heard: list[DiagnosticStatus] = []
    at.graph.node.create_subscription(DiagnosticArray, "/diagnostics", lambda array: heard.extend(array.status), 10)
    page = drive(at, web)
    page.say("stats", rtt=2.0, drawn50=11.0, drawn99=21.0, drawnmax=31.0, fps=60.0)
    page.hold(10.0)
    at.until_force(10.0)

    def said() -> dict[str, str]:
        ours = [status for status in heard if status.name == "/rig/display"]
        return {pair.key: pair.value for pair in ours[-1].values} if ours else {}

    at.until(lambda: said().get("state to drawn p99 [ms]") == "21.0")
    at.until(lambda: float(said()["pointer to wrench p50 [ms]"]) > 0.0)


def test_the_emergency_stop_holds_until_it_is_released(bench: Callable[..., Any], web: Web) -> None:
    at = bench("driver_starts:=false")
    page, operator = drive(at, web), web.page(at.node, operator=True)
    page.hold(10.0)
    at.until_force(10.0)
    operator.say("stop")
    at.until_force(0.0)
    at.until(lambda: page.status["hand"] == {**page.status["hand"], "reason": STOPPED, "stopped": "the operator"})
    page.say("release")
    at.until(lambda: bool(page.notes))
    assert "only an operator" in page.notes[-1]["text"]
    for _ in range(20):
        assert at.tick().wrench.force.x == 0.0
    operator.say("release")
    at.until(lambda: "let go" in page.status["hand"]["reason"])
    assert at.tick().wrench.force.x == 0.0
    page.hold(0.0)
    at.until(lambda: page.status["hand"]["reason"] == "")
    page.hold(10.0)
    at.until_force(10.0)


def test_where_a_session_is_led_its_conductor_starts_the_trials(bench: Callable[..., Any], web: Web) -> None:
    at = bench("countdown:=0.0")
    names = (topics.PAUSE_SERVICE, topics.RESUME_SERVICE, topics.REPEAT_SERVICE)
    called = serve(at.graph, names)
    sessions = at.graph.publisher(topics.SESSION_STATE)
    page, operator = drive(at, web), web.page(at.node, operator=True)
    sessions.publish(SessionState(subject="S1", trials_planned=3, set="first", trial=1, instructions="Swing it up."))
    at.until(lambda: (operator.status.get("session") or {}).get("instructions") == "Swing it up.")
    operator.say("start", subject="S9", group="", set="", trial=1, duration=0.0)
    at.until(lambda: any("conductor starts the trials" in note["text"] for note in operator.notes))
    at.until(lambda: all(client.service_is_ready() for client in at.node._desk._conductor.values()))
    page.say("session", do="resume")
    at.until(lambda: any("only an operator" in note["text"] for note in page.notes))
    for what in ("pause", "resume", "repeat"):
        operator.say("session", do=what)
    at.until(lambda: sorted(called) == sorted(names))


def test_an_operator_and_nobody_else_chooses_whose_session_is_next(bench: Callable[..., Any], web: Web) -> None:
    at = bench("countdown:=0.0")
    asked: list[tuple[str, str]] = []

    def choose(request: ChooseSession.Request, response: ChooseSession.Response) -> ChooseSession.Response:
        asked.append((request.protocol, request.subject))
        response.success, response.message = request.subject == "S2", f"{request.subject} it is"
        return response

    at.graph.node.create_service(ChooseSession, topics.CHOOSE_SERVICE, choose)
    choices = at.graph.publisher(topics.STUDY_CHOICES)
    page, early = drive(at, web), web.page(at.node, operator=True)
    assert not page.status["choosing"]
    offered = StudySubject(
        protocol="demo", title="A demo", subject="S2", group="all", trials_done=1, trials_planned=9, problem=""
    )
    choices.publish(StudyChoices(subjects=[offered], message="it failed", failed=True))
    at.until(lambda: "choices" in early.heard and page.status["choosing"])
    late = web.page(at.node, operator=True)
    at.until(lambda: "choices" in late.heard)
    named = {"protocol": "demo", "title": "A demo", "subject": "S2", "group": "all", "done": 1, "planned": 9}
    for operator in (early, late):
        assert operator.heard["choices"]["subjects"] == [{**named, "problem": ""}]
        assert (operator.heard["choices"]["message"], operator.heard["choices"]["failed"]) == ("it failed", True)
    assert "choices" not in page.heard
    at.until(at.node._desk._chooser.service_is_ready)
    page.say("choose", protocol="demo", subject="S2")
    at.until(lambda: any("only an operator" in note["text"] for note in page.notes))
    early.say("start", subject="S9", group="", set="", trial=1, duration=0.0)
    at.until(lambda: any("choose whose session is next" in note["text"] for note in early.notes))
    assert not asked
    for subject, good in (("S1", False), ("S2", True)):
        late.say("choose", protocol="demo", subject=subject)
        at.until(lambda subject=subject: bool(late.notes) and late.notes[-1]["text"] == f"{subject} it is")
        assert late.notes[-1]["good"] is good
    assert asked == [("demo", "S1"), ("demo", "S2")]


def test_who_is_quicker_than_the_graph_is_waited_for(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    operator = web.page(at.node, operator=True)
    # Before the node is served at all, and before it has found who serves.
    at.node.executor = None
    operator.say("session", do="pause")
    operator.say("feedback", on=True)
    at.until(lambda: operator.status.get("feedback", False))
    timers = len(list(at.node.timers))
    at.node.executor = at.graph.executor
    at.until(lambda: len(list(at.node.timers)) > timers)
    assert operator.notes == []
    called = serve(at.graph, (topics.PAUSE_SERVICE,))
    at.until(lambda: bool(operator.notes))
    assert (called, operator.notes[-1]["text"]) == ([topics.PAUSE_SERVICE], "so be it")
    # Where nobody ever serves it, it is said.
    operator.say("session", do="repeat")
    at.until(lambda: len(operator.notes) == 2)
    assert f"nobody serves {topics.REPEAT_SERVICE}" in operator.notes[-1]["text"]


def test_what_no_page_sends_closes_the_connection_and_nothing_else(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    watcher = web.page(at.node)
    bad = {
        "not json": aiohttp.WSCloseCode.POLICY_VIOLATION,
        '{"type":"force","x":NaN,"y":0,"z":0,"t":1,"age":null}': aiohttp.WSCloseCode.POLICY_VIOLATION,
        '{"type":"abort","reason":"' + 5000 * "x" + '"}': aiohttp.WSCloseCode.MESSAGE_TOO_BIG,
    }
    for count, (text, code) in enumerate(bad.items(), 1):
        page = drive(at, web)
        page.push(10.0)
        at.until_force(10.0)
        page.say_text(text)
        at.until(lambda page=page: page.over)
        assert page.close_code == code
        at.until_force(0.0)
        at.until(lambda count=count: watcher.status["refused"] == count)
    assert not watcher.over


def test_too_many_messages_close_the_connection(bench: Callable[..., Any], web: Web) -> None:
    at = bench("message_rate:=20.0")
    page = drive(at, web)
    with contextlib.suppress(aiohttp.ClientError, ConnectionError):
        while not page.over:
            page.push(1.0)
    assert page.close_code == aiohttp.WSCloseCode.POLICY_VIOLATION
    assert at.node.seat.refused == 1


def test_other_origins_and_other_names_for_this_machine_are_refused(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    for origin in ("http://evil.example", "null", ""):
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            web.page(at.node, Origin=origin)
        assert refused.value.status == 403
    assert web.get(at.node.address, Host="evil.example")[0] == 403
    status, text, headers = web.get(at.node.address)
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    for outside in ("http://", "https://", "//cdn", "<style", "style=", "onclick"):
        assert outside not in text
    assert web.get(at.node.address + "static/..%2fnode.py")[0] == 404
    assert web.get(at.node.address + "static/index.html")[0] == 404


def test_a_token_is_asked_for_and_leaves_the_address(bench: Callable[..., Any], web: Web) -> None:
    at = bench("host:=0.0.0.0", f"token:={TOKEN}")
    for wrong in ("", "?token=wrong", "operator", "socket"):
        status, text, _ = web.get(at.node.address + wrong)
        assert status == 403
        assert TOKEN not in text
    with pytest.raises(aiohttp.WSServerHandshakeError):
        web.page(at.node)
    status, text, _ = web.get(f"{at.node.address}?token={TOKEN}")
    assert status == 200
    assert "<canvas" in text
    drive(at, web).hold(4.0)
    at.until_force(4.0)


def test_bad_parameters_are_one_sentence(bench: Callable[..., Any]) -> None:
    at = bench()
    bad = {
        ("host:=0.0.0.0",): "needs a token",
        ("host:=0.0.0.0", "token:=short"): "can be guessed",
        ("pacing:=lockstep",): "realtime",
        ("force_limits:=[1.0]",): "three numbers",
        ("hand:=foot",): "direct, spring",
        (f"port:={at.node.server.port}",): f"cannot listen on 127.0.0.1 port {at.node.server.port}",
    }
    for parameters, words in bad.items():
        with pytest.raises(ParameterError, match=words):
            at.graph.make(DisplayNode, *parameters)


def test_pages_are_shown_the_trial_and_what_the_filter_decides(bench: Callable[..., Any], web: Web) -> None:
    at = bench()
    page = web.page(at.node)
    armed = TrialState(phase=TrialState.PHASE_ARMING, uid=3, subject="S1", trial=4, ticks_planned=3000)
    armed.sample_time.nanosec = SAMPLE
    at.trials.publish(armed)
    at.until(lambda: page.status.get("trial", {}).get("subject") == "S1")
    assert page.status["trial"]["phase"] == "arming"
    assert page.status["trial"]["duration"] == 30.0
    assert page.heard["task"]["states"][0] == ["theta", "rad"]
    assert page.heard["task"]["limits"] == [40.0, 0.0, 0.0]
    # A trial waits for somebody to drive, and says so.
    assert "nobody drives" in at.node.make_report().error
    decision = FilterDecision(tick=0, verdict=FilterDecision.VERDICT_REJECTED, criterion=float("nan"), mode=1)
    at.decisions.publish(decision)
    at.until(lambda: at.node.feed.mode == "training")
    at.tick()
    at.until(lambda: bool(page.decisions))
    assert page.decisions[0][:4] == [0, 1, 0, None]
    drive(at, web)
    assert at.node.make_report().error == ""


def test_an_operator_starts_and_aborts_and_only_with_a_driver(bench: Callable[..., Any], web: Web) -> None:
    at = bench("countdown:=0.05")
    asked: list[Any] = []

    def start(request: StartTrial.Request, response: StartTrial.Response) -> StartTrial.Response:
        asked.append(request)
        response.success, response.message = True, "being armed"
        return response

    def abort(request: AbortTrial.Request, response: AbortTrial.Response) -> AbortTrial.Response:
        asked.append(request)
        response.message = "no trial is going on"
        return response

    at.graph.node.create_service(StartTrial, topics.START_SERVICE, start)
    at.graph.node.create_service(AbortTrial, topics.ABORT_SERVICE, abort)
    at.until(lambda: at.node._desk._starter.service_is_ready() and at.node._desk._aborter.service_is_ready())
    operator, watcher = web.page(at.node, operator=True), web.page(at.node)
    fields = {"subject": "S7", "group": "", "set": "a", "trial": 2, "duration": 10.0}
    operator.say("start", **fields)
    at.until(lambda: bool(operator.notes))
    assert "nobody drives" in operator.notes[-1]["text"]
    watcher.say("start", **fields)
    at.until(lambda: bool(watcher.notes))
    assert not asked
    drive(at, web)
    operator.say("start", **fields)
    at.until(lambda: bool(asked) and operator.notes[-1]["text"] == "being armed")
    assert (asked[0].subject, asked[0].set, asked[0].trial, asked[0].duration) == ("S7", "a", 2, 10.0)
    operator.say("abort", reason="enough")
    at.until(lambda: operator.notes[-1]["text"] == "no trial is going on")
    assert asked[1].reason == "enough"
