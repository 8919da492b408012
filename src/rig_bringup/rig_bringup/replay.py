"""A recorded user in front of the live graph: the wrench of a bag, tick by tick, in the place of the simulated one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig_bag import BagError
from rig_bringup import scenario as scenarios
from rig_bringup.scenario import Checked, ScenarioError
from rig_study.recorded import TrialError, load, scenario_of
from rig_study.recorded_inputs import user_forces
from shared_control.users import UserConfig

__all__ = ["Replay"]

FILE = "user_force.npy"


@dataclass(frozen=True)
class Replay:
    """The recorded forces (N, 3) [N] and the scenario that they are played in, whose user is still the original."""

    checked: Checked
    forces: np.ndarray

    @classmethod
    def of(cls, bag: Path, name: str | None, overrides: Mapping[str, Any]) -> Replay:
        """Read a bag. Scenario (where no other is named), seed and duration are those of the recording, and it runs in
        lockstep, unless ``overrides`` say otherwise.

        Raises
        ------
        ScenarioError: the bag cannot be read, holds no user, or its ticks are not the scenario's.
        """
        try:
            forces, trial = user_forces(bag), load(bag)
            if name is None:
                values = {"seed": int(trial.trial.seed), "duration": len(forces) * trial.sample_time}
                given = replace(scenario_of(bag), name=trial.trial.scenario or "replay")
                checked = scenarios.checked(given, {}, {"pacing": "lockstep", **values, **overrides})
            else:
                checked = scenarios.load(name, {"pacing": "lockstep", **overrides})
        except (BagError, TrialError) as error:
            raise ScenarioError(f"--user-from: {error}") from None
        if abs(checked.loop.sample_time - trial.sample_time) > 1e-9:
            raise ScenarioError(
                f"--user-from {bag}: recorded every {trial.sample_time:g} s; the scenario has sample_time "
                f"{checked.loop.sample_time:g}"
            )
        return cls(checked, forces)

    def place(self, folder: Path) -> Checked:
        """Write the forces into a folder; returns the scenario with the user who plays them."""
        path = folder / FILE
        try:
            np.save(path, self.forces)
        except OSError as error:
            raise ScenarioError(f"{path} cannot be written: {error.strerror}") from error
        user = UserConfig(user="replay", recording=str(path))
        return replace(self.checked, scenario=replace(self.checked.scenario, user=user))
