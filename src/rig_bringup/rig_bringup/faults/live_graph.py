"""A live graph whose nodes can be killed, stopped and restarted one by one, with the hand in this process."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, TypeVar

import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions

from mig_interfaces.msg import RecorderState, TrialState
from rig_bag import BagError, read
from rig_bag.repair import repair
from rig_bag.verify import Verification, verify
from rig_bringup.faults.hand import Hand
from rig_bringup.faults.stalls import Stalls
from rig_bringup.graph_process import GraphProcess
from rig_bringup.scenario import parameter_file
from rig_bringup.up import scheduling
from rig_runtime import topics
from rig_runtime.run import make_executor, wait_until

#: [s] How long anything may take that is not measured: starting a node, going on after a fault.
_PATIENCE = 120.0

#: [s] How long a process may take to end before it is asked again.
_ENDING = 10.0

T = TypeVar("T")


class FaultError(Exception):
    """What must follow a fault did not; the message says what was seen."""


class LiveGraph:
    """The graph of one trial that lasts as long as it is needed. Context manager."""

    #: Package and executable of each node that is started here, the recorder last; the user is the hand.
    nodes: Mapping[str, tuple[str, str]] = {
        "task_sim": ("task_sim_node", "task_sim_node"),
        "mig_filter": ("mig_filter_node", "mig_filter_node"),
        "admittance_sim": ("admittance_sim_node", "admittance_sim_node"),
        "recorder": ("rig_bag", "recorder"),
    }

    #: What it is called in the table.
    kind = "plain"

    def __init__(self, folder: Path, namespace: str = "faults") -> None:
        self.folder = folder
        #: Of each recorder that was started, in order.
        self.bags: list[Path] = []
        self.namespace = namespace
        folder.mkdir(exist_ok=True)
        self.parameters = folder / "parameters.yaml"
        self.parameters.write_text(parameter_file(self.sections()))
        self.processes: dict[str, GraphProcess] = {}
        #: What the filter does with a good force.
        self.mode = "off"
        self._clients: dict[str, AsyncParameterClient] = {}
        self._stalls = Stalls()
        #: [s] The machine's stall during each wait for zero force.
        self.stalls: list[float] = []
        self._context = rclpy.Context()
        with patched_environment(self.environment()):
            rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
            arguments = ["--ros-args", "-r", f"__ns:=/{namespace}"]
            self.hand = Hand(context=self._context, cli_args=arguments, use_global_arguments=False)
        #: Topics on which the hand has spoken out of turn since the bag began: their stamps may go back in it.
        self.out_of_turn = {topics.WRENCH.name}
        #: How the hand answers while nothing is wrong.
        self.good = self.hand.push
        self.executor = make_executor(self._context)
        self.executor.add_node(self.hand)

    def sections(self) -> dict[str, dict[str, Any]]:
        """The nodes' parameters, section by section."""
        # The filter is off: what it lets pass is then what it believes, not what it likes.
        return {
            "/**": {"pacing": "realtime", "duration": 3600.0},
            "/**/mig_filter": {"mode": "off"},
            "/**/task_sim": {"required_nodes": ["user_sim", "mig_filter", "admittance_sim", "recorder"]},
        }

    def environment(self) -> dict[str, str]:
        """What every process of the graph is to find in its environment, the hand's included."""
        return {}

    def around(self, node: str) -> list[str]:
        """What stands in front of the command that starts a node."""
        return []

    def __enter__(self) -> LiveGraph:
        self._stalls.start()
        try:
            for node in reversed(self.nodes):
                self.start(node)
            self.begin()
            self.wait(lambda: self.hand.flowing, "the loop has not closed")
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def begin(self) -> None:
        """Do what the trial waits for."""

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

    def start(self, node: str, remap: Mapping[str, str] = MappingProxyType({}), **parameters: object) -> None:
        """Start a node, or start it again, with other names of topics and parameters on top of the file's."""
        if node == "recorder":
            self.bags.append(self.folder / f"bag_{len(self.bags)}")
            self.hand.heard.clear()
            parameters["uri"] = str(self.bags[-1])
        if node == "mig_filter":
            self.mode = str(parameters.get("mode", "off"))
        self.processes[node] = self.start_process(node, node, self.namespace, remap, **parameters)

    def start_process(
        self,
        like: str,
        name: str,
        namespace: str,
        remap: Mapping[str, str] = MappingProxyType({}),
        **parameters: object,
    ) -> GraphProcess:
        """Start a node like one of the graph's under a name of its own; it is the caller's to stop."""
        names = {"__ns": f"/{namespace}", "__node": name, **remap}
        arguments = ["--ros-args", *(word for old, new in names.items() for word in ("-r", f"{old}:={new}"))]
        arguments += ["--params-file", str(self.parameters)]
        if parameters:
            more = self.folder / f"{namespace}_{name}.yaml"
            more.write_text(parameter_file({f"/**/{name}": parameters}))
            arguments += ["--params-file", str(more)]
        command = [*self.around(like), "ros2", "run", *self.nodes[like], *arguments]
        environment = {**scheduling("realtime"), **self.environment()}
        return GraphProcess(command, self.folder / f"{namespace}_{name}.log", environment)

    def kill(self, node: str) -> float:
        """Kill a node as nothing can prevent; when that was [s, steady clock]."""
        at = time.monotonic()
        self.processes[node].send_all(signal.SIGKILL)
        return at

    def replace_filter(self, remap: Mapping[str, str] = MappingProxyType({}), **parameters: object) -> None:
        """Another filter in place of this one; by then the hand has heard the last force of this one."""
        self.kill("mig_filter")
        self.still()
        self.start("mig_filter", remap, **parameters)
        self.hand.motions.clear()

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

    def meanwhile(self, what: Callable[[], T], otherwise: str) -> T:
        """Do what takes long while the hand goes on: a hand that is deaf loses what does not fit into its queues.

        Raises
        ------
        FaultError: it is not done in time.
        """
        with ThreadPoolExecutor(1) as beside:
            done = beside.submit(what)
            self.wait(done.done, otherwise)
        return done.result()

    def end(self, process: GraphProcess) -> int:
        """End what was started while the hand goes on; return its exit code."""
        process.send_all(signal.SIGINT)
        wait_until(lambda: process.exit_code is not None, self.executor, _ENDING)
        return process.stop()

    def ticks(self, count: int) -> None:
        """Serve the hand for so many more ticks."""
        begin = len(self.hand.states)
        self.wait(lambda: len(self.hand.states) >= begin + count, f"{count} more ticks have not come")

    def zero_after(self, since: float) -> float:
        """How long after a loss the robot moved under no force, and under none since [s]; to be called at once."""
        self.still()
        return max(self.hand.first_still - since, 0.0)

    def coasting_after(self, since: float) -> float:
        """How long after a loss the task published a state that it had come to under no force [s]."""
        hand = self.hand
        with self.noting_stalls():
            self.wait(lambda: hand.coasting(since) is not None, "the task has not gone over to zero force", limit=10.0)
        coasting = hand.coasting(since)
        assert coasting is not None
        return coasting - since

    def stays_zero(self, since: float) -> None:
        """Up to now the robot has moved under no force from a time on [s, steady clock].

        Raises
        ------
        FaultError: it has moved under one.
        """
        if forces := [heard.force for heard in self.hand.motions if heard.at >= since and heard.force]:
            raise FaultError(f"{forces[:5]} N were admitted before what was lost was back")

    def still(self) -> None:
        """Serve the hand until the robot has moved under no force for a while."""
        with self.noting_stalls():
            self.wait(lambda: self.hand.still, "the force has not become zero", limit=10.0)

    @contextmanager
    def noting_stalls(self) -> Iterator[None]:
        """Note how long the machine stood still, at most, while this was waited for."""
        self._stalls.worst = 0.0
        try:
            yield
        finally:
            self.stalls.append(self._stalls.worst)

    def judge(self, mode: str, threshold: float = 0.0, **more: object) -> None:
        """Have the filter judge in this mode, with other parameters changed as well, and wait until it does.

        Raises
        ------
        FaultError: it refuses to, or does not.
        """
        if refusals := self.change("mig_filter", mode=mode, threshold=threshold, **more):
            raise FaultError(f"the filter refuses a change that is allowed: {refusals[0]}")
        self.wait(lambda: self.hand.judged(mode, threshold), f"no decision has been in the mode {mode}")
        self.mode = mode

    def change(self, node: str, **parameters: object) -> list[str]:
        """Change parameters of a node; returns why it refused to, for each that it did."""
        if node not in self._clients:
            self._clients[node] = AsyncParameterClient(self.hand, node)
        client = self._clients[node]
        self.wait(client.services_are_ready, f"the parameters of {node} are not served")
        wanted = [Parameter(name, value=value) for name, value in parameters.items()]
        for _ in range(30):
            # Of a node that was killed the service may be known longer than that of the one in its place.
            future = client.set_parameters(wanted)
            if wait_until(future.done, self.executor, 2.0):
                return [result.reason or "refused" for result in future.result().results if not result.successful]
        raise FaultError(f"{node} did not answer a change of its parameters")

    def ready(self) -> None:
        """As a row finds it, whatever the one before has left."""
        if self.mode != "off":
            self.judge("off")
        self.recover()

    def recover(self) -> None:
        """A good hand again, until the robot follows it."""
        self.hand.answer = self.good
        self.wait(
            lambda: self.hand.flowing and self.hand.trial.phase == TrialState.PHASE_RUNNING,
            "the loop has not recovered",
        )

    # -- the bag -------------------------------------------------------------------------------------------------

    def recorded(self, bag: Path | None = None) -> RecorderState:
        """What the recorder of a bag, the present one if left out, has last said of it."""
        return self.hand.recorders.get(str(bag or self.bags[-1]), RecorderState())

    def new_bag(self) -> None:
        """Begin another bag, whatever became of the one before, and wait until there is something in it on the disk."""
        self.end(self.processes["recorder"])
        self.out_of_turn = {topics.WRENCH.name}
        self.start("recorder")

        def size() -> int:
            return sum(path.stat().st_size for path in self.bags[-1].glob("*.mcap"))

        # It speaks of messages when it has found every node; the definitions alone are smaller than that.
        self.wait(lambda: self.recorded().messages > 0 or size() > 60_000, "the recorder has not begun another bag")
        begun = size()
        self.wait(lambda: size() > begun, "the recorder has brought nothing to the disk")
        self.hand.heard.clear()

    def close_bag(self) -> str:
        """End the recorder and check its bag against itself and against what the hand has heard.

        Raises
        ------
        FaultError: the bag is damaged, or lacks a decision that was heard and does not say so.
        """
        self.end(self.processes["recorder"])
        bag, topic = self.bags[-1], f"/{self.namespace}/{topics.DECISION.name}"
        try:
            found = verify(bag)
            recorded = {int(stamp) for stamp in read(bag, [topic])[topic]["stamp"]}
        except BagError as error:
            raise FaultError(f"the bag cannot be read: {error}") from error
        if problems := self.problems(found):
            raise FaultError(f"the bag is not as it should be: {'; '.join(problems)}")
        first, last = min(recorded, default=0), max(recorded, default=0)
        gaps = [(before, after) for before, after, _ in found.ticks[topic]["gaps"]]
        if not found.ticks[topic]["gaps_not_listed"] and (
            lost := [
                stamp
                for stamp in self.hand.heard - recorded
                if first < stamp < last and not any(before < stamp < after for before, after in gaps)
            ]
        ):
            raise FaultError(
                f"{len(lost)} decisions were heard, and the bag neither has them nor says that it lacks them"
            )
        return f"{sum(found.counts.values())} messages, undamaged; {len(recorded)} decisions, every gap told"

    def problems(self, found: Verification) -> list[str]:
        """What is wrong with a bag besides what the table did: ticks that nobody answered, stamps out of order."""
        own = tuple(f"/{self.namespace}/{topic}: the stamp goes back" for topic in self.out_of_turn)
        checks = [check for check in found.checks if check.name != "ticks"]
        return [problem for check in checks for problem in check.problems if not problem.startswith(own)]

    def repair(self) -> str:
        """Make a whole bag of the one that was cut, and say how much it holds.

        Raises
        ------
        FaultError: it cannot be made, holds nothing, or is not as it should be.
        """
        self.end(self.processes["recorder"])
        try:
            repaired = self.meanwhile(lambda: _apart(repair, self.bags[-1]), "the bag is still being repaired")
            whole = repaired.out or self.bags[-1]
            found = self.meanwhile(lambda: _apart(verify, whole), "the bag is still being verified")
        except BagError as error:
            raise FaultError(f"the bag cannot be repaired: {error}") from error
        count = sum(repaired.messages.values())
        if not count:
            raise FaultError("the repaired bag holds nothing")
        if problems := self.problems(found):
            raise FaultError(f"the repaired bag is not as it should be: {'; '.join(problems)}")
        return f"{count} messages in the repaired bag"


def _apart(function: Callable[[Path], T], bag: Path) -> T:
    """Call it in a process of its own: in a thread its work would keep the hand from the interpreter for seconds."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as beside:
        return beside.submit(function, bag).result()


@contextmanager
def patched_environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Other environment variables for what is made inside."""
    was = dict(os.environ)
    os.environ.update(changes)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(was)
