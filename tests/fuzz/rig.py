"""Every node of the rig and a session's conductor, alive on one executor, for the boundaries of live nodes."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from node_graph import Graph
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import deserialize_message

from admittance_sim_node.node import AdmittanceSimNode
from mig_filter_node.node import MigFilterNode
from rig_bag.recorder import RecorderNode
from rig_display.node import DisplayNode
from rig_runtime import topics
from rig_study.conductor import ConductorNode
from rig_study.session import Session
from rig_study.studies import Choice, Studies
from task_sim_node.node import TaskSimNode
from user_sim_node.node import UserSimNode

__all__ = ["PROTOCOLS", "SUBJECTS", "Rig"]

#: Largest force that the filter believes [N]; no command may be larger.
_MAX_FORCE = 50.0


#: Names that a conductor can be told to go on with.
PROTOCOLS, SUBJECTS = ("short", "other"), ("S01", "S02")

_PROTOCOL = """
study: {scenario: SCENARIO, duration: 0.2, seed: 3}
groups: {all: {subjects: 2, modes: ["off", training]}}
sets: {first: {trials: 500}, second: {trials: 500}}
"""


class Rig:
    """Every node of the rig, alive, on one executor, and a conductor who waits before each trial for a person."""

    def __init__(self, folder: Path) -> None:
        sections: dict[str, dict[str, Any]] = {
            "/**": {"duration": 3600.0, "pacing": "realtime"},
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
        #: Commands that are not the filter's; kept, since nobody says when the last of them has come.
        self.false_commands: set[bytes] = set()
        self._clients: dict[str, Any] = {}
        (folder / "noise.yaml").write_text("/**/user_sim: {ros__parameters: {user: noise}}\n")
        files = [folder / f"{name}.yaml" for name in PROTOCOLS]
        for path in files:
            path.write_text(_PROTOCOL.replace("SCENARIO", str(folder / "noise.yaml")))
        self._studies = Studies(files, lambda name: folder / "sessions" / name)
        self._lead(self._studies.choose(PROTOCOLS[0], SUBJECTS[0]))
        askers = [f"{node.get_name()}/get_parameters" for node in (*self.nodes, self.conductor)]
        self._askers = [self.client(GetParameters, name) for name in askers]
        # Each node collects garbage before a trial, and need not go through every library for it.
        gc.collect()
        gc.freeze()

    def _lead(self, choice: Choice) -> None:
        self._session = Session(choice.protocol, choice.subject, choice.folder)
        self.conductor = ConductorNode(
            self._session,
            wait_for_person=True,
            studies=self._studies,
            namespace="rig",
            context=self.graph.context,
        )
        self.graph.add(self.conductor)

    def follow_choice(self) -> None:
        """Put another conductor in the place of one that was told to make room for another session."""
        choice = self.conductor.choice
        if choice is None:
            return
        self.graph.remove(self.conductor)
        self._session.close()
        self._lead(choice)
        # Asked until it answers: that a service is there may still be said of the one that is gone.
        end, done = time.monotonic() + 30.0, False
        while not done:
            if time.monotonic() > end:
                raise AssertionError("the next conductor does not answer")
            future = self._askers[-1].call_async(GetParameters.Request(names=["seed"]))
            self.serve(0.2, future.done)
            done = future.done()

    def client(self, kind: Any, name: str) -> Any:
        """A client of a service that is there."""
        if name not in self._clients:
            self._clients[name] = self.graph.node.create_client(kind, name)
            self.graph.until(self._clients[name].service_is_ready)
        return self._clients[name]

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """The answer of a service."""
        future = self.client(kind, name).call_async(request)
        self.serve(30.0, future.done)
        if not future.done():
            raise AssertionError(f"{name} does not answer")
        return future.result()

    def serve(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Serve every node for so long, or until this is so."""
        end = time.monotonic() + seconds
        while not until() and time.monotonic() < end:
            # The same time-out always: with another one rclpy begins its round anew, and who comes last is left out.
            self.graph.executor.spin_once(timeout_sec=0.01)

    def silence(self, node: Any, seconds: float) -> None:
        """Serve all but this one for so long: to the others it stands still, as under SIGSTOP."""
        self.graph.executor.remove_node(node)
        self.serve(seconds)
        self.graph.executor.add_node(node)

    def answer(self) -> None:
        """Wait until every node has answered a question, and with it all that came before."""
        futures = [asker.call_async(GetParameters.Request(names=["seed"])) for asker in self._askers]
        self.serve(30.0, lambda: all(future.done() for future in futures))
        silent = [asker.srv_name for asker, future in zip(self._askers, futures, strict=True) if not future.done()]
        if silent:
            raise AssertionError(f"no answer from {', '.join(silent)}")

    def check(self) -> None:
        """No command may hold what the filter does not believe."""
        for command in self._commands:
            if command in self.false_commands:
                continue
            force = deserialize_message(command, topics.COMMAND.type).wrench.force
            if not all(math.isfinite(part) and abs(part) <= _MAX_FORCE for part in (force.x, force.y, force.z)):
                raise AssertionError(f"an impossible force was admitted: {force}")
        self._commands.clear()

    def close(self) -> None:
        """Stop and destroy every node."""
        gc.unfreeze()
        self.graph.close()
        self._session.close()
