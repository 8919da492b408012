"""What the pages are shown: filled by the ROS callbacks, emptied by the server's thread, waited for by neither."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from mig_interfaces.msg import FilterDecision, RecorderState, SessionState, StudyChoices, TaskState, TrialState
from rig_display.hand import Sample
from rig_display.losses import REASONS
from rig_display.protocol import finite_or_none
from rig_runtime.wire import MalformedError
from shared_control.filter import Mode, Reason, Verdict

__all__ = ["Feed"]

#: [ticks] that wait for a server which has fallen behind; older ones are left out of the pages' plots.
_DEPTH = 500

_PHASES = ("idle", "arming", "running", "finished", "aborted")


def _rounded(values: Any) -> list[float | None]:
    return [finite_or_none(round(float(value), 6)) for value in values]


class Feed:
    """The newest of everything, as plain values for JSON. A field is replaced whole, never changed."""

    def __init__(self) -> None:
        #: Called after a tick was added, from the loop's thread; must not block.
        self.wake: Callable[[], None] = lambda: None
        self.trial: dict[str, Any] = {"phase": "idle", "message": "no trial/state has come yet"}
        self.recorder: dict[str, Any] | None = None
        #: What a node admits no force for until it is released, by its name; and what else has failed.
        self.faults: dict[str, str] = {}
        self.troubles: dict[str, str] = {}
        #: Why there is no force at this moment, a sentence; empty while there may be some.
        self.loss = ""
        #: The newest verdict with its reason, in words; None if it is long ago.
        self.decision: str | None = None
        #: How far the session is; None where none is led.
        self.session: dict[str, Any] | None = None
        #: Whose session may be chosen; None where there is no choice.
        self.choices: dict[str, Any] | None = None
        self.mode: str | None = None
        self.target: tuple[float, ...] = ()
        self._states: deque[list[Any]] = deque(maxlen=_DEPTH)
        self._decisions: deque[list[Any]] = deque(maxlen=_DEPTH)

    # -- the loop's side -----------------------------------------------------------------------------------------

    def put_state(self, state: TaskState, sample: Sample, received: int, latency: float | None) -> None:
        """A tick: the state, the hand's answer, when it came [ns], pointer to wrench [ms] if there was an event."""
        flags = state.in_success_region | state.held << 1 | state.outcome << 2
        self._states.append(
            [
                state.tick,
                finite_or_none(round(state.time, 6)),
                state.mode,
                flags,
                state.missed_deadlines,
                received,
                _rounded(state.state),
                _rounded(sample.force),
                latency,
            ]
        )
        self.wake()

    def put_decision(self, decision: FilterDecision) -> tuple[Verdict, Reason]:
        """What the filter made of a tick.

        Raises
        ------
        MalformedError: a mode, a verdict or a reason that no filter has.
        """
        try:
            mode, verdict, reason = Mode(decision.mode), Verdict(decision.verdict), Reason(decision.reason)
        except ValueError as error:
            raise MalformedError(str(error)) from None
        self.mode = mode.name.lower()
        self.decision = f"{verdict.name.lower()}: {REASONS[reason]}"
        added = decision.admitted_force
        self._decisions.append(
            [
                decision.tick,
                decision.verdict,
                decision.reason,
                finite_or_none(decision.criterion),
                finite_or_none(decision.threshold),
                _rounded((added.x, added.y, added.z)),
                finite_or_none(round(1e3 * decision.compute_time, 3)),
                finite_or_none(round(1e3 * decision.wrench_age, 3)),
            ]
        )
        return verdict, reason

    def put_trial(self, trial: TrialState) -> None:
        """Which trial, and how it stands."""
        sample = trial.sample_time.sec + 1e-9 * trial.sample_time.nanosec
        if trial.phase == TrialState.PHASE_ARMING:
            self._states.clear()
            self._decisions.clear()
            self.decision = None
        self.trial = {
            "phase": _PHASES[trial.phase],
            "message": trial.message,
            "uid": trial.uid,
            "subject": trial.subject,
            "group": trial.group,
            "set": trial.set,
            "trial": trial.trial,
            "scenario": trial.scenario,
            "duration": round(trial.ticks_planned * sample, 6),
            "published": trial.ticks_published,
            "missed": trial.missed_deadlines,
            "outcome": trial.outcome,
        }

    def put_error(self, node: str, message: str | None, because: str) -> bool:
        """What a node cannot go on for, None if it can, and what it admits no force for; whether that is news."""
        fault = because if message is not None and because else None
        trouble = message if not because else None
        was = self.faults, self.troubles
        self.faults, self.troubles = _with(self.faults, node, fault), _with(self.troubles, node, trouble)
        return was != (self.faults, self.troubles)

    def put_session(self, state: SessionState) -> None:
        """How far the session is."""
        self.session = {
            # As a protocol is chosen: without the hash that tells its versions apart.
            "study": state.protocol.rpartition("-")[0],
            "subject": state.subject,
            "done": state.trials_done,
            "planned": state.trials_planned,
            "remaining": state.remaining.sec,
            "set": state.set,
            "trial": state.trial,
            "waiting": state.waiting,
            "over": state.over,
            "doing": state.doing,
            "instructions": state.instructions,
        }

    def put_choices(self, choices: StudyChoices) -> None:
        """Whose session may be chosen."""
        self.choices = {
            "message": choices.message,
            "failed": choices.failed,
            "subjects": [
                {
                    "protocol": each.protocol,
                    "title": each.title,
                    "subject": each.subject,
                    "group": each.group,
                    "done": each.trials_done,
                    "planned": each.trials_planned,
                    "problem": each.problem,
                }
                for each in choices.subjects
            ],
        }

    def put_recorder(self, state: RecorderState) -> None:
        """How far the recorder is."""
        self.recorder = {
            "recording": state.recording,
            "messages": state.messages,
            "bytes": state.bytes,
            "lost": state.lost,
            "message": state.message,
        }

    # -- the server's side ---------------------------------------------------------------------------------------

    def take(self) -> tuple[list[list[Any]], list[list[Any]]]:
        """States and decisions that came since the last call."""
        return _drain(self._states), _drain(self._decisions)


def _with(said: dict[str, str], node: str, words: str | None) -> dict[str, str]:
    others = {name: other for name, other in said.items() if name != node}
    return others if words is None else {**others, node: words}


def _drain(queue: deque[list[Any]]) -> list[list[Any]]:
    rows = []
    for _ in range(len(queue)):
        try:
            rows.append(queue.popleft())
        except IndexError:  # cleared meanwhile
            break
    return rows
