"""A process that does not outlive the one that started it, however that one ends."""

from __future__ import annotations

import ctypes
import os
import signal

__all__ = ["end_with_parent"]

_libc = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


def end_with_parent(number: signal.Signals, parent: int) -> None:
    """In a child: have the kernel send it this signal when its parent ends without a word. See prctl(2).

    `parent` is the parent's process number, taken by the parent: it may have ended before this was asked for.
    """
    _libc.prctl(_PR_SET_PDEATHSIG, int(number))
    if os.getppid() != parent:
        os.kill(os.getpid(), number)
