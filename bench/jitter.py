"""How late a timer of the rig's executor fires, beside a bare C loop of clock_nanosleep."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from live import STEADY, Live
from native import program
from rclpy.clock import Clock
from rows import Row, alternate, percentile

from rig_runtime.realtime import ALLOWED, PRIORITY, Settings

#: [s] Longer than any run of the suite.
_LONGEST = 3600.0


def timer(period: float, count: int) -> list[float]:
    """Lateness of a timer at each point of its grid [s], of a node that does nothing else.

    rcl leaves out what it has missed: a point that was left out is as late as the firing after it.
    """
    late: list[float] = []
    step = round(1e9 * period)
    with Live(paced=True) as live:
        node = live.node("jitter")
        live.settle(lambda: True)
        done = live.future()
        last = 0

        def fire() -> None:
            nonlocal last
            now = time.monotonic_ns()
            due = now + beat.time_until_next_call() - step
            late.extend(1e-9 * (now - at) for at in range(last + step if last else due, due + 1, step))
            last = due
            if len(late) >= count and not done.done():
                done.set_result(None)

        beat = node.create_timer(period, fire, clock=Clock(clock_type=STEADY))
        live.serve(done)
    return late[:count]


@dataclass
class Wakes:
    """The wake-ups of a C loop: wake-up k (from 1) was due at begin + k period."""

    period: float  # [s]
    begin: float = math.nan  # [s] of the steady clock
    late: list[float] = field(default_factory=list)  # [s]
    #: Of SCHED_FIFO; 0 in ordinary scheduling.
    priority: int = 0

    def take(self, said: str) -> None:
        """From what the C loop has printed."""
        priority, begin, *late = map(int, said.split())
        self.priority, self.begin, self.late = priority, 1e-9 * begin, [1e-9 * each for each in late]

    def held_up(self, begin: float, end: float) -> float:
        """How much of the time from `begin` to `end` [s of the steady clock] passed while a wake-up was overdue [s]."""
        total, until = 0.0, begin
        # A stall of any length that reaches into this time is that of a wake-up that was due before its end.
        first = max(round((begin - self.begin - max(self.late, default=0.0)) / self.period) - 2, 0)
        for k in range(first, min(int((end - self.begin) / self.period), len(self.late))):
            due = self.begin + (k + 1) * self.period
            over = min(due + self.late[k], end)
            total += max(over - max(due, until), 0.0)
            until = max(until, over)
        return total


def nanosleep(wake: Path, period: float, count: int) -> list[float]:
    """Lateness of each wake of the C loop [s], scheduled as a paced node is."""
    command = [str(wake), str(round(1e9 * period)), str(count), *_priority(PRIORITY)]
    wakes = Wakes(period)
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    _say_refused(result.stderr)
    wakes.take(result.stdout)
    return wakes.late


@contextlib.contextmanager
def nanosleep_beside(wake: Path, period: float, processor: int | None = None) -> Iterator[Wakes]:
    """The same for as long as the block takes, on one processor or any; known after it.

    What the machine alone does to a loop is seen at the same moments thereby. Where a graph's nodes are scheduled in
    real time the C loop comes before them: what holds it up is none of their work. Where that is refused (`priority`
    says so then) the nodes may hold it up.
    """
    wakes = Wakes(period)
    command = [str(wake), str(round(1e9 * period)), str(round(_LONGEST / period)), *_priority(ALLOWED)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            if processor is not None:
                os.sched_setaffinity(process.pid, {processor})
            yield wakes
        finally:
            process.terminate()
            said, refused = process.communicate()
            _say_refused(refused)
            wakes.take(said)


def _priority(priority: int) -> list[str]:
    return [] if Settings.from_environment().mode == "off" else [str(priority)]


@functools.cache
def _say_refused(said: str) -> None:
    # Once, however many runs there are.
    for line in said.splitlines():
        print(f"C loop: {line}; ./rig doctor says how to allow rtprio {ALLOWED}", file=sys.stderr)


def rows(runs: int) -> list[Row]:
    """Median and 99th percentile at 100 Hz and at 1 kHz."""
    found = []
    with program("wake") as wake:
        for title, period, count in (("100Hz", 0.01, 300), ("1kHz", 0.001, 2000)):
            ours, bare = alternate(
                runs,
                lambda period=period, count=count: timer(period, count),
                lambda period=period, count=count: nanosleep(wake, period, count),
            )
            for name, share in (("p50", 0.5), ("p99", 0.99)):
                found.append(
                    Row(
                        f"timer.{title}.{name}",
                        f"lateness of a timer at {title}, {name}",
                        "us",
                        tuple(1e6 * percentile(late, share) for late in ours),
                        "clock_nanosleep in C",
                        tuple(1e6 * percentile(late, share) for late in bare),
                    )
                )
    return found
