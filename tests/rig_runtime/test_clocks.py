"""The wall clock beside the steady one, looked at by a thread that may be interrupted."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from rig_runtime.clocks import wall_ahead_of_steady

AHEAD = 1_700_000_000_000_000_000
PAUSE = 5_000_000


class Clocks:
    """Two that go on by 50 ns with each look, and stand still for 5 ms before those looks that are interrupted."""

    def __init__(self, *interrupted: int) -> None:
        self.now = 0
        self._pauses: Iterator[int] = iter([PAUSE * (look in interrupted) for look in range(12)])

    def steady(self) -> int:
        self.now += 50 + next(self._pauses)
        return self.now

    def wall(self) -> int:
        return self.steady() + AHEAD


@pytest.mark.parametrize("interrupted", [(), (0,), (1,), (2,), (1, 2), (1, 5), (2, 4, 8)])
def test_an_interruption_between_two_looks_does_not_come_in(interrupted: tuple[int, ...]) -> None:
    clocks = Clocks(*interrupted)
    assert abs(wall_ahead_of_steady(clocks.wall, clocks.steady) - AHEAD) < 1000


def test_it_is_that_of_this_machine() -> None:
    low = time.time_ns() - time.monotonic_ns()
    found = wall_ahead_of_steady()
    begin = time.monotonic_ns()
    assert low - 1_000_000 < found < time.time_ns() - begin + 1_000_000
