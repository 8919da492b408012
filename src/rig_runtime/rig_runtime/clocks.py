"""The wall clock beside the steady one."""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["wall_ahead_of_steady"]

#: [ns] Between two looks at the steady clock; more has passed only if this thread was interrupted meanwhile.
_INTERRUPTED = 500_000


def wall_ahead_of_steady(wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = time.monotonic_ns) -> int:
    """Wall time minus steady time [ns], as of one moment: looked at again if something came between the two.

    ``wall``, ``steady``: [ns]; for tests.
    """
    while True:
        begin, now, end = steady(), wall(), steady()
        if end - begin < _INTERRUPTED:
            return now - begin
