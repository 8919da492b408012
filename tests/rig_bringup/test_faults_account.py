"""The account of the fault runner: which force may be admitted for a tick, and which is raw input that went through."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from rig_bringup.faults.account import Account, Pushed
from rig_bringup.faults.hand import good_force
from shared_control.decision import INPUT_FAULTS, Mode, Reason, Verdict

TICK, OTHER = 10_000_000, 20_000_000


def account(verdict: Verdict | None = None, reason: Reason = Reason.CRITERION, force: float = 0.0) -> Account:
    """Of one tick in which 5 N were pushed, perhaps decided."""
    result = Account()
    result.pushed[TICK] = Pushed(5.0, 0.0)
    if verdict is not None:
        admitted = SimpleNamespace(x=force)
        mode = Mode.ASSISTANCE
        result.decide(
            TICK, SimpleNamespace(mode=mode, verdict=verdict, reason=reason, admitted_force=admitted, threshold=0.0)
        )
    return result


@pytest.mark.parametrize(
    ("seen", "stamp", "force", "right"),
    [
        (account(), TICK, 0.0, True),
        (account(), TICK, 5.0, True),
        (account(), TICK, -5.0, False),  # the size is right, and it is another tick's
        (account(), OTHER, 5.0, False),  # nobody has pushed
        (account(), OTHER, 0.0, True),
        (account(), TICK, math.nan, False),
        (account(Verdict.ACCEPTED, force=5.0), TICK, 5.0, True),
        (account(Verdict.ACCEPTED, force=4.0), TICK, 4.0, False),  # not what was pushed
        (account(Verdict.ACCEPTED, force=5.0), TICK, 4.0, False),
        (account(Verdict.REPLACED, force=3.0), TICK, 3.0, True),
        (account(Verdict.REPLACED, force=3.0), TICK, 5.0, False),
        (account(Verdict.REPLACED, force=5.0), TICK, 5.0, False),  # it says that it has replaced it, and has not
        (account(Verdict.REJECTED, force=0.0), TICK, 0.0, True),
        (account(Verdict.REJECTED, force=5.0), TICK, 5.0, False),
        *((account(Verdict.ACCEPTED, fault, 5.0), TICK, 5.0, False) for fault in INPUT_FAULTS),
        *((account(Verdict.REPLACED, fault, 3.0), TICK, 3.0, False) for fault in INPUT_FAULTS),
    ],
)
def test_a_force_is_right_only_in_the_tick_in_which_it_was_pushed_and_as_it_was_decided(
    seen: Account, stamp: int, force: float, right: bool
) -> None:
    assert seen.is_right(stamp, force) is right
    seen.admit(stamp, force)
    assert bool(seen.wrong()) is not right


def test_the_reasons_are_those_of_ticks_in_which_nobody_has_pushed_and_a_new_row_begins_without_them() -> None:
    seen = account(Verdict.ACCEPTED, force=5.0)
    lost = SimpleNamespace(x=0.0)
    decision = SimpleNamespace(mode=0, verdict=1, reason=Reason.STALE_WRENCH, admitted_force=lost, threshold=0.0)
    seen.decide(OTHER, decision)
    seen.admit(OTHER, 7.0)
    assert seen.reasons() == {OTHER: Reason.STALE_WRENCH}
    seen.begin()
    assert not seen.reasons()
    assert not seen.wrong()
    assert TICK in seen.pushed, "what is still on its way was pushed before"


def test_no_two_ticks_near_each_other_have_the_same_force() -> None:
    forces = [good_force(tick) for tick in range(2048)]
    assert len(set(forces)) == 2048
    assert all(forces[k] + forces[k + 1] == 0.0 for k in range(0, 2048, 2)), "the cart stays where it is"
