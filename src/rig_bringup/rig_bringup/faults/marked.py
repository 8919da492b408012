"""A command with all that it starts, found by a mark in the environment: what is left when it was killed."""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

_MARK = "RIG_FAULTS_MARK"


class Marked:
    """A running command. Context manager: what is left of it in the end is killed."""

    def __init__(self, command: Sequence[str], log: Path) -> None:
        self._mark = f"{_MARK}={secrets.token_hex(8)}".encode()
        name, _, value = self._mark.decode().partition("=")
        self._log = log
        with log.open("ab") as out:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                env={**os.environ, name: value},
                start_new_session=True,
            )

    def __enter__(self) -> Marked:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for pid in self._there():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._process.wait()

    @property
    def code(self) -> int | None:
        """Its code; None while it runs."""
        return self._process.poll()

    def signal(self, number: signal.Signals) -> None:
        """To the command itself, and not to what it has started."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(number)

    def wait_for(self, condition: Callable[[], bool], limit: float) -> bool:
        """Until the condition holds or the command has ended; whether it holds, after at most `limit` seconds."""
        end = time.monotonic() + limit
        while not condition():
            if time.monotonic() > end or self._process.poll() is not None:
                return condition()
            time.sleep(0.01)
        return True

    def end(self, limit: float) -> int | None:
        """Wait for its end; its code, None if it has not ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._process.wait(limit)
        return None

    def left(self, limit: float) -> list[int]:
        """What there still is after `limit` seconds, or as soon as there is nothing."""
        end = time.monotonic() + limit
        while (there := self._there()) and time.monotonic() < end:
            time.sleep(0.02)
        return there

    def words(self) -> str:
        """The end of what it printed."""
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-12:])

    def _there(self) -> list[int]:
        found = []
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            with contextlib.suppress(OSError):
                # A process that has ended and was not waited for has no environment.
                if self._mark in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
        return found
