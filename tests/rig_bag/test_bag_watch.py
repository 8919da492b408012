"""The recorder's wall clock: what counts as a jump of the machine's, with clocks of the test's own."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rig_bag.watch import SteadyWallClock

_SECOND = 1_000_000_000


@given(trims=st.lists(st.integers(-40_000_000, 40_000_000), min_size=1, max_size=50), step=st.integers(100, 10**6))
def test_a_clock_that_is_trimmed_has_not_jumped_and_one_that_is_set_has_once(trims: list[int], step: int) -> None:
    now, ahead = 0, 1_795_000_000 * _SECOND
    clock = SteadyWallClock(lambda: now + ahead, lambda: now)
    begun = clock.offset
    for trim in trims:
        now, ahead = now + _SECOND, ahead + trim
        assert clock.jump() == 0
    for sign in (1, -1):
        ahead += sign * step * 1_000_000
        assert clock.jump() == sign * step * 1_000_000
        assert clock.jump() == 0
    assert clock.offset == begun
