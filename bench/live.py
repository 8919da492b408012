"""Nodes of this process on the rig's executor, with a context and a domain of their own."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.task import Future
from rows import BenchError

from rig_runtime.realtime import Realtime, Settings
from rig_runtime.run import make_executor

#: Another one for each graph, beyond those of the tests.
_domains = itertools.cycle(range(95, 102))

#: [s] How long anything may take before the row is given up.
LIMIT = 120.0

STEADY = ClockType.STEADY_TIME


class Live:
    """Use as a context manager. `paced`: by wall time, so that the real-time settings of the environment apply."""

    def __init__(self, *, paced: bool = False) -> None:
        self._scheduled = os.sched_getaffinity(0), os.sched_getscheduler(0), os.sched_getparam(0)
        self.realtime = Realtime(Settings.from_environment(alone=True) if paced else Settings())
        self.realtime.before_middleware()
        self.domain = next(_domains)
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=self.domain)
        self._executor = make_executor(self._context)
        self._nodes: list[Node] = []

    def __enter__(self) -> Live:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        rclpy.shutdown(context=self._context)
        processors, *policy = self._scheduled
        os.sched_setaffinity(0, processors)
        os.sched_setscheduler(0, *policy)

    def node(self, name: str, namespace: str = "") -> Node:
        """A bare node."""
        return self._add(rclpy.create_node(name, namespace=namespace, context=self._context))

    def make(self, factory: Callable[..., Any], files: Sequence[Path] = (), *parameters: str) -> Any:
        """A node of the rig, with parameters from files or as `name:=value`."""
        arguments = ["--ros-args", "-r", "__ns:=/rig"]
        for file in files:
            arguments += ["--params-file", str(file)]
        for parameter in parameters:
            arguments += ["-p", parameter]
        made = factory(context=self._context, cli_args=arguments, use_global_arguments=False)
        made.prepare()
        return self._add(made)

    def _add(self, node: Any) -> Any:
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def settle(self, ready: Callable[[], bool]) -> None:
        """Serve until all is matched, and have the process ready for ticks."""
        self.until(ready)
        self.realtime.before_ticks()

    def until(self, condition: Callable[[], bool], period: float = 0.01) -> None:
        """Serve until the condition holds, which is looked at now and then.

        Raises
        ------
        BenchError: it does not, for too long.
        """
        done = self.future()

        def look() -> None:
            if condition() and not done.done():
                done.set_result(None)

        timer = self._nodes[0].create_timer(period, look, clock=Clock(clock_type=STEADY))
        self.serve(done)
        self._nodes[0].destroy_timer(timer)

    def future(self) -> Future[None]:
        """What :meth:`serve` waits for."""
        return Future(executor=self._executor)

    def serve(self, done: Future[None]) -> None:
        """Serve until it is done; BenchError if that takes too long."""
        self._executor.spin_until_future_complete(done, timeout_sec=LIMIT)
        if not done.done():
            raise BenchError(f"the nodes did not come to an end within {LIMIT:.0f} s")


def in_own_domain() -> dict[str, str]:
    """The environment of processes that are not to meet those of anybody else."""
    return {**os.environ, "ROS_DOMAIN_ID": str(next(_domains))}
