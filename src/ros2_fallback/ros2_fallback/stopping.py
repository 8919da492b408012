"""SIGINT and SIGTERM end a command between two steps, never inside one.

An exception raised by a signal handler can surface anywhere: in a half imported module, in a destructor, in a callback
that the middleware called. So the handler only takes a note, :func:`check` raises it where it is safe, and whatever
waits does so in slices of at most :data:`SLICE`.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["SLICE", "Stopped", "check", "deferred", "immediate", "pause"]

#: [s] longest uninterruptible wait of a command
SLICE = 0.1

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _State:
    """What has been asked of this process; signals have no other place than one for all of it."""

    noted: int | None = None
    at_once = False


_state = _State()


class Stopped(BaseException):
    """The person or the system asked the command to end; `signum` says how."""

    def __init__(self, signum: int) -> None:
        super().__init__(f"stopped by signal {signum}")
        self.signum = signum


def _note(signum: int, _frame: FrameType | None) -> None:
    # Asked twice: whatever hangs shall not keep the person waiting.
    again = _state.noted is not None
    _state.noted = signum
    if again or _state.at_once:
        raise Stopped(signum)


def check() -> None:
    """Raise Stopped if a signal has come."""
    if _state.noted is not None:
        raise Stopped(_state.noted)


def pause(seconds: float) -> None:
    """Wait, at most :data:`SLICE`; raise Stopped if a signal has come."""
    time.sleep(min(seconds, SLICE))
    check()


@contextmanager
def deferred() -> Iterator[None]:
    """Take notes of SIGINT and SIGTERM inside the block (in the main thread; elsewhere nothing happens)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _state.noted = None
    before = {number: signal.signal(number, _note) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _state.noted = None


@contextmanager
def immediate() -> Iterator[None]:
    """Let signals raise Stopped at once inside the block, for reads that block and that an exception cannot harm."""
    check()
    _state.at_once = True
    try:
        yield
    finally:
        _state.at_once = False
