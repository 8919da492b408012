"""Runs the filter again over what a bag holds, and compares its decisions with those of the recording.

With the configuration of the recording the decisions are the same to the last bit, or the first that is not is shown.
With another configuration the answer is a counterfactual: what that filter would have said to the same states and
wrenches. Its trajectory would have been another one from the first other verdict on; :func:`simulate` runs that, with
the recorded force as a user who does not look.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from rig_study.recorded import VERDICTS
from rig_study.recorded_inputs import FIELDS, UNSEEN, RecordedInputs
from shared_control import loop
from shared_control.filter import Reason
from shared_control.scenario import Scenario
from shared_control.trial import TrialResult, run_trial
from shared_control.users import UserConfig

__all__ = ["FIELDS", "Difference", "Rederived", "rederive", "simulate"]

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Difference:
    """The first decision that is not as recorded."""

    tick: int
    fields: tuple[str, ...]
    recorded: Mapping[str, Any]
    derived: Mapping[str, Any]

    def text(self) -> str:
        """Both records, field by field; what differs is marked."""
        lines = [f"the first difference is at tick {self.tick}", f"  {'':16} {'recorded':>32} {'re-derived':>32}"]
        for name in FIELDS:
            mark = "*" if name in self.fields else " "
            lines.append(f"{mark} {name:16} {_show(self.recorded[name]):>32} {_show(self.derived[name]):>32}")
        return "\n".join(lines)


def _show(value: Any) -> str:
    return " ".join(repr(float(item)) for item in np.atleast_1d(value))


@dataclass(frozen=True)
class Rederived:
    """Decisions over the inputs of a recording, as structured array (N,) with the columns :data:`FIELDS`."""

    inputs: RecordedInputs
    decisions: Array
    #: [s] of wall time, without loading and compiling.
    seconds: float

    def difference(self) -> Difference | None:
        """The first decision that differs in any bit of any field."""
        recorded, derived = self.inputs.decisions, self.decisions
        differs = {name: _rows_that_differ(recorded[name], derived[name]) for name in FIELDS}
        places = np.flatnonzero(np.any(list(differs.values()), axis=0))
        if not len(places):
            return None
        place = int(places[0])
        return Difference(
            tick=int(recorded["tick"][place]),
            fields=tuple(name for name in FIELDS if differs[name][place]),
            recorded={name: recorded[name][place] for name in FIELDS},
            derived={name: derived[name][place] for name in FIELDS},
        )

    def confusion(self) -> Array:
        """(3, 3): how many decisions were recorded with the verdict of the row and would have that of the column."""
        result = np.zeros((len(VERDICTS), len(VERDICTS)), int)
        np.add.at(result, (self.inputs.decisions["verdict"], self.decisions["verdict"]), 1)
        return result


def _rows_that_differ(first: Array, second: Array) -> Array:
    """Which rows have other bits: a NaN equals itself, and zero does not equal minus zero."""
    count = len(first)
    if first.shape != second.shape:
        return np.ones(count, bool)
    if not count or not first.size:
        return np.zeros(count, bool)
    as_bytes = [np.ascontiguousarray(part, second.dtype).view(np.uint8).reshape(count, -1) for part in (first, second)]
    return np.any(as_bytes[0] != as_bytes[1], axis=1)


def rederive(inputs: RecordedInputs, scenario: Scenario | None = None) -> Rederived:
    """Decide again. ``scenario``: another one than that of the recording.

    A mode or a threshold that was changed while the trial ran is followed as recorded, unless the other scenario says
    another one.
    """
    given = inputs.scenario if scenario is None else scenario
    agent = loop.make_filter(given)
    agent.warm_up()
    follow_mode = given.filter.mode == inputs.scenario.filter.mode
    # With a contraction a decision's threshold is not the one that was set.
    follow_threshold = (
        given.filter.threshold == inputs.scenario.filter.threshold
        and given.filter.contraction == inputs.scenario.filter.contraction == 0.0
    )
    recorded, m = inputs.decisions, agent.task.m
    columns = [(name, *_form(name, m)) for name in FIELDS]
    result = np.zeros(len(recorded), np.dtype(columns))
    modes, reasons = recorded["mode"].tolist(), recorded["reason"].tolist()
    thresholds = recorded["threshold"].tolist()
    threshold = given.filter.threshold
    rows = []
    begin = time.perf_counter()
    task_modes = inputs.task_modes.tolist()
    for place, (state, force) in enumerate(zip(inputs.states, inputs.forces, strict=True)):
        if follow_mode and modes[place] != agent.mode:
            agent.mode = modes[place]
        if follow_threshold and thresholds[place] != threshold:
            threshold = thresholds[place]
            agent.configure(threshold=threshold)
        if reasons[place] in UNSEEN:
            outcome = agent.fallback(Reason(reasons[place]), force)
        else:
            outcome = agent.decide(state, force, task_modes[place])
        decision = outcome.decision
        rows.append(
            (
                *(decision.mode, decision.verdict, decision.reason, decision.criterion, decision.threshold),
                *(decision.user_control, decision.nominal_control, decision.applied_control),
                *(outcome.admitted_force, outcome.added_force),
            )
        )
    for name, values in zip(FIELDS, zip(*rows, strict=True), strict=True):
        result[name] = np.array(values)
    return Rederived(inputs, result, time.perf_counter() - begin)


def _form(name: str, m: int) -> tuple[Any, ...]:
    if name in ("mode", "verdict", "reason"):
        return (np.uint8,)
    if name in ("criterion", "threshold"):
        return (np.float64,)
    return np.float64, (m if name.endswith("control") else 3,)


def simulate(inputs: RecordedInputs, forces: Array, scenario: Scenario | None = None) -> TrialResult:
    """The whole loop again, headless, with the recorded forces (N, 3) [N] as an open-loop user."""
    given = inputs.scenario if scenario is None else scenario
    duration = len(forces) * given.loop.sample_time
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "forces.npy"
        np.save(recording, forces)
        user = UserConfig(user="replay", recording=str(recording))
        return run_trial(
            replace(given, user=user, loop=replace(given.loop, duration=duration)), seed=int(inputs.trial.seed)
        )
