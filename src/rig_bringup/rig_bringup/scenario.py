"""Scenarios for the graph: read and checked against the nodes' own declarations, and written as what a run used."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from rig_bag.configuration import RecorderConfig
from rig_display.parameters import DisplayConfig
from shared_control import scenario as science
from shared_control import yaml_text
from shared_control.parameters import ParameterError, build
from shared_control.scenario import LoopConfig, Scenario, ScenarioError

__all__ = ["Checked", "ScenarioError", "checked", "load", "parameter_file", "use_shipped_scenarios"]

_RECORDER = "/**/recorder"
_DISPLAY = "/**/display"

#: Section of a parameter file for each part of a scenario.
_SECTIONS = {
    "/**": "loop",
    "/**/task_sim": "task",
    "/**/user_sim": "user",
    "/**/mig_filter": "filter",
    "/**/admittance_sim": "robot",
}


@dataclass(frozen=True)
class Checked:
    """A scenario whose every key and value has been checked, with the recorder's section beside it.

    `display` is the display's, where a person takes the place of the simulated user.
    """

    scenario: Scenario
    recorder: dict[str, Any]
    display: dict[str, Any] | None = None

    @property
    def loop(self) -> LoopConfig:
        """What the nodes share."""
        return self.scenario.loop

    def text(self) -> str:
        """The scenario as a ROS parameter file that names every value, defaults included."""
        values = {section: asdict(getattr(self.scenario, part)) for section, part in _SECTIONS.items()}
        if self.display is not None:
            del values["/**/user_sim"]
            values[_DISPLAY] = self.display
        return parameter_file({**values, _RECORDER: self.recorder})

    def digest(self) -> str:
        """SHA-256 of :meth:`text`."""
        return hashlib.sha256(self.text().encode()).hexdigest()


def load(name: str, overrides: Mapping[str, Any], *, person: bool = False) -> Checked:
    """Find a scenario by name or path, check it, and put shared values from the command line on top.

    With `person` the display takes the place of the simulated user, and a fault stays until somebody clears it.

    Raises
    ------
    ScenarioError: missing, not YAML, an unknown key, a wrong type, out of range; the message says where and what to do.
    """
    use_shipped_scenarios()
    path = science.find(name)
    scenario = science.load(path)
    try:
        recorder = _section(path, _RECORDER, RecorderConfig)
        display = asdict(build(DisplayConfig, _section(path, _DISPLAY, DisplayConfig)))
    except ParameterError as error:
        raise ScenarioError(str(error)) from None
    result = checked(scenario, recorder, {"recovery": "explicit", **overrides} if person else overrides)
    return replace(result, display=_without_secrets(display)) if person else result


def checked(scenario: Scenario, recorder: dict[str, Any], overrides: Mapping[str, Any]) -> Checked:
    """Put shared values from the command line on top of a scenario, and check that all fits together.

    Raises
    ------
    ScenarioError: it does not.
    """
    try:
        loop = build(LoopConfig, {**asdict(scenario.loop), **overrides}, "command line")
        scenario = replace(scenario, loop=loop)
        science.check(scenario)
    except ParameterError as error:
        raise ScenarioError(str(error)) from None
    return Checked(scenario, recorder)


def use_shipped_scenarios() -> None:
    """Let names of scenarios stand for the files of this checkout's `config/`."""
    root = os.environ.get("RIG_ROOT")
    if root:
        os.environ.setdefault("SHARED_CONTROL_CONFIG", str(Path(root) / "config"))


def _section(path: Path, section: str, configuration: type) -> dict[str, Any]:
    content = yaml_text.read(path)[1] or {}
    body = content.get(section) or {}
    if not isinstance(body, Mapping) or not isinstance(body.get("ros__parameters") or {}, Mapping):
        raise ParameterError(f"{path}: section {section}: must hold ros__parameters, a mapping of keys to values")
    values = {str(key): value for key, value in (body.get("ros__parameters") or {}).items()}
    build(configuration, values, f"{path}: section {section}")
    return values


def _without_secrets(display: dict[str, Any]) -> dict[str, Any]:
    # What a run used is kept beside its bag and in it, and goes where the bag goes.
    return {key: value for key, value in display.items() if key != "token"}


def parameter_file(sections: Mapping[str, Mapping[str, Any]]) -> str:
    """Sections and values as the text of a ROS parameter file.

    Empty sections and empty lists are left out: ROS cannot tell the type of an empty list, and it is the default's.
    """
    content = {}
    for section, values in sections.items():
        plain = {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
        plain = {key: value for key, value in plain.items() if value != []}
        if plain:
            content[section] = {"ros__parameters": plain}
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
