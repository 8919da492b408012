"""Faults of those who push and lead: the user, the display with a person at its page, the conductor of a session."""

from __future__ import annotations

import signal
import socket
import sys
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
from rig_bringup.faults.marked import Marked
from rig_bringup.faults.nodes import MOST_STARTS
from rig_bringup.faults.page import Page
from rig_bringup.faults.rows import LIMIT, Inject, Seen, expect_reason, expect_whole_bag, row
from rig_display.hand import STALLED
from rig_runtime.run import wait_until
from rig_study.session import LOG, events
from shared_control.filter import Reason

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


# -- a person at the page ------------------------------------------------------------------------------------------


class PersonGraph(LiveGraph):
    """A graph with the display and a page that pushes; a fault stays until somebody clears it."""

    kind = "person"
    nodes: ClassVar = {**LiveGraph.nodes, "display": ("rig_display", "display")}

    def __init__(self, folder: Path, namespace: str = "faults") -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
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

    def kept(self, since: float, *said: str) -> float:
        """The page pushes again, and no force follows: the fault is kept, and said where people look.

        Returns how long after a loss [s] the last force had been followed by none.

        Raises
        ------
        FaultError: a force was admitted, or it is not said.
        """
        page, hand = self.page, self.hand
        assert page is not None
        self.wait(
            lambda: any(hand.diagnostics.get(node, (b"",))[0] == DiagnosticStatus.ERROR for node in said),
            "/diagnostics does not say that there is no force",
        )
        self.wait(lambda: bool(page.status.get("faults")), "the page does not say that there is no force")
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


def _person(node: str, *, restart: bool) -> Inject:
    """A node of a graph with a person is stopped or killed, comes back, and nothing is admitted until Release."""

    def inject(graph: PersonGraph, repeats: int) -> Seen:
        zero = []
        for _ in range(min(repeats, MOST_STARTS)):
            since = graph.kill(node) if restart else graph.stop(node)
            try:
                if node == "admittance_sim":
                    # What it does not move, nobody sees moving: the task's own state says that there is no force.
                    graph.hand.states.clear()
                    graph.wait(
                        lambda: any(state.held and not any(state.control) for state in graph.hand.states),
                        "the task has not gone over to zero force",
                        limit=10.0,
                    )
                else:
                    graph.still()
            finally:
                graph.start(node) if restart else graph.resume(node)
            after = graph.kept(since, "mig_filter", "admittance_sim")
            zero += [] if node == "admittance_sim" else [after]
            graph.release()
        return Seen(zero)

    return inject


_UNTIL = "no force until Release, the reason in /diagnostics and on the page"
for _node, _name in (("display", "display"), ("mig_filter", "filter"), ("admittance_sim", "robot")):
    _within = None if _name == "robot" else LIMIT
    row(f"person/{_name} stopped", f"with a person: the {_name} is stopped (SIGSTOP)", _UNTIL, _within, PersonGraph)(
        _person(_node, restart=False)
    )
    row(f"person/{_name} killed", f"with a person: the {_name} is killed (-9)", _UNTIL, _within, PersonGraph)(
        _person(_node, restart=True)
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
        graph.hand.motions.clear()
        graph.wait(lambda: graph.hand.flowing, "the new trial does not flow")
    return Seen(zero)


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
        graph.hand.motions.clear()
        graph.wait(lambda: graph.hand.flowing, "the page's hand does not count again")
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
        graph.hand.motions.clear()
        graph.wait(lambda: graph.hand.flowing, "the page's hand does not count again")
    return Seen(zero)


# -- the conductor -------------------------------------------------------------------------------------------------

_PROTOCOL = """
study: {scenario: SCENARIO, duration: 2.0, seed: 3}
groups: {all: {subjects: 1, modes: [training, assistance]}}
sets: {first: {trials: 1}, second: {trials: 1}}
"""

#: [s] For the graph to end after its conductor, and for a session of two short trials.
_ENDS, _SESSION = 15.0, 120.0


class _Session:
    """A session of two short trials in real time, as its command."""

    def __init__(self, folder: Path, name: str) -> None:
        folder = folder / name
        folder.mkdir()
        (folder / "noise.yaml").write_text("/**/user_sim: {ros__parameters: {user: noise}}\n")
        protocol = folder / "short.yaml"
        protocol.write_text(_PROTOCOL.replace("SCENARIO", str(folder / "noise.yaml")))
        self.log = folder / "sessions" / "S01" / LOG
        self._output = folder / "output.log"
        self._command = [sys.executable, "-m", "rig_bringup", "study", "run", str(protocol), "--subject", "S01"]
        self._command += ["--pacing", "realtime", "--namespace", name, "--out", str(folder / "sessions")]

    def start(self) -> Marked:
        return Marked(self._command, self._output)

    def begun(self) -> int:
        """How many trials were begun."""
        return sum(event["event"] == "started" for event in events(self.log)) if self.log.exists() else 0

    def check(self) -> int:
        """Both trials ran to their end, in bags that are whole; returns how many messages they hold."""
        ended = [event for event in events(self.log) if event["event"] == "finished"]
        if [event["position"] for event in ended] != [1, 2]:
            raise FaultError(f"the session's log has these trials ended: {[event['trial'] for event in ended]}")
        return sum(expect_whole_bag(Path(event["bag"])) for event in ended)


@row(
    "conductor/killed",
    "a session's conductor is killed (-9) in a trial, and started again",
    "its graph ends by itself; the same command goes on with that trial; each in a whole bag",
    on=None,
)
def _conductor_killed(folder: Path, _: int) -> Seen:
    session = _Session(folder, "conductor_killed")
    with session.start() as conductor:
        if not conductor.wait_for(lambda: session.begun() == 1, _SESSION):
            raise FaultError(f"the session has not begun:\n{conductor.words()}")
        conductor.wait_for(lambda: False, 1.0)
        killed = time.monotonic()
        conductor.signal(signal.SIGKILL)
        if left := conductor.left(_ENDS):
            raise FaultError(f"{_ENDS:.0f} s after its conductor was killed the graph is still there: {left}")
        after = time.monotonic() - killed
    before = session.log.read_bytes()
    with session.start() as conductor:
        if conductor.end(_SESSION) != 0:
            raise FaultError(f"the session does not go on:\n{conductor.words()}")
    if not session.log.read_bytes().startswith(before) or session.begun() != 3:
        raise FaultError("the session's log does not go on where it was")
    return Seen([], f"the graph had ended {after:.1f} s later; {session.check()} messages in two whole bags")


@row(
    "conductor/stopped",
    "a session's conductor is stopped (SIGSTOP) for three seconds in a trial",
    "the trial runs to its end without it; the next begins when it is back",
    on=None,
)
def _conductor_stopped(folder: Path, _: int) -> Seen:
    session = _Session(folder, "conductor_stopped")
    with session.start() as conductor:
        if not conductor.wait_for(lambda: session.begun() == 1, _SESSION):
            raise FaultError(f"the session has not begun:\n{conductor.words()}")
        conductor.signal(signal.SIGSTOP)
        try:
            conductor.wait_for(lambda: False, 3.0)
        finally:
            conductor.signal(signal.SIGCONT)
        if conductor.end(_SESSION) != 0:
            raise FaultError(f"the session does not go on:\n{conductor.words()}")
    if session.begun() != 2:
        raise FaultError("a trial was begun more than once")
    return Seen([], f"{session.check()} messages in two whole bags")
