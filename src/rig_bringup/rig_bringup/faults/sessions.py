"""Faults of who leads a session: its conductor is killed or stopped."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

from rig_bringup.faults.live_graph import FaultError
from rig_bringup.faults.marked import Marked
from rig_bringup.faults.rows import Seen, expect_whole_bag, row
from rig_study.session import LOG, events

_PROTOCOL = """
study: {scenario: SCENARIO, duration: 2.0, seed: 3}
groups: {all: {subjects: 1, modes: [training, assistance]}}
sets: {first: {trials: 1}, second: {trials: 1}}
"""

#: [s] For the graph to end after its conductor, and for a session of two short trials.
_ENDS, _SESSION = 15.0, 120.0


class Session:
    """A session of two short trials in real time, as its command."""

    def __init__(self, folder: Path, name: str) -> None:
        folder = folder / name
        folder.mkdir()
        (folder / "noise.yaml").write_text("/**/user_sim: {ros__parameters: {user: noise}}\n")
        protocol = folder / "short.yaml"
        protocol.write_text(_PROTOCOL.replace("SCENARIO", str(folder / "noise.yaml")))
        self.log = folder / "sessions" / "S01" / LOG
        self._output = folder / "output.log"
        self.command = [sys.executable, "-m", "rig_bringup", "study", "run", str(protocol), "--subject", "S01"]
        self.command += ["--pacing", "realtime", "--namespace", name, "--out", str(folder / "sessions")]

    def start(self) -> Marked:
        return Marked(self.command, self._output)

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
    session = Session(folder, "conductor_killed")
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
    session = Session(folder, "conductor_stopped")
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
