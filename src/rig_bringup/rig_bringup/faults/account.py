"""The account of each tick: what the good hand pushed, what the filter decided, what was admitted."""

from __future__ import annotations

from typing import Any, NamedTuple

from shared_control.decision import INPUT_FAULTS, Mode, Reason, Verdict

#: How many of the newest ticks are kept when a row begins: what is still on its way was pushed before.
_KEPT = 400


class Pushed(NamedTuple):
    """A good force [N] and when it was pushed [s, steady clock]."""

    force: float
    at: float


class Decided(NamedTuple):
    """What the filter has told of a tick."""

    mode: Mode
    verdict: Verdict
    reason: Reason
    force: float  # [N] admitted
    threshold: float


class Account:
    """All of it by the tick's stamp [ns], which no two trials share."""

    def __init__(self) -> None:
        self.pushed: dict[int, Pushed] = {}
        self.decided: dict[int, Decided] = {}
        #: Every force that a command held or the robot moved under [N], with its stamp, none left out but zero.
        self.admitted: list[tuple[int, float]] = []

    def begin(self) -> None:
        """Look at what comes from now on."""
        self.admitted.clear()
        self.decided.clear()
        for stamp in sorted(self.pushed)[:-_KEPT]:
            del self.pushed[stamp]

    def decide(self, stamp: int, decision: Any) -> None:
        """Enter a decision, as the message tells it."""
        self.decided[stamp] = Decided(
            Mode(decision.mode),
            Verdict(decision.verdict),
            Reason(decision.reason),
            decision.admitted_force.x,
            decision.threshold,
        )

    def admit(self, stamp: int, force: float) -> None:
        """Enter a force that a command held or the robot moved under."""
        if force != 0.0:
            self.admitted.append((stamp, force))

    def is_right(self, stamp: int, force: float) -> bool:
        """Whether a force may be admitted for a tick.

        None always may. Any other only where the good hand has pushed in this very tick: what it pushed, if the filter
        has accepted it, or what the filter says that the controller puts in its place.
        """
        if force == 0.0:
            return True
        if stamp not in self.pushed:
            return False
        decided, pushed = self.decided.get(stamp), self.pushed[stamp].force
        if decided is None:
            return force == pushed
        if decided.reason in INPUT_FAULTS or decided.verdict is Verdict.REJECTED:
            return False
        return force == decided.force and (force == pushed) is (decided.verdict is Verdict.ACCEPTED)

    def wrong(self) -> list[tuple[int, float]]:
        """Forces that must not have been admitted, with their stamps."""
        return [(stamp, force) for stamp, force in self.admitted if not self.is_right(stamp, force)]

    def reasons(self) -> dict[int, Reason]:
        """Of the ticks that were decided without a good force."""
        return {stamp: decided.reason for stamp, decided in self.decided.items() if stamp not in self.pushed}
