"""Why there is no force, in words, with time as numbers."""

from __future__ import annotations

import pytest

from rig_display.losses import REASONS, Losses
from shared_control.filter import Reason, Verdict

SECOND = 10**9


def test_each_reason_has_words_of_its_own() -> None:
    assert set(REASONS) == set(Reason)
    assert len(set(REASONS.values())) == len(Reason)
    assert all(REASONS.values())


def silence(losses: Losses, seconds: float) -> None:
    for _ in range(round(seconds / losses.period)):
        losses.look(running=True)


def test_the_nearest_to_the_cause_is_said() -> None:
    losses, now = Losses(0.05), SECOND
    assert losses.tell(now, running=True) == ("", False)
    losses.hear("admittance_sim", "no command came in time", now)
    assert losses.tell(now, running=True) == ("no force: no command came in time (admittance_sim)", True)
    losses.decided(Verdict.REJECTED, Reason.STALE_WRENCH)
    assert losses.tell(now + SECOND, running=True) == ("no force for 1.0 s: no wrench came in time", True)
    silence(losses, 0.2)
    losses.states.heard()
    assert losses.tell(now + SECOND, running=True)[0].endswith(": no wrench came in time")
    silence(losses, 0.2)
    assert losses.tell(now + SECOND, running=True)[0].endswith(": the filter does not answer")
    silence(losses, 0.2)
    assert losses.tell(now + SECOND, running=True)[0].endswith(": the task does not answer")
    # Where no trial runs nobody has to answer.
    assert losses.tell(now + 2 * SECOND, running=False)[0].startswith("no force for 2.0 s until 0.0 s ago: ")
    losses.look(running=False)
    assert not losses.states.silent
    assert not losses.decisions.silent


@pytest.mark.parametrize("reason", Reason)
@pytest.mark.parametrize("verdict", Verdict)
def test_only_what_is_refused_for_something_else_than_the_criterion_is_lost(verdict: Verdict, reason: Reason) -> None:
    losses = Losses(0.05)
    losses.decided(verdict, reason)
    words, _ = losses.tell(SECOND, running=True)
    lost = verdict is Verdict.REJECTED and reason is not Reason.CRITERION
    assert words == (f"no force: {REASONS[reason]}" if lost else "")


def test_who_says_that_something_is_lost_and_is_never_heard_again_is_not_believed_for_ever() -> None:
    losses = Losses(0.05)
    losses.hear("task_sim", "no motion", SECOND)
    assert losses.tell(3 * SECOND, running=True)[0] == "no force: no motion (task_sim)"
    assert losses.tell(5 * SECOND, running=True)[0] == "no force for 2.0 s until 0.0 s ago: no motion (task_sim)"
    assert losses.tell(7 * SECOND, running=True)[0] == ""


def test_another_trial_has_lost_nothing_yet() -> None:
    losses = Losses(0.05)
    losses.decided(Verdict.REJECTED, Reason.STALE_WRENCH)
    losses.tell(SECOND, running=True)
    losses.reset()
    assert losses.tell(SECOND, running=True)[0] == ""
