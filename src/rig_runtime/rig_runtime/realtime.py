"""Settings of the process for a steady 100 Hz."""

from __future__ import annotations

import gc


def freeze_garbage() -> None:
    """Collect once and keep the collector from looking at what is loaded.

    A full collection with numba and scipy loaded pauses for several ticks; nothing on the path of a tick makes cycles.
    """
    gc.collect()
    gc.freeze()
    gc.disable()


def collect_garbage() -> None:
    """Collect what the last trial left; for moments when no tick waits."""
    gc.collect()
