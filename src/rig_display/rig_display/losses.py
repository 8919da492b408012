"""Why there is no force, in words for the pages. Neither ROS nor a clock in here: time comes in as numbers."""

from __future__ import annotations

from rig_runtime.faults import Loss, Silence
from shared_control.filter import Reason, Verdict

__all__ = ["REASONS", "Losses"]

#: Each reason of a decision.
REASONS = {
    Reason.CRITERION: "the criterion",
    Reason.FILTER_OFF: "the filter is off",
    Reason.NULL_ACTION: "no action to judge",
    Reason.NON_FINITE_WRENCH: "the wrench is not finite",
    Reason.NON_FINITE_STATE: "the state is not finite",
    Reason.STALE_WRENCH: "no wrench came in time",
    Reason.UNKNOWN_FRAME: "the wrench is in an unknown frame",
    Reason.NOT_CONVERGED: "the controller did not converge",
    Reason.NON_FINITE_CRITERION: "the criterion is not finite",
    Reason.EXCESSIVE_WRENCH: "the wrench is beyond max_force",
    Reason.STALE_STATE: "the state came too late",
}

#: [s] Silence of less than this is not spoken of.
_LEAST_LIMIT = 0.3

#: [s] After this long without a word of a node, what it said does not count any more; it speaks once a second.
_LIFETIME = 3.0

#: [s] How long a loss that is over is still spoken of: most last for a tick.
_REMEMBERED = 1.0


class Losses:
    """What keeps every force away, of all that is known the nearest to the cause.

    That is: no states, no decisions, a decision that admits nothing for a fault, what another node says of itself.

    Parameters
    ----------
    limit: how long states and decisions may be silent [s].
    """

    def __init__(self, limit: float) -> None:
        limit = max(limit, _LEAST_LIMIT)
        self.states, self.decisions = Silence(limit), Silence(limit)
        #: [s] How often to look.
        self.period = self.states.period
        self._loss = Loss()
        self._refused: Reason | None = None
        self._said: dict[str, tuple[str, int]] = {}

    def reset(self) -> None:
        """A new trial."""
        self.states.heard()
        self.decisions.heard()
        self._loss.reset()
        self._refused = None

    def decided(self, verdict: Verdict, reason: Reason) -> None:
        """The filter has decided about a tick."""
        self.decisions.heard()
        lost = verdict is Verdict.REJECTED and reason is not Reason.CRITERION
        self._refused = reason if lost else None

    def hear(self, node: str, because: str, now: int) -> None:
        """What a node says keeps every force away [ns]; empty if nothing does."""
        if because:
            self._said[node] = (because, now)
        else:
            self._said.pop(node, None)

    def look(self, running: bool) -> None:
        """To be called every :attr:`period`; before the first tick of a trial and after its last nobody is silent."""
        for stream in (self.states, self.decisions):
            if running:
                stream.look()
            else:
                stream.heard()

    def tell(self, now: int, running: bool) -> tuple[str, bool]:
        """What the pages say now [ns], and whether that is news; nothing is lost where no trial runs."""
        news = self._loss.tell(self._nearest(now) if running else None, now)
        return self._loss.words(now, remember=_REMEMBERED), news

    def _nearest(self, now: int) -> str | None:
        if self.states.silent:
            return "the task does not answer"
        if self.decisions.silent:
            return "the filter does not answer"
        if self._refused is not None:
            return REASONS[self._refused]
        for node, (because, heard) in self._said.items():
            if now - heard < 1e9 * _LIFETIME:
                return f"{because} ({node})"
        return None
