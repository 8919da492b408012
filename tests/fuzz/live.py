"""Boundaries of live nodes: the messages of every topic, services and parameters, the pages' sockets."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiohttp
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from fuzz.boundary import ACCEPTED, REFUSED, Boundary, UnclearError
from fuzz.files import _CONFIGURATIONS, page_message
from fuzz.garbage import Garbage
from loop_messages import SAMPLE, state, wrench
from node_graph import Graph
from page_client import Web
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import Trigger

from admittance_sim_node.node import AdmittanceSimNode
from mig_filter_node.node import MigFilterNode
from mig_interfaces.msg import EndEffectorState, FilterDecision, NodeReport, TrialState
from mig_interfaces.srv import AbortTrial, StartTrial
from rig_bag.recorder import RecorderNode
from rig_display.node import DisplayNode
from rig_runtime import topics
from rig_runtime.ticks import LOCKSTEP_EPOCH, to_stamp
from shared_control.parameters import declarations
from task_sim_node.node import TaskSimNode
from user_sim_node.node import UserSimNode

#: Largest force that the filter believes [N]; no command may be larger.
_MAX_FORCE = 50.0


class Rig:
    """Every node of the rig, alive, on one executor."""

    def __init__(self, folder: Path) -> None:
        sections: dict[str, dict[str, Any]] = {
            "/**": {"duration": 3600.0},
            "/**/mig_filter": {"mode": "off", "max_force": _MAX_FORCE},
            "/**/task_sim": {"autostart": False, "required_nodes": [""]},
            "/**/display": {"port": 0, "countdown": 0.0, "message_rate": 10000.0, "max_clients": 1000},
            "/**/recorder": {"uri": str(folder / "bags"), "split": "trial"},
        }
        file = folder / "rig.yaml"
        file.write_text(yaml.safe_dump({name: {"ros__parameters": values} for name, values in sections.items()}))
        self.graph = Graph("single")
        factories = (TaskSimNode, MigFilterNode, AdmittanceSimNode, UserSimNode, DisplayNode, RecorderNode)
        self.nodes: list[Any] = [self.graph.make(factory, params_file=file) for factory in factories]
        self._commands: list[bytes] = []
        command = topics.COMMAND
        self.graph.node.create_subscription(command.type, command.name, self._commands.append, command.qos, raw=True)
        #: Commands that are not the filter's.
        self.false_commands: set[bytes] = set()
        self._askers = [
            self.graph.node.create_client(GetParameters, f"{node.get_name()}/get_parameters") for node in self.nodes
        ]
        self.graph.until(lambda: all(asker.service_is_ready() for asker in self._askers))

    def answer(self) -> None:
        """Wait until every node has answered a question, and with it all that came before."""
        futures = [asker.call_async(GetParameters.Request(names=["seed"])) for asker in self._askers]
        end = time.monotonic() + 30.0
        while not all(future.done() for future in futures):
            if time.monotonic() > end:
                raise AssertionError("a node does not answer")
            self.graph.executor.spin_once(timeout_sec=1.0)

    def check(self) -> None:
        """No command may hold what the filter does not believe."""
        for command in self._commands:
            if command in self.false_commands:
                continue
            force = deserialize_message(command, topics.COMMAND.type).wrench.force
            if not all(math.isfinite(part) and abs(part) <= _MAX_FORCE for part in (force.x, force.y, force.z)):
                raise AssertionError(f"an impossible force was admitted: {force}")
        self._commands.clear()
        self.false_commands.clear()

    def close(self) -> None:
        """Stop and destroy every node."""
        self.graph.close()


class _OfRig(Boundary):
    """A boundary of the live rig."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.rig = Rig(folder)

    def finish(self) -> None:
        try:
            self.rig.check()
            self._run_a_trial()
        finally:
            self.rig.close()

    def _run_a_trial(self) -> None:
        """After everything a trial can be run: each tick is moved, pushed and judged."""
        graph, rig = self.rig.graph, self.rig
        graph.call(Trigger, topics.RESET_SERVICE, Trigger.Request())
        for name in (topics.CLEAR_FILTER_SERVICE, topics.CLEAR_ROBOT_SERVICE):
            graph.call(Trigger, name, Trigger.Request())
        decisions = graph.collect(topics.DECISION)
        graph.until(lambda: graph.node.count_publishers(topics.DECISION.name) > 0)
        answer = graph.call(StartTrial, topics.START_SERVICE, StartTrial.Request(duration=0.2))
        assert answer.success, answer.message
        task = rig.nodes[0]
        graph.until(lambda: task.trial.phase == TrialState.PHASE_FINISHED and len(decisions) >= 20, limit=50.0)


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
    elif kind is FilterDecision:
        message.user_control = message.nominal_control = message.applied_control = [1.0]
    return message


class Messages(_OfRig):
    """Messages of any content on every topic that a node hears, and bytes that are none."""

    name = "messages to live nodes"
    share = 1.2
    topics = (
        topics.TASK_STATE, topics.WRENCH, topics.COMMAND, topics.END_EFFECTOR, topics.DECISION, topics.TRIAL_STATE,
        topics.NODE_REPORT, topics.RECORDER_STATE, topics.SESSION_STATE,
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
        message = garbage.message(_near(kind), garbage.choice((0.05, 0.2, 0.8)))
        before = _refusals(self.rig.nodes)
        data = bytes(serialize_message(message))
        if garbage.maybe(0.4):
            data = garbage.bent_bytes(data)
        if publisher.topic_name == f"/rig/{topics.COMMAND.name}":
            self.rig.false_commands.add(data)
        publisher.publish(data)
        self.rig.answer()
        self.rig.check()
        return REFUSED if _refusals(self.rig.nodes) != before else ACCEPTED


def _refusals(nodes: list[Any]) -> list[Any]:
    """What the nodes count of what they did not take."""
    return [
        (node.refused, *(node.diagnose()[2].get(key) for key in ("late", "duplicates", "dropped", "late motions")))
        for node in nodes
    ]


class Services(_OfRig):
    """Calls of every service with any content, parameters included."""

    name = "services of live nodes"
    share = 0.6

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
        return request, self.rig.graph.call(kind, name, request)

    def _question(self, garbage: Garbage) -> tuple[Any, str, Any]:
        kind = garbage.randrange(8)
        if kind == 0:
            return StartTrial, topics.START_SERVICE, garbage.message(StartTrial.Request(duration=1.0), 0.5)
        if kind == 1:
            return AbortTrial, topics.ABORT_SERVICE, garbage.message(AbortTrial.Request(), 0.9)
        if kind == 2:
            names = (topics.RESET_SERVICE, topics.CLEAR_FILTER_SERVICE, topics.CLEAR_ROBOT_SERVICE)
            return Trigger, garbage.choice(names), Trigger.Request()
        node = garbage.choice(self.rig.nodes)
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
    share = 0.8

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
