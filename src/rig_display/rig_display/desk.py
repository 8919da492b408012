"""What an operator does to the graph: its trial services and the filter's parameters, asked without waiting."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.task import Future
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from mig_interfaces.srv import AbortTrial, ChooseSession, StartTrial
from rig_runtime import topics
from rig_runtime.node import RigNode

__all__ = ["FILTER", "GraphDesk"]

FILTER = "mig_filter"
_ROBOT = "admittance_sim"

#: [s] How long a service is waited for, and how often it is looked for meanwhile.
_PATIENCE, _RETRY = 5.0, 0.05

Done = Callable[[bool, str], None]


class GraphDesk:
    """Calls services of the graph. May be used from any thread: the node's executor does the work."""

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self._starter = node.create_client(StartTrial, topics.START_SERVICE)
        self._aborter = node.create_client(AbortTrial, topics.ABORT_SERVICE)
        self._clearers = {
            who: node.create_client(Trigger, name)
            for who, name in ((FILTER, topics.CLEAR_FILTER_SERVICE), (_ROBOT, topics.CLEAR_ROBOT_SERVICE))
        }
        self._conductor = {
            what: node.create_client(Trigger, name)
            for what, name in (
                ("pause", topics.PAUSE_SERVICE),
                ("resume", topics.RESUME_SERVICE),
                ("repeat", topics.REPEAT_SERVICE),
            )
        }
        self._chooser = node.create_client(ChooseSession, topics.CHOOSE_SERVICE)
        self._setter = node.create_client(SetParameters, f"{FILTER}/set_parameters")
        self._getter = node.create_client(GetParameters, f"{FILTER}/get_parameters")

    def start(self, fields: dict[str, Any], done: Done) -> None:
        """`trial/start`."""
        self._ask(self._starter, StartTrial.Request(**fields), done, lambda answer: (answer.success, answer.message))

    def abort(self, reason: str, done: Done) -> None:
        """`trial/abort`."""
        request = AbortTrial.Request(reason=reason)
        self._ask(self._aborter, request, done, lambda answer: (answer.success, answer.message))

    def clear_faults(self, nodes: Iterable[str], done: Done) -> None:
        """`clear_fault` of these nodes, now or not at all: what comes later nobody has seen, and it must stay."""
        for client in (self._clearers[node] for node in nodes if node in self._clearers):
            self._ask(client, Trigger.Request(), done, lambda answer: (answer.success, answer.message), patience=0.0)

    def lead(self, what: str, done: Done) -> None:
        """`pause`, `resume` or `repeat` of the session's conductor."""
        self._ask(self._conductor[what], Trigger.Request(), done, lambda answer: (answer.success, answer.message))

    def choose(self, protocol: str, subject: str, done: Done) -> None:
        """`choose` of the conductor: whose session is led next."""
        request = ChooseSession.Request(protocol=protocol, subject=subject)
        self._ask(self._chooser, request, done, lambda answer: (answer.success, answer.message))

    def set_mode(self, mode: str, done: Done) -> None:
        """The filter's parameter `mode`."""
        request = SetParameters.Request(parameters=[Parameter("mode", value=mode).to_parameter_msg()])

        def read(answer: SetParameters.Response) -> tuple[bool, str]:
            result = answer.results[0]
            return result.successful, result.reason or f"the filter's mode is {mode}"

        self._ask(self._setter, request, done, read)

    def read_filter(self, found: Callable[[str, tuple[float, ...]], None]) -> None:
        """Ask the filter for its mode and target, and hand them to `found`; nothing happens if it is not there."""
        if not self._getter.service_is_ready():
            return

        def read(future: Future[GetParameters.Response]) -> None:
            answer = future.result()
            if answer is not None and len(answer.values) == 2:
                mode, target = map(parameter_value_to_python, answer.values)
                found(mode, tuple(target or ()))

        self._getter.call_async(GetParameters.Request(names=["mode", "target"])).add_done_callback(read)

    def _ask(
        self,
        client: Client[Any, Any],
        request: Any,
        done: Done,
        read: Callable[[Any], tuple[bool, str]],
        patience: float = _PATIENCE,
    ) -> None:
        limit = time.monotonic() + patience

        def ask(timer: Timer | None = None) -> None:
            ready = client.service_is_ready()
            if not ready and time.monotonic() < limit:
                # Somebody was quicker than the nodes are in finding each other.
                if timer is None:
                    timer = node.create_timer(_RETRY, lambda: ask(timer), clock=node.steady)
                return
            if timer is not None:
                node.destroy_timer(timer)
            if ready:
                client.call_async(request).add_done_callback(lambda future: done(*read(future.result())))
            else:
                done(False, f"nobody serves {client.srv_name}; is the graph complete?")

        def hand_over() -> None:
            # The pages are there a moment before the node is served.
            if node.executor is not None:
                node.executor.create_task(ask)
            elif time.monotonic() < limit:
                threading.Timer(_RETRY, hand_over).start()
            else:
                done(False, "the display is not being served")

        node = self._node
        hand_over()
