"""What the pages are shown: filled by the ROS callbacks, emptied by the server's thread, waited for by neither."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from mig_interfaces.msg import FilterDecision, RecorderState, SessionState, StudyChoices, TaskState, TrialState
from rig_display.hand import Sample
from rig_display.protocol import finite_or_none
from rig_runtime.wire import MalformedError

__all__ = ["Feed"]

#: [ticks] that wait for a server which has fallen behind; older ones are left out of the pages' plots.
_DEPTH = 500

_PHASES = ("idle", "arming", "running", "finished", "aborted")
_MODES = ("off", "training", "assistance")


def _rounded(values: Any) -> list[float | None]:
    return [finite_or_none(round(float(value), 6)) for value in values]


class Feed:
    """The newest of everything, as plain values for JSON. A field is replaced whole, never changed."""

    def __init__(self) -> None:
        #: Called after a tick was added, from the loop's thread; must not block.
        self.wake: Callable[[], None] = lambda: None
        self.trial: dict[str, Any] = {"phase": "idle", "message": "no trial/state has come yet"}
        self.recorder: dict[str, Any] | None = None
        #: What a node has stopped for, by its name.
        self.faults: dict[str, str] = {}
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

    def put_decision(self, decision: FilterDecision) -> None:
        """What the filter made of a tick.

        Raises
        ------
        MalformedError: a mode that no filter has.
        """
        if decision.mode >= len(_MODES):
            raise MalformedError(f"there is no mode {decision.mode}")
        self.mode = _MODES[decision.mode]
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

    def put_trial(self, trial: TrialState) -> None:
        """Which trial, and how it stands."""
        sample = trial.sample_time.sec + 1e-9 * trial.sample_time.nanosec
        if trial.phase == TrialState.PHASE_ARMING:
            self._states.clear()
            self._decisions.clear()
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

    def put_fault(self, node: str, message: str | None) -> bool:
        """What a node has stopped for, None if for nothing; whether that is news."""
        if self.faults.get(node) == message:
            return False
        others = {name: said for name, said in self.faults.items() if name != node}
        self.faults = others if message is None else {**others, node: message}
        return True

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


def _drain(queue: deque[list[Any]]) -> list[list[Any]]:
    rows = []
    for _ in range(len(queue)):
        try:
            rows.append(queue.popleft())
        except IndexError:  # cleared meanwhile
            break
    return rows
