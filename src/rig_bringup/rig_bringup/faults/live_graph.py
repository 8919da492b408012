"""A live graph whose nodes can be killed, stopped and restarted one by one, with the hand in this process."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions

from mig_interfaces.msg import TrialState
from rig_bag import BagError
from rig_bag.repair import repair
from rig_bringup.faults.hand import Hand
from rig_bringup.graph_process import GraphProcess
from rig_bringup.scenario import parameter_file
from rig_bringup.up import scheduling
from rig_runtime.run import make_executor, wait_until

#: Package and executable of each node that is started here; the user is the hand.
NODES = {
    "task_sim": ("task_sim_node", "task_sim_node"),
    "mig_filter": ("mig_filter_node", "mig_filter_node"),
    "admittance_sim": ("admittance_sim_node", "admittance_sim_node"),
    "recorder": ("rig_bag", "recorder"),
}

#: [s] How long anything may take that is not measured: starting a node, going on after a fault.
_PATIENCE = 120.0


class FaultError(Exception):
    """What must follow a fault did not; the message says what was seen."""


class Stalls(threading.Thread):
    """How late a sleep of a millisecond is: what this machine adds to any time that is measured on it meanwhile."""

    def __init__(self) -> None:
        super().__init__(name="stalls", daemon=True)
        self._over = threading.Event()
        #: [s] The latest since it was last set to zero.
        self.worst = 0.0

    def run(self) -> None:
        while not self._over.is_set():
            begin = time.monotonic()
            time.sleep(1e-3)
            self.worst = max(self.worst, time.monotonic() - begin - 1e-3)

    def end(self) -> None:
        self._over.set()
        self.join()


class LiveGraph:
    """The graph of one trial that lasts as long as it is needed. Context manager."""

    def __init__(self, folder: Path, namespace: str = "faults") -> None:
        self.folder = folder
        self.bag = folder / "bag"
        self._namespace = namespace
        self._parameters = folder / "parameters.yaml"
        self._parameters.write_text(parameter_file(self._sections()))
        self.processes: dict[str, GraphProcess] = {}
        self._stalls = Stalls()
        #: [s] The machine's stall during each wait for zero force.
        self.stalls: list[float] = []
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        arguments = ["--ros-args", "-r", f"__ns:=/{namespace}"]
        self.hand = Hand(context=self._context, cli_args=arguments, use_global_arguments=False)
        self.executor = make_executor(self._context)
        self.executor.add_node(self.hand)

    def _sections(self) -> dict[str, dict[str, Any]]:
        # The filter is off: what it lets pass is then what it believes, not what it likes.
        return {
            "/**": {"pacing": "realtime", "duration": 3600.0},
            "/**/mig_filter": {"mode": "off"},
            "/**/task_sim": {"required_nodes": ["user_sim", "mig_filter", "admittance_sim", "recorder"]},
            "/**/recorder": {"uri": str(self.bag)},
        }

    def __enter__(self) -> LiveGraph:
        self._stalls.start()
        for node in reversed(NODES):
            self.start(node)
        self.wait(lambda: self.hand.flowing, "the loop has not closed")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self.processes.values():
            process.stop()
        self._stalls.end()
        self.executor.shutdown()
        self.hand.destroy_node()
        self._context.try_shutdown()

    # -- the nodes -----------------------------------------------------------------------------------------------

    def start(self, node: str) -> None:
        """Start a node, or start it again."""
        self.processes[node] = self._process(node, self._namespace)

    def start_elsewhere(self, node: str) -> GraphProcess:
        """Start another one in another namespace; it is the caller's to stop."""
        return self._process(node, "elsewhere")

    def _process(self, node: str, namespace: str) -> GraphProcess:
        arguments = ["--ros-args", "-r", f"__ns:=/{namespace}", "--params-file", str(self._parameters)]
        command = ["ros2", "run", *NODES[node], *arguments]
        return GraphProcess(command, self.folder / f"{namespace}_{node}.log", scheduling("realtime"))

    def kill(self, node: str) -> float:
        """Kill a node as nothing can prevent; when that was [s, steady clock]."""
        at = time.monotonic()
        self.processes[node].send_all(signal.SIGKILL)
        return at

    def stop(self, node: str) -> float:
        """Stop a node in the middle of whatever it does (SIGSTOP); when that was [s, steady clock]."""
        at = time.monotonic()
        self.processes[node].send_all(signal.SIGSTOP)
        return at

    def resume(self, node: str) -> None:
        """Let a stopped node go on (SIGCONT)."""
        self.processes[node].send_all(signal.SIGCONT)

    # -- waiting -------------------------------------------------------------------------------------------------

    def wait(self, condition: Callable[[], bool], otherwise: str, limit: float = _PATIENCE) -> None:
        """Serve the hand until the condition holds.

        Raises
        ------
        FaultError: it does not within the limit [s].
        """
        if not wait_until(condition, self.executor, limit):
            raise FaultError(f"{otherwise} within {limit:g} s; the trial: {self.hand.trial.message or 'no message'}")

    def ticks(self, count: int) -> None:
        """Serve the hand for so many more ticks."""
        begin = len(self.hand.states)
        self.wait(lambda: len(self.hand.states) >= begin + count, f"{count} more ticks have not come")

    def zero_after(self, since: float) -> float:
        """How long after a loss the robot first moved under no force [s]; to be called at once after it."""
        self._stalls.worst = 0.0
        self.wait(lambda: self.hand.first_zero(since) is not None, "the force has not become zero", limit=10.0)
        found = self.hand.first_zero(since)
        assert found is not None
        self.stalls.append(self._stalls.worst)
        return found - since

    def recover(self) -> None:
        """A good hand again, until the robot follows it."""
        self.hand.answer = self.hand.push
        self.wait(
            lambda: self.hand.flowing and self.hand.trial.phase == TrialState.PHASE_RUNNING,
            "the loop has not recovered",
        )

    def repair(self) -> str:
        """Make a whole bag of the one that was cut, and say how much it holds.

        Raises
        ------
        FaultError: it cannot be made, or holds nothing.
        """
        self.processes["recorder"].stop()
        try:
            repaired = repair(self.bag)
        except BagError as error:
            raise FaultError(f"the bag cannot be repaired: {error}") from error
        count = sum(repaired.messages.values())
        if not count:
            raise FaultError("the repaired bag holds nothing")
        return f"{count} messages in the repaired bag"
