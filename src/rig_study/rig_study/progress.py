"""How far long work is: a bar on standard error, done and in all, and the time that the rest will take."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

__all__ = ["bar", "clear", "progress"]


def bar(title: str, done: int, total: int, left: float) -> None:
    """Draw it over the last one on a terminal; into a file a line for each twentieth. ``left`` in seconds."""
    terminal = sys.stderr.isatty()
    if not terminal and done != total and done % max(1, total // 20):
        return
    start, filled, seconds = "\r" if terminal else "", 30 * done // max(1, total), round(left)
    print(
        f"{start}{title} [{'#' * filled}{'.' * (30 - filled)}] {done:,}/{total:,}, "
        f"{seconds // 60}:{seconds % 60:02d} left ",
        end="" if terminal and done != total else "\n", file=sys.stderr, flush=True,
    )  # fmt: skip


def clear() -> None:
    """Take the bar away, before a line that stays is printed."""
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def progress(title: str) -> Callable[[int, int, int], None]:
    """A bar for :func:`rig_study.runs.run`: the rest at the rate so far."""
    begin = time.monotonic()

    def show(done: int, total: int, there: int) -> None:
        rate = (time.monotonic() - begin) / max(1, done - there)
        bar(title, done, total, rate * (total - done))

    return show
