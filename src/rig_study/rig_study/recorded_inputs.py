"""What went into the filter of a recorded trial: the scenario, the states, the user's forces, the decisions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import rig_bag
from rig_study.recorded import TrialError, only, row, scenario_of
from shared_control import scenario as science
from shared_control.filter import INPUT_FAULTS
from shared_control.scenario import Scenario

__all__ = ["FIELDS", "RecordedInputs", "load_inputs", "user_forces"]

Array = npt.NDArray[Any]

#: What is compared, as :class:`shared_control.loop.FilterOutcome` and ``FilterDecision`` both have it.
FIELDS = (
    *("mode", "verdict", "reason", "criterion", "threshold", "user_control", "nominal_control", "applied_control"),
    *("admitted_force", "added_force"),
)

#: Reasons of a decision that did not look at state and wrench of its tick, or had kept an earlier fault.
UNSEEN = tuple(INPUT_FAULTS)


@dataclass(frozen=True)
class RecordedInputs:
    """N decisions in the order in which they were made, with what each was made from.

    Attributes
    ----------
    trial: the last TrialState.
    decisions: structured array (N,), columns as in ``FilterDecision``.
    states: (N, n). task_modes: (N,), the mode of a hybrid task at each.
    forces: (N, 3) [N], what the filter took for the user's.
    dropped: decisions at the end of a cut bag whose state or wrench is not in it.
    """

    bag: Path
    trial: Any
    scenario: Scenario
    decisions: Array
    states: Array
    task_modes: Array
    forces: Array
    dropped: int


def load_inputs(bag: str | Path, scenario: str | None = None) -> RecordedInputs:
    """Read what the filter of a recorded trial was given, and what it decided.

    Parameters
    ----------
    scenario: name or path; by default the one that is attached to the bag.

    Raises
    ------
    TrialError: the bag is of no trial, or something in the middle of it is missing. BagError, ScenarioError: as above.
    """
    topics = rig_bag.read(bag)
    state, wrench = only(topics, "task/state", bag, ("state", "mode")), only(topics, "force_sensor/wrench", bag)
    decision = only(topics, "mig_filter/decision", bag, ("tick", "user_force", *FIELDS))
    trial = only(topics, "trial/state", bag, ("scenario", "seed"))
    if not len(trial) or not len(state) or not len(decision):
        raise TrialError(f"{bag} holds no tick: there is nothing that could be re-derived")
    if isinstance(state, list) or isinstance(decision, list):
        raise TrialError(f"{bag}: the states or the decisions change their form in the middle of the trial")
    stamps, forces = _forces(wrench)
    of_state, has_state = _places(state["stamp"], decision["stamp"])
    of_wrench, has_wrench = _places(stamps, decision["stamp"])
    unseen = np.isin(decision["reason"], UNSEEN)
    usable = has_state & (has_wrench | unseen)
    count = int(np.flatnonzero(usable)[-1]) + 1 if usable.any() else 0
    if not usable[:count].all():
        tick = decision["tick"][np.flatnonzero(~usable)[0]]
        raise TrialError(
            f"{bag}: the state or the wrench of tick {tick} is missing, so what comes after it cannot be re-derived; "
            "bag verify says what else is missing"
        )
    taken = np.where(unseen[:, None], decision["user_force"], forces[of_wrench] if len(forces) else np.nan)
    last = row(trial, -1)
    loaded = replace(_attached(bag) if scenario is None else science.load(scenario), name=last.scenario or "recorded")
    return RecordedInputs(
        bag=Path(bag),
        trial=last,
        scenario=loaded,
        decisions=decision[:count],
        states=state["state"][of_state[:count]],
        task_modes=state["mode"][of_state[:count]],
        forces=np.ascontiguousarray(taken[:count]),
        dropped=len(decision) - count,
    )


def _attached(bag: str | Path) -> Scenario:
    try:
        return scenario_of(bag)
    except TrialError as error:
        raise TrialError(f"{error}; name it by --scenario") from None


def user_forces(bag: str | Path) -> Array:
    """The user's force (N, 3) [N] of each tick from 0 on; NaN, which the filter refuses, where a tick has none.

    Raises
    ------
    TrialError, BagError: as :func:`load_inputs`.
    """
    topics = rig_bag.read(bag)
    state, wrench = only(topics, "task/state", bag), only(topics, "force_sensor/wrench", bag)
    if isinstance(state, list) or not len(state) or not len(wrench):
        raise TrialError(f"{bag} holds no wrench of a user")
    stamps, forces = _forces(wrench)
    places, there = _places(state["stamp"], stamps)
    result = np.full((int(state["tick"].max()) + 1, 3), np.nan)
    result[state["tick"][places[there]]] = forces[there]
    return result


def _forces(wrench: Any) -> tuple[Array, Array]:
    """Stamps (N,) [ns] and forces (N, 3) of wrenches, whether they have a common layout or not."""
    if not isinstance(wrench, list):
        return wrench["stamp"], wrench["wrench.force"]
    stamps = [each.header.stamp.sec * 1_000_000_000 + each.header.stamp.nanosec for each in wrench]
    vectors = [each.wrench.force for each in wrench]
    return np.array(stamps), np.array([(force.x, force.y, force.z) for force in vectors]).reshape(-1, 3)


def _places(where: Array, what: Array) -> tuple[Array, Array]:
    """Index of each of ``what`` in ``where``, and whether it is there."""
    if not len(where):
        return np.zeros(len(what), int), np.zeros(len(what), bool)
    order = np.argsort(where, kind="stable")
    found = order[np.minimum(np.searchsorted(where, what, sorter=order), len(where) - 1)]
    return found, where[found] == what
