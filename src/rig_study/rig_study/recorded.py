"""A recorded trial as arrays, one row for each tick."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

import rig_bag
from rig_study.hops import hops
from shared_control import measures
from shared_control import scenario as science
from shared_control.scenario import LoopConfig, Scenario
from shared_control.trial import measured as of_trial

Array = npt.NDArray[Any]

VERDICTS = ("accepted", "rejected", "replaced")
PACINGS = ("realtime", "lockstep")
MODES = ("off", "training", "assistance")
PHASES = ("idle", "arming", "running", "finished", "aborted")


class TrialError(ValueError):
    """A bag holds no trial that can be analysed; the message says what is missing."""


@dataclass(frozen=True)
class RecordedTrial:
    """N ticks, joined by tick number; axis 0 of every array is the tick.

    Attributes
    ----------
    trial: the last TrialState (names and units of states and controls, seed, subject, ...).
    time: (N,) [s]. states: (N, n). task_modes: (N,), of a hybrid task. user_force: (N, 3) [N].
    user_control, applied_control: (N, m).
    verdict, reason, mode: (N,).
    criterion: (N,), NaN where it was not evaluated. compute_time: (N,) [s], zero in lockstep.
    in_success_region: (N,) bool. held: (N,) bool. received: (N,) [ns] when the recorder got the decision.
    hops: of :func:`rig_study.hops.hops`, (N,) [s] each; empty in lockstep, and of a bag from before there were any.
    """

    bag: Path
    trial: Any
    time: Array
    states: Array
    task_modes: Array
    in_success_region: Array
    held: Array
    user_force: Array
    user_control: Array
    applied_control: Array
    verdict: Array
    reason: Array
    mode: Array
    criterion: Array
    compute_time: Array
    state_age: Array
    received: Array
    hops: dict[str, Array]
    ticks_recorded: int
    decisions_recorded: int

    @property
    def realtime(self) -> bool:
        """Whether wall time paced the trial."""
        return PACINGS[self.trial.pacing] == "realtime"

    @property
    def sample_time(self) -> float:
        """t_s [s]."""
        return _seconds(self.trial.sample_time)

    def shares(self) -> dict[str, float]:
        """Share of each verdict among the decisions."""
        return {name: float(np.mean(self.verdict == k)) for k, name in enumerate(VERDICTS)}


#: The fields that are needed here; a bag of another version of the messages may lack some.
_OF_STATE = ("tick", "time", "state", "mode", "in_success_region", "held")
_OF_CONTROL = ("user_control", "applied_control")
_OF_DECISION = (
    "tick",
    "user_force",
    *_OF_CONTROL,
    "verdict",
    "reason",
    "mode",
    "criterion",
    "compute_time",
    "state_age",
)
_OF_TRIAL = ("phase", "message", "task", "pacing", "sample_time", "scenario", "seed")


def load(bag: str | Path) -> RecordedTrial:
    """Read a recorded trial.

    Raises
    ------
    TrialError: no tick was recorded, or a topic of the loop is missing.
    BagError: the bag cannot be read.
    """
    topics = rig_bag.read(bag)
    state, decision = only(topics, "task/state", bag, _OF_STATE), only(topics, "mig_filter/decision", bag, _OF_DECISION)
    trial = only(topics, "trial/state", bag, _OF_TRIAL)
    if not len(trial):
        raise TrialError(f"{bag} holds no state of the trial: it ended before it began")
    last = row(trial, -1)
    if not len(state) or not len(decision):
        raise TrialError(f"{bag} holds no tick; the trial was {PHASES[last.phase]}: {last.message}")
    ticks, left, right = np.intersect1d(state["tick"], decision["tick"], return_indices=True)
    state, joined = state[left], decision[right]
    wrench = next((table for name, table in topics.items() if name.endswith("/force_sensor/wrench")), None)
    motions = [table for name, table in topics.items() if name.endswith("/admittance/end_effector")]
    return RecordedTrial(
        bag=Path(bag),
        trial=last,
        time=state["time"],
        states=state["state"],
        task_modes=state["mode"],
        in_success_region=state["in_success_region"].astype(bool),
        held=state["held"].astype(bool),
        user_force=joined["user_force"],
        user_control=joined["user_control"],
        applied_control=joined["applied_control"],
        verdict=joined["verdict"],
        reason=joined["reason"],
        mode=joined["mode"],
        criterion=joined["criterion"],
        compute_time=joined["compute_time"],
        state_age=joined["state_age"],
        received=joined["log_time"],
        hops=hops(state, joined, motions[0], _seconds(last.sample_time), wrench) if len(motions) == 1 else {},
        ticks_recorded=len(left) if len(ticks) else 0,
        decisions_recorded=len(decision),
    )


def _seconds(duration: Any) -> float:
    # A table holds whole nanoseconds; a single message holds the two fields.
    return float(duration.sec + 1e-9 * duration.nanosec if hasattr(duration, "sec") else 1e-9 * duration)


def measured(trial: RecordedTrial) -> measures.CartPendulumMeasures | measures.SlipMeasures | None:
    """The measures of its task; None if it has none. N states make N - 1 samples: the last tick only starts one.

    Raises
    ------
    TrialError, ScenarioError: as :func:`scenario_of`, for a task whose measures depend on the scenario.
    """
    if trial.trial.task == "slip":
        # When it has fallen and how fast it should run is the trial's own scenario's to say.
        scenario = scenario_of(trial.bag)
    else:
        scenario = Scenario(loop=LoopConfig(task=trial.trial.task, sample_time=trial.sample_time))
    decided = (trial.user_control[:-1], trial.verdict[:-1], trial.reason[:-1])
    return of_trial(scenario, trial.states, *decided, trial.task_modes)


def scenario_of(bag: str | Path) -> Scenario:
    """The scenario that is attached to a bag.

    Raises
    ------
    TrialError: there is none. ScenarioError: it is not one that this version can run. BagError: as ``rig_bag.info``.
    """
    found = [
        data
        for contents in rig_bag.info(bag).contents()
        for name, media_type, data in contents.attachments
        if media_type == "application/yaml" and b"ros__parameters" in data
    ]
    if len(found) != 1:
        raise TrialError(f"{bag} has {len(found)} scenarios attached; one is wanted, that of the trial")
    try:
        content = yaml.safe_load(found[0])
    except yaml.YAMLError as error:
        raise science.ScenarioError(f"the scenario attached to {bag} is not YAML: {error}") from error
    if not isinstance(content, Mapping):
        raise science.ScenarioError(f"the scenario attached to {bag} is not a parameter file")
    return science.load(content)


def only(topics: dict[str, Any], name: str, bag: str | Path, fields: Sequence[str] = ()) -> Any:
    """The one topic of this name, whatever its namespace; TrialError if there is none, or another, or a field lacks."""
    found = [topic for topic in topics if topic.endswith(f"/{name}")]
    if len(found) != 1:
        there = ", ".join(topics) or "none"
        raise TrialError(f"{bag} has {len(found)} topics {name}; a trial has one. It has: {there}")
    table = topics[found[0]]
    if len(table):
        has = vars(table[0]) if isinstance(table, list) else table.dtype.names
        lacks = [
            field for field in fields if field not in has and not any(str(key).startswith(f"{field}.") for key in has)
        ]
        if lacks:
            raise TrialError(
                f"{bag}: {found[0]} has no {', '.join(lacks)}: it was recorded with another version of the messages"
            )
    return table


def row(table: Any, index: int) -> Any:
    """One message, whether the reader found a common layout or not."""
    if isinstance(table, list):
        return table[index]
    row = table[index]
    return type("Row", (), {name: row[name] for name in table.dtype.names})
