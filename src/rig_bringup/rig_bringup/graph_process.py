"""The graph as a child of this process: started in a session of its own, stopped by a signal, never left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType

from rig_runtime.children import end_with_parent

#: [s] How long the graph may take to end before it is killed.
_PATIENCE = 10.0


class GraphProcess:
    """A running graph. Use as a context manager: leaving it stops the graph, whatever happened inside."""

    def __init__(self, command: Sequence[str], log: Path, environment: Mapping[str, str]) -> None:
        self._out = log.open("wb")
        # A session of its own: Ctrl-C in the terminal reaches only us, and we end the graph in the right order.
        self._process = subprocess.Popen(
            list(command),
            stdin=subprocess.DEVNULL,
            stdout=self._out,
            stderr=subprocess.STDOUT,
            env={**os.environ, **environment},
            start_new_session=True,
            preexec_fn=partial(_end_with_parent, os.getpid()),  # noqa: PLW1509 it takes no lock
        )
        self.log = log
        #: Whether it had to be killed, because it did not end when it was asked to.
        self.killed = False

    def __enter__(self) -> GraphProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def send_all(self, number: signal.Signals) -> None:
        """Send a signal to what was started and to all that it has started in the same process group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    def stop(self) -> int:
        """End the graph and wait for it; return its exit code. Interrupting this does not interrupt the ending."""
        was = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            if self._process.poll() is None:
                # As Ctrl-C does it: `ros2 run` passes no signal on to the node behind it.
                self.send_all(signal.SIGINT)
                try:
                    self._process.wait(_PATIENCE)
                except subprocess.TimeoutExpired:
                    self._kill_session()
            self._out.close()
            return self._process.wait()
        finally:
            for number, handler in was.items():
                signal.signal(number, handler)

    def left(self) -> list[int]:
        """Processes of the graph that there are."""
        # The nodes lead process groups of their own, but all of them are in the session that was started here.
        pids = (int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit())
        return [pid for pid in pids if _session_of(pid) == self._process.pid]

    def _kill_session(self) -> None:
        self.killed = True
        for pid in self.left():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def last_words(self, count: int = 12) -> str:
        """The end of what the graph printed."""
        lines = self.log.read_text(errors="replace").splitlines()
        return "\n".join(f"    {line}" for line in lines[-count:])


def _end_with_parent(parent: int) -> None:
    """In the child, before it becomes the graph: have it interrupted if the parent dies without a word."""
    # A shell that starts us in the background has us ignore interrupts, which the graph would inherit for good.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    end_with_parent(signal.SIGINT, parent)


def _session_of(pid: int) -> int:
    try:
        return os.getsid(pid)
    except (ProcessLookupError, PermissionError):
        return -1
