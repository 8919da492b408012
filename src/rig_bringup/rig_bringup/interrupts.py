"""Interrupts that wait for a safe moment: raised where a loop asks, not wherever the process happens to be."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType, TracebackType
from typing import Any

__all__ = ["Interrupts", "held_back", "let_in"]

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Context manager of the main thread: inside it SIGINT and SIGTERM are noted, and `check` raises them.

    An exception that a signal raises while the middleware converts a message can come out as another error.
    """

    def __init__(self) -> None:
        self._seen = False
        self._was: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        self._was = {number: signal.signal(number, self._note) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._was.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self._seen:
            raise KeyboardInterrupt

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._seen = True


@contextmanager
def held_back() -> Iterator[None]:
    """In a process that is started inside, SIGINT and SIGTERM wait until it calls `let_in`.

    Until then it has no handler of its own, and only imports what sets one. Here they wait too, unless there are other
    threads, which take them.
    """
    # It lets them in when it is started, and it is started for the first process.
    resource_tracker.ensure_running()
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        let_in()


def let_in() -> None:
    """Take SIGINT and SIGTERM that were held back, and those to come."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
