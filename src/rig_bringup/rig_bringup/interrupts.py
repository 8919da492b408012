"""Interrupts that wait for a safe moment: raised where a loop asks, not wherever the process happens to be."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any

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
