"""Monte Carlo runs and sweeps: the jobs of one scenario over seeds, and over a grid of its parameters.

A sweep file has two sections: ``sweep`` (:class:`SweepConfig`) and ``parameters``, dotted names with lists of values:

    sweep:
      scenario: cart_pendulum_noise_assistance
      trials: 20
    parameters:
      mig_filter.horizon: [0.8, 1.0, 1.5]
      user_sim.noise_sd: [[10.0], [20.0]]

A list of such mappings is a list of grids, one after the other. Each point runs the same seeds, so that points are
compared on the same users.
"""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rig_study.changes import apply
from rig_study.declared import DeclaredFile, StudyError, base_scenario, load, section
from rig_study.runs import Job
from shared_control import scenario as science
from shared_control.parameters import ParameterError, parameter, shown
from shared_control.scenario import Scenario

__all__ = ["Sweep", "SweepConfig", "load_sweep", "montecarlo_jobs", "sweep_jobs"]

#: Points of a sweep; more are a mistake, and would not be over in a year.
_MOST_POINTS = 100_000


@dataclass(frozen=True)
class SweepConfig:
    """What all points of the grid share."""

    scenario: str = parameter("cart_pendulum_noise_assistance", "Scenario that the parameters change.")
    trials: int = parameter(10, "Trials at each point.", ge=1, le=1000000)
    seed: int = parameter(0, "Seed of the first trial; the others follow.", ge=0, le=2**62)


@dataclass(frozen=True)
class Sweep:
    """A checked sweep: its points, in the order of the grid, the last parameter fastest."""

    file: DeclaredFile
    config: SweepConfig
    points: tuple[tuple[Mapping[str, Any], Scenario], ...]


def load_sweep(name: str | os.PathLike[str]) -> Sweep:
    """From a path, or a name under ``config/sweeps``.

    Raises
    ------
    StudyError: as :func:`rig_study.declared.load`, no values for a parameter, or a point that is not allowed.
    """
    file = load("sweeps", name, ("sweep", "parameters"))
    config = section(file, "sweep", SweepConfig)
    base = base_scenario(file, config.scenario, "sweep")
    points = []
    for axes in _grids(file):
        for chosen in itertools.product(*axes.values()):
            changes = dict(zip(map(str, axes), chosen, strict=True))
            try:
                points.append((changes, apply(base, changes, f"{file.path}: parameters")))
            except ParameterError as error:
                raise StudyError(str(error)) from None
    return Sweep(file, config, tuple(points))


def _grids(file: DeclaredFile) -> list[Mapping[str, list[Any]]]:
    parameters = file.content.get("parameters")
    grids = parameters if isinstance(parameters, list) else [parameters]
    for axes in grids or [None]:
        if not isinstance(axes, Mapping) or not axes:
            raise StudyError(f"{file.path}: parameters: at least one is needed, as in 'mig_filter.horizon: [1.0, 1.5]'")
        for key, values in axes.items():
            if not isinstance(values, list) or not values:
                raise StudyError(
                    f"{file.path}: parameters: {key}: {shown(values)} is not allowed; it must be a list of values"
                )
    points = sum(math.prod(map(len, axes.values())) for axes in grids)
    if points > _MOST_POINTS:
        raise StudyError(f"{file.path}: parameters: {points} points; a sweep has at most {_MOST_POINTS}")
    return grids


def montecarlo_jobs(scenario: str, trials: int, seed: int, trace: int) -> list[Job]:
    """One scenario over seeds from ``seed`` on.

    Raises
    ------
    ScenarioError: see :func:`shared_control.scenario.load`. StudyError: fewer than one trial, or a negative number.
    """
    if trials < 1 or seed < 0 or trace < 0:
        raise StudyError(
            f"trials {trials}, seed {seed}, trace {trace}: trials must be at least 1, the others at least 0"
        )
    loaded = science.load(scenario)
    return [
        Job(f"{loaded.name}_t{k:06d}", loaded, seed + k, {"scenario": loaded.name, "trial": k + 1}, trace)
        for k in range(trials)
    ]


def sweep_jobs(sweep: Sweep) -> list[Job]:
    """Every trial of every point."""
    return [
        Job(
            f"p{point:04d}_t{k:06d}",
            scenario,
            sweep.config.seed + k,
            {"scenario": sweep.config.scenario, "point": point, **_columns(changes), "trial": k + 1},
        )
        for point, (changes, scenario) in enumerate(sweep.points)
        for k in range(sweep.config.trials)
    ]


def _columns(changes: Mapping[str, Any]) -> dict[str, Any]:
    # A column holds one kind of value, and a group by it needs one that can be compared.
    return {key: json.dumps(value) if isinstance(value, list) else value for key, value in changes.items()}
