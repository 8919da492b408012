"""Faults of those who push: the user, and the display with a person at its page."""

from __future__ import annotations

import math
import socket
import time
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from mig_interfaces.msg import TrialState
from rig_bringup.faults.account import Pushed
from rig_bringup.faults.hand import PUSH, good_force
from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.nodes import MOST_STARTS, recorder_killed
from rig_bringup.faults.page import Page
from rig_bringup.faults.rows import LIMIT, Inject, Seen, expect_reason, row
from rig_display.hand import STALLED
from rig_runtime.run import wait_until
from shared_control.filter import Reason

_SAMPLE = 10_000_000  # [ns]

# -- the user ------------------------------------------------------------------------------------------------------


class UserGraph(LiveGraph):
    """A graph whose user is a node of its own, with a recording of what the good hand pushes."""

    kind = "user"
    nodes: ClassVar = {**LiveGraph.nodes, "pusher": ("user_sim_node", "user_sim_node")}

    def sections(self) -> dict[str, dict[str, Any]]:
        recording = self.folder / "force.npy"
        force = np.zeros((360_000, 3))
        force[:, 0] = [good_force(tick) for tick in range(len(force))]
        np.save(recording, force)
        pusher = {"user": "replay", "recording": str(recording)}
        required = {"required_nodes": ["pusher", "mig_filter", "admittance_sim", "recorder"]}
        return {**super().sections(), "/**/pusher": pusher, "/**/task_sim": required}

    def begin(self) -> None:
        self.good = self.hand.answer = self.knows

    def knows(self, stamp: int, tick: int) -> None:
        """The user pushes what is in its recording."""
        self.hand.account.pushed[stamp] = Pushed(good_force(tick), time.monotonic())


def _user(restart: bool) -> Inject:
    def inject(graph: UserGraph, repeats: int) -> Seen:
        zero = []
        for _ in range(min(repeats, MOST_STARTS) if restart else repeats):
            since = graph.kill("pusher") if restart else graph.stop("pusher")
            try:
                # It may have answered the tick before this one sees it, and may do so when it is back.
                graph.ticks(1)
                graph.hand.answer = graph.hand.watch
                zero.append(graph.zero_after(since))
                graph.ticks(5)
                expect_reason(graph, Reason.STALE_WRENCH)
                graph.hand.answer = graph.knows
                graph.ticks(1)
                graph.stays_zero(since + zero[-1])
            finally:
                graph.start("pusher") if restart else graph.resume("pusher")
            graph.hand.motions.clear()
            graph.recover()
        return Seen(zero)

    return inject


row("user/stopped", "the user is stopped (SIGSTOP)", "no force, stale wrench; goes on by itself", LIMIT, UserGraph)(
    _user(restart=False)
)
row("user/killed", "the user is killed (-9) and started again", "the same", LIMIT, UserGraph)(_user(restart=True))


def free_port() -> int:
    """One that nobody listens at."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


# -- a person at the page ------------------------------------------------------------------------------------------


class PersonGraph(LiveGraph):
    """A graph with the display and a page that pushes; a fault stays until somebody clears it."""

    kind = "person"
    nodes: ClassVar = {**LiveGraph.nodes, "display": ("rig_display", "display")}

    def __init__(self, folder: Path, namespace: str = "faults") -> None:
        self._port = free_port()
        self.page: Page | None = None
        super().__init__(folder, namespace)

    def sections(self) -> dict[str, dict[str, Any]]:
        plain = super().sections()
        required = ["display", "mig_filter", "admittance_sim", "recorder"]
        return {
            **plain,
            "/**": {**plain["/**"], "recovery": "explicit"},
            "/**/display": {"port": self._port, "countdown": 0.0},
            "/**/task_sim": {"required_nodes": required, "autostart": False},
        }

    def begin(self) -> None:
        self.good = self.hand.answer = self.hand.watch
        self.hand.overhear(lambda force: abs(force) == PUSH)
        self.page = Page(self._port)
        self.start_trial()
        # A machine that stands still in the first ticks has something kept from the beginning.
        self.release()

    def start_trial(self) -> None:
        """Take control and press Start, as a person does."""
        page = self.page
        assert page is not None
        self.wait(lambda: page.driving, "the page does not drive")
        for _ in range(30):
            page.start_trial()
            # Pressed too early, before everybody is there, it is answered with why not.
            if wait_until(lambda: self.hand.trial.phase == TrialState.PHASE_RUNNING, self.executor, 1.0):
                return
        raise FaultError(f"the trial has not begun; the page was told: {page.told or 'nothing'}")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.page is not None:
            self.page.end()
        super().__exit__(kind, error, trace)

    def kept(self, since: float, node: str, why: str) -> float:
        """The page pushes again, and no force follows: the fault is kept, and said where people look.

        Returns how long after a loss [s] the last force had been followed by none.

        Raises
        ------
        FaultError: a force was admitted, or neither `/diagnostics` nor the page says of this node why there is none.
        """
        page, hand = self.page, self.hand
        assert page is not None

        def in_diagnostics() -> bool:
            return hand.diagnostics.get(node, (b"",))[0] == DiagnosticStatus.ERROR and why in hand.said[node]

        self.wait(in_diagnostics, f"/diagnostics does not say of {node}: {why}", limit=30.0)
        self.wait(
            lambda: any(node in fault and why in fault for fault in page.status.get("faults", [])),
            f"the page does not say of {node}: {why}",
            limit=30.0,
        )
        self.wait(lambda: page.driving and time.monotonic() - page.last_push < 0.1, "the page does not push again")
        self.wait(lambda: time.monotonic() - hand.last_good < 0.1, "what the page pushes is not heard here")
        self.ticks(5)
        # A robot that was lost and is not back yet moves under nothing.
        zero = max(hand.first_still - since, 0.0) if hand.motions else 0.0
        hand.motions.clear()
        self.ticks(30)
        if forces := {heard.force for heard in hand.motions} - {0.0}:
            raise FaultError(f"{sorted(forces)} N were admitted before anybody had cleared the fault")
        return zero

    def recover(self) -> None:
        """A person's hand again, until the robot follows it; what the machine has lost by itself is released."""
        self.hand.answer = self.good
        self.hand.motions.clear()
        if not wait_until(lambda: self.hand.flowing, self.executor, 2.0):
            self.release()

    def flows(self, otherwise: str) -> None:
        """The robot follows the page again without anybody's having to release anything.

        Raises
        ------
        FaultError: it does not.
        """
        page = self.page
        assert page is not None
        self.hand.motions.clear()
        if not wait_until(lambda: self.hand.flowing, self.executor, 20.0):
            raise FaultError(f"{otherwise} within 20 s; the page says {page.status.get('faults')}")

    def release(self) -> None:
        """Press Release, which clears what is kept, until the robot follows."""
        page = self.page
        assert page is not None
        for _ in range(30):
            page.say("release")
            self.hand.motions.clear()
            if wait_until(lambda: self.hand.flowing, self.executor, 1.0):
                return
        raise FaultError(f"no force after Release was pressed; the page says {page.status.get('faults')}")


def _person(node: str, says: str, why: str, *, restart: bool) -> Inject:
    """A node of a graph with a person is stopped or killed, comes back, and nothing is admitted until Release."""

    def inject(graph: PersonGraph, repeats: int) -> Seen:
        zero = []
        for _ in range(min(repeats, MOST_STARTS)):
            graph.ready()
            graph.hand.states.clear()
            since = graph.kill(node) if restart else graph.stop(node)
            try:
                if node == "admittance_sim":
                    # What it does not move, nobody sees moving: the task's own state says that there is no force.
                    zero.append(graph.coasting_after(since))
                else:
                    graph.still()
            finally:
                graph.start(node) if restart else graph.resume(node)
            after = graph.kept(since, says, why)
            zero += [] if node == "admittance_sim" else [after]
            graph.release()
        return Seen(zero, f"{says}: {why}")

    return inject


_UNTIL = "no force until Release, the reason in /diagnostics and on the page"

#: Who is lost, who says so, and what, stopped and killed; a task that was killed begins no trial by itself.
_LOST = (
    ("display", "display", "mig_filter", "stale wrench", "stale wrench"),
    ("filter", "mig_filter", "admittance_sim", "no command came in time", "no command came in time"),
    ("robot", "admittance_sim", "admittance_sim", "it stood still itself", "it was started in the middle of a trial"),
    ("task", "task_sim", "admittance_sim", "no command came in time", ""),
)
for _name, _node, _says, _stopped, _killed in _LOST:
    row(f"person/{_name} stopped", f"with a person: the {_name} is stopped (SIGSTOP)", _UNTIL, LIMIT, PersonGraph)(
        _person(_node, _says, _stopped, restart=False)
    )
    if _killed:
        row(f"person/{_name} killed", f"with a person: the {_name} is killed (-9)", _UNTIL, LIMIT, PersonGraph)(
            _person(_node, _says, _killed, restart=True)
        )


@row(
    "person/task killed",
    "with a person: the task is killed (-9), restarted",
    "no trial until Start",
    LIMIT,
    PersonGraph,
)
def _person_task(graph: PersonGraph, repeats: int) -> Seen:
    zero = []
    for _ in range(min(repeats, MOST_STARTS)):
        since = graph.kill("task_sim")
        graph.still()
        zero.append(max(graph.hand.first_still - since, 0.0))
        graph.start("task_sim")
        graph.wait(lambda: graph.hand.trial.phase == TrialState.PHASE_IDLE, "the task has not come back")
        graph.start_trial()
        graph.flows("the robot does not follow in the new trial")
    return Seen(zero)


@row("person/wrench nan", "with a person: one wrench is NaN", _UNTIL, 0.03, PersonGraph)
def _person_bad_wrench(graph: PersonGraph, repeats: int) -> Seen:
    hand, zero = graph.hand, []
    said: dict[int, float] = {}

    def disturb(stamp: int, tick: int) -> None:
        """For the next tick, so as to come before the display, until one does."""
        said[stamp + _SAMPLE] = time.monotonic()
        hand.say(stamp + _SAMPLE, math.nan)

    for _ in range(repeats):
        graph.ready()
        hand.answer = disturb
        graph.still()
        hand.answer = hand.watch
        since = said.get(hand.zeroed.stamp)
        if since is None:
            raise FaultError("the force has become zero in a tick for which no wrench of NaN was said")
        zero.append(graph.kept(since, "mig_filter", "non finite wrench"))
        graph.release()
    return Seen(zero, "mig_filter: non finite wrench")


row(
    "person/recorder killed",
    "with a person: the recorder is killed (-9) at a random moment, restarted",
    "the loop goes on, no fault is kept; its bag is repaired",
    on=PersonGraph,
)(recorder_killed(seed=10, follows=lambda graph: graph.flows("the robot does not follow")))


@row(
    "person/page silent",
    "with a person: the page says nothing more",
    "zero after stale_after (0.1 s)",
    0.13,
    PersonGraph,
)
def _page_silent(graph: PersonGraph, repeats: int) -> Seen:
    page, zero = graph.page, []
    assert page is not None
    for _ in range(repeats):
        page.pushing = False
        graph.still()
        zero.append(graph.hand.first_still - page.last_push)
        graph.wait(lambda: page.status["hand"]["reason"] == STALLED, "the page is not told")
        page.pushing = True
        graph.flows("the page's hand does not count again")
    return Seen(zero)


@row("person/page closed", "with a person: the page is closed", "no force; follows who drives next", LIMIT, PersonGraph)
def _page_closed(graph: PersonGraph, repeats: int) -> Seen:
    page, zero = graph.page, []
    assert page is not None
    for _ in range(repeats):
        page.open = False
        graph.still()
        zero.append(graph.hand.first_still - page.last_push)
        page.open = True
        graph.flows("the page's hand does not count again")
    return Seen(zero)
