"""When a node's stage of a tick begins and how long it takes: the clock, and the last ticks for diagnostics.

    delay = (wall time at which the stage begins) - t_k,     compute time = (wall time at which it ends) - (begin)

t_k is when tick k was due: the stamp of its messages, by the system's clock, which every node of the graph shares. A
step of that clock shows in the delays; compute times and ages are taken by the steady clock.
"""

from __future__ import annotations

import time
from collections import deque

__all__ = ["StageTimes", "delay_of"]

#: [ticks] What diagnostics tell of: the last second at 100 Hz.
KEPT = 100


def delay_of(stamp: int) -> float:
    """Wall time since a stamp [ns] was due [s]."""
    return 1e-9 * (time.time_ns() - stamp)


class StageTimes:
    """Delay and compute time of a node's last ticks."""

    def __init__(self) -> None:
        self._delays: deque[float] = deque(maxlen=KEPT)
        self._works: deque[float] = deque(maxlen=KEPT)

    def reset(self) -> None:
        """A new trial begins."""
        self._delays.clear()
        self._works.clear()

    def add(self, delay: float, compute_time: float) -> None:
        """One tick [s]."""
        self._delays.append(delay)
        self._works.append(compute_time)

    def values(self) -> dict[str, object]:
        """For `/diagnostics`; empty where no wall time was taken, as in lockstep."""
        if not self._delays:
            return {}
        return {"begins after due [ms]": _spread(self._delays), "takes [ms]": _spread(self._works)}


def _spread(seconds: deque[float]) -> str:
    ordered = sorted(seconds)
    last = len(ordered) - 1
    middle, high, higher, most = (1e3 * ordered[round(share * last)] for share in (0.5, 0.9, 0.99, 1.0))
    return f"p50 {middle:.3f}, p90 {high:.3f}, p99 {higher:.3f}, most {most:.3f}, of {len(ordered)} ticks"
