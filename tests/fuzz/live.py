"""Boundaries of live nodes: the messages of every topic, services and parameters, the pages' sockets."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiohttp
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from fuzz.boundary import ACCEPTED, REFUSED, Boundary, UnclearError
from fuzz.files import _CONFIGURATIONS, page_message
from fuzz.garbage import Garbage
from fuzz.rig import PROTOCOLS, SUBJECTS, Rig
from loop_messages import SAMPLE, state, wrench
from page_client import Web
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from mig_interfaces.msg import (
    EndEffectorState,
    FilterDecision,
    NodeReport,
    RecorderState,
    SessionState,
    StudyChoices,
    StudySubject,
    TrialState,
)
from mig_interfaces.srv import AbortTrial, ChooseSession, StartTrial
from rig_runtime import topics
from rig_runtime.ticks import LOCKSTEP_EPOCH, to_stamp
from shared_control.filter import Reason
from shared_control.parameters import declarations


class _OfRig(Boundary):
    """A boundary of the live rig."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.rig = Rig(folder)

    def finish(self) -> None:
        try:
            self.rig.check()
            self._run_a_trial()
            self._lead_a_trial()
        finally:
            self.rig.close()

    def _run_a_trial(self) -> None:
        """After everything a trial can be run: each tick is moved, pushed and judged."""
        graph, rig, task = self.rig.graph, self.rig, self.rig.nodes[0]
        for name in (topics.PAUSE_SERVICE, topics.CLEAR_FILTER_SERVICE, topics.CLEAR_ROBOT_SERVICE):
            rig.call(Trigger, name, Trigger.Request())
        decisions = graph.collect(topics.DECISION)
        graph.until(lambda: graph.node.count_publishers(topics.DECISION.name) > 0)
        # A trial that the conductor was just about to start comes in between once.
        for _ in range(2):
            rig.call(Trigger, topics.RESET_SERVICE, Trigger.Request())
            answer = rig.call(StartTrial, topics.START_SERVICE, StartTrial.Request(duration=0.2))
            if answer.success:
                break
        assert answer.success, answer.message
        graph.until(lambda: task.trial.phase == TrialState.PHASE_FINISHED and len(decisions) >= 20, limit=50.0)

    def _lead_a_trial(self) -> None:
        """And the conductor leads the next trial of its session to its end."""
        self.rig.follow_choice()
        conductor, progress = self.rig.conductor, self.rig.conductor.session.progress
        done = len(progress.done)
        self.rig.graph.until(lambda: conductor.state().waiting, limit=30.0)
        answer = self.rig.call(Trigger, topics.RESUME_SERVICE, Trigger.Request())
        assert answer.success, answer.message
        self.rig.graph.until(lambda: len(progress.done) > done, limit=30.0)


def _near(kind: Any) -> Any:
    """A message of the kind that a good node would send."""
    if kind is topics.TASK_STATE.type:
        return state(5)
    if kind is topics.WRENCH.type:
        return wrench(5, 3.0)
    message = kind()
    if kind is TrialState:
        message.uid, message.phase, message.task = 7, TrialState.PHASE_RUNNING, "cart_pendulum"
        message.sample_time.nanosec, message.ticks_planned = SAMPLE, 100
        message.epoch = to_stamp(LOCKSTEP_EPOCH)
    elif kind is NodeReport:
        message.node, message.publishes, message.matched_subscriptions = "/rig/mig_filter", ["/rig/a"], [1]
    elif kind is DiagnosticArray:
        message.status = [DiagnosticStatus(name="/rig/mig_filter", values=[KeyValue(key="a", value="b")])]
    elif kind is EndEffectorState:
        message.header.frame_id, message.header.stamp = topics.BASE_FRAME, to_stamp(LOCKSTEP_EPOCH)
    elif kind is StudyChoices:
        message.subjects = [StudySubject(protocol=PROTOCOLS[0], subject=SUBJECTS[0], trials_planned=5)]
    elif kind is RecorderState:
        message.uri, message.recording = "/nowhere/trial_000_a1", True
    elif kind is SessionState:
        message.protocol, message.subject, message.trials_planned, message.set = PROTOCOLS[0], SUBJECTS[0], 5, "first"
    elif kind is FilterDecision:
        message.user_control = message.nominal_control = message.applied_control = [1.0]
    return message


class Messages(_OfRig):
    """Messages of any content on every topic that a node hears, and bytes that are none."""

    name = "messages to live nodes"
    share = 7.0
    topics = (
        topics.TASK_STATE, topics.WRENCH, topics.COMMAND, topics.END_EFFECTOR, topics.DECISION, topics.TRIAL_STATE,
        topics.NODE_REPORT, topics.RECORDER_STATE, topics.SESSION_STATE, topics.STUDY_CHOICES,
    )  # fmt: skip

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        graph = self.rig.graph
        self._publishers = [(topic.type, graph.publisher(topic)) for topic in self.topics]
        self._publishers.append((DiagnosticArray, graph.node.create_publisher(DiagnosticArray, "/diagnostics", 10)))
        graph.until(lambda: all(publisher.get_subscription_count() for _, publisher in self._publishers))

    def send(self, garbage: Garbage) -> str:
        # Half of them where forces and states come in.
        publishers = self._publishers[:4] if garbage.maybe(0.5) else self._publishers
        kind, publisher = garbage.choice(publishers)
        message = garbage.message(self.near(kind, garbage), garbage.choice((0.05, 0.2, 0.8)))
        before = self.refusals()
        data = bytes(serialize_message(message))
        if garbage.maybe(0.4):
            data = garbage.bent_bytes(data)
        if publisher.topic_name == f"/rig/{topics.COMMAND.name}":
            self.rig.false_commands.add(data)
        publisher.publish(data)
        self.rig.answer()
        self.rig.check()
        return REFUSED if self.refusals() != before else ACCEPTED

    def refusals(self) -> list[Any]:
        """What the nodes count of what they did not take."""
        return [
            (node.refused, *(node.diagnose()[2].get(key) for key in ("late", "duplicates", "dropped", "late motions")))
            for node in self.rig.nodes
        ]

    def near(self, kind: Any, garbage: Garbage) -> Any:
        """A message of the kind that a good node would send."""
        return _near(kind)


class InATrial(Messages):
    """Messages of any content, for the ticks of a trial that runs in real time, and nodes that stand still meanwhile.

    What is looked for is what the watchdogs, which look by the clock, do with garbage.
    """

    name = "messages within a trial"
    share = 1.5

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._inputs = 0
        self._decisions = self.rig.graph.collect(topics.DECISION)
        self._silenced = self._stale = 0

    def send(self, garbage: Garbage) -> str:
        # Garbage may have led nodes into trials that there are not: a new one takes them back.
        if self._inputs % 40 == 0:
            self.rig.call(Trigger, topics.RESET_SERVICE, Trigger.Request())
            self.rig.call(StartTrial, topics.START_SERVICE, StartTrial.Request(duration=3600.0))
            self.rig.serve(5.0, lambda: self.rig.nodes[0].trial.phase == TrialState.PHASE_RUNNING)
        self._inputs += 1
        if garbage.maybe(0.1):
            before = self.refusals()
            self._silenced += 1
            self.rig.silence(garbage.choice(self.rig.nodes[:4]), garbage.uniform(0.0, 0.12))
            self.rig.answer()
            self.rig.check()
            result = REFUSED if self.refusals() != before else ACCEPTED
        else:
            result = super().send(garbage)
        self._stale += sum(decision.reason == Reason.STALE_WRENCH for decision in self._decisions)
        self._decisions.clear()
        return result

    def refusals(self) -> list[Any]:
        # Of good messages too some are late where a node has stood still.
        return [node.refused for node in self.rig.nodes]

    def near(self, kind: Any, garbage: Garbage) -> Any:
        message, agent = _near(kind), self.rig.nodes[1]
        if agent.clock is not None and hasattr(message, "header"):
            tick = max(0, agent.ticks_done + garbage.randint(-2, 3))
            # A false trial's clock may count beyond what a stamp holds.
            with contextlib.suppress(AssertionError):
                message.header.stamp = to_stamp(agent.clock.stamp(tick))
        return message

    def finish(self) -> None:
        super().finish()
        assert self._stale or self._silenced < 10, "no watchdog has ever found a wrench to be late"


class Services(_OfRig):
    """Calls of every service with any content, the conductor's and parameters included."""

    name = "services of live nodes"
    share = 3.0

    def send(self, garbage: Garbage) -> str:
        asked, answer = self._ask(garbage)
        self.rig.answer()
        self.rig.check()
        results = answer.results if hasattr(answer, "results") else [getattr(answer, "result", answer)]
        good = all(getattr(result, "successful", getattr(result, "success", None)) for result in results)
        if not good:
            text = " ".join(getattr(result, "reason", getattr(result, "message", "")) for result in results)
            if not text.strip() or len(text) > 5000:
                raise UnclearError(f"{asked} is refused with {text[:300]!r}")
        return ACCEPTED if good else REFUSED

    def _ask(self, garbage: Garbage) -> tuple[object, Any]:
        """What was asked, and the answer."""
        kind, name, request = self._question(garbage)
        answer = self.rig.call(kind, name, request)
        self.rig.follow_choice()
        return request, answer

    def _question(self, garbage: Garbage) -> tuple[Any, str, Any]:
        kind = garbage.randrange(11)
        if kind == 0:
            return StartTrial, topics.START_SERVICE, garbage.message(StartTrial.Request(duration=1.0), 0.5)
        if kind == 1:
            return AbortTrial, topics.ABORT_SERVICE, garbage.message(AbortTrial.Request(), 0.9)
        if kind == 2:
            names = (topics.RESET_SERVICE, topics.CLEAR_FILTER_SERVICE, topics.CLEAR_ROBOT_SERVICE)
            return Trigger, garbage.choice(names), Trigger.Request()
        if kind == 3:
            names = (topics.PAUSE_SERVICE, topics.RESUME_SERVICE, topics.REPEAT_SERVICE)
            return Trigger, garbage.choice(names), Trigger.Request()
        if kind == 4:
            near = ChooseSession.Request(protocol=garbage.choice(PROTOCOLS), subject=garbage.choice(SUBJECTS))
            return ChooseSession, topics.CHOOSE_SERVICE, garbage.message(near, 0.4)
        node = garbage.choice([*self.rig.nodes, self.rig.conductor])
        parameters = [_parameter(garbage) for _ in range(garbage.randint(1, 3))]
        # The force that is believed is what the commands are checked against.
        parameters = [parameter for parameter in parameters if parameter.name != "max_force"]
        atomic = SetParametersAtomically if garbage.maybe(0.2) else SetParameters
        name = "set_parameters_atomically" if atomic is SetParametersAtomically else "set_parameters"
        return atomic, f"{node.get_name()}/{name}", atomic.Request(parameters=parameters)


def _parameter(garbage: Garbage) -> Parameter:
    declared = garbage.choice(
        [d for kind in _CONFIGURATIONS for d in declarations(kind) if d.live or garbage.maybe(0.1)]
    )
    value = garbage.message(ParameterValue(), 0.5)
    if garbage.maybe(0.6):
        value.type = {
            "bool": ParameterType.PARAMETER_BOOL, "int": ParameterType.PARAMETER_INTEGER,
            "float": ParameterType.PARAMETER_DOUBLE, "str": ParameterType.PARAMETER_STRING,
        }.get(declared.kind, ParameterType.PARAMETER_DOUBLE_ARRAY)  # fmt: skip
    else:
        value.type = garbage.choice((*range(10), 200))
    if declared.choices and garbage.maybe(0.5):
        value.string_value = garbage.choice(declared.choices)
    return Parameter(name=declared.name if garbage.maybe(0.9) else garbage.text(), value=value)


class Pages(_OfRig):
    """What a browser, or what claims to be one, sends to the display's server: texts, bytes, requests."""

    name = "sockets and requests"
    share = 15.0

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._web = Web()
        self._display = self.rig.nodes[4]
        self._socket: aiohttp.ClientWebSocketResponse | None = None

    def send(self, garbage: Garbage) -> str:
        result: str = self._web.run(self._request(garbage) if garbage.maybe(0.1) else self._say(garbage))
        self.rig.answer()
        self.rig.check()
        return result

    async def _say(self, garbage: Garbage) -> str:
        session = self._web._session
        address = self._display.address
        if self._socket is None or self._socket.closed or garbage.maybe(0.01):
            role = garbage.choice(("socket", "socket?as=operator"))
            self._socket = await session.ws_connect(address + role, headers={"Origin": address.rstrip("/")})
        socket, refused = self._socket, self._display.seat.refused
        with contextlib.suppress(aiohttp.ClientError, ConnectionError):
            if garbage.maybe(0.05):
                await socket.send_bytes(garbage.bent_bytes(b"abc"))
            else:
                await socket.send_str("x" * 5000 if garbage.maybe(0.02) else page_message(garbage))
            await socket.send_str('{"type": "sync", "t": 1.0}')
            # An answer, or the connection's end: what was said before has been taken by then.
            async with asyncio.timeout(20.0) if hasattr(asyncio, "timeout") else contextlib.nullcontext():
                async for message in socket:
                    if message.type is aiohttp.WSMsgType.TEXT and '"type":"sync"' in message.data:
                        break
        return REFUSED if self._display.seat.refused > refused else ACCEPTED

    async def _request(self, garbage: Garbage) -> str:
        path = garbage.choice(("", "operator", "static/", "socket", "static/../", "?token=", "static/%2e%2e/"))
        text = "".join(letter for letter in garbage.text() if letter.isprintable())
        headers = {"Origin": text.encode("ascii", "ignore").decode()} if garbage.maybe(0.3) else {}
        method: Callable[..., Any] = garbage.choice((self._web._session.get, self._web._session.post))
        async with method(self._display.address + path + text, headers=headers) as response:
            await response.read()
            if response.status >= 500:
                raise AssertionError(f"{response.status} for {path + text!r}")
            return ACCEPTED if response.status < 400 else REFUSED

    def finish(self) -> None:
        try:
            self._web.__exit__()
        finally:
            super().finish()
