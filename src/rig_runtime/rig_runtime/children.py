"""A process that does not outlive the one that started it, however that one ends."""

from __future__ import annotations

import ctypes
import signal

__all__ = ["end_with_parent"]

_libc = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


def end_with_parent(number: signal.Signals) -> None:
    """In a child: have the kernel send it this signal when its parent ends without a word. See prctl(2)."""
    _libc.prctl(_PR_SET_PDEATHSIG, int(number))
