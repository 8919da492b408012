"""Scenarios: ROS parameter files that say everything about a trial.

Section ``/**`` holds what the nodes share (:class:`LoopConfig`), ``/**/mig_filter``, ``/**/admittance_sim``,
``/**/user_sim`` and ``/**/task_sim`` what is each node's own. Sections of other nodes are theirs to check and are
ignored here.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shared_control import admittance, tasks, yaml_text
from shared_control import filter as mig_filter
from shared_control.admittance import AdmittanceConfig
from shared_control.filter import FilterConfig
from shared_control.parameters import ParameterError, build, declarations, parameter, shown
from shared_control.tasks.task import SAMPLE_TIME, Robot, Task
from shared_control.users import UserConfig, presets

__all__ = ["LoopConfig", "Scenario", "ScenarioError", "TaskConfig", "check", "find", "folders", "load"]

#: Parameters that every ROS node has by itself; a file may set them, they are none of ours.
_ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides")


#: [characters] Of a file; systems take 255 bytes.
_LONGEST_NAME = 200


class ScenarioError(ParameterError):
    """A scenario is missing, is not YAML, or says something that is not allowed. The message is for a person."""


@dataclasses.dataclass(frozen=True)
class LoopConfig:
    """What all parts of the loop share."""

    task: str = parameter("cart_pendulum", "The dynamic task.", choices=tasks.names())
    task_parameters: tuple[str, ...] = parameter(
        (), "Physical parameters of the task as name=value, for plant and model alike; the rest as the task has them."
    )
    seed: int = parameter(0, "Every random stream of the trial derives from it.", ge=0, le=2**63 - 1)
    sample_time: float = parameter(SAMPLE_TIME, "t_s, from tick to tick.", unit="s", ge=0.0005, le=1.0)
    duration: float = parameter(30.0, "Length of the trial.", unit="s", ge=0.0, le=86400.0)
    pacing: str = parameter(
        "realtime",
        "realtime: a tick begins when its time has come; lockstep: as soon as the last is closed.",
        choices=("realtime", "lockstep"),
    )
    command_timeout: float = parameter(
        0.05,
        "With no wrench or command for this long, the admitted force is zero.",
        unit="s",
        ge=0.0,
        le=10.0,
    )
    state_timeout: float = parameter(
        0.0,
        "A state that is later than this, against the least late one of its trial, is not judged and nothing is "
        "admitted; 0: command_timeout where recovery is explicit, else any is judged: a simulated task is as late as "
        "its machine.",
        unit="s",
        ge=0.0,
        le=10.0,
    )
    recovery: str = parameter(
        "automatic",
        "After a lost or impossible input: automatic: go on when the input is good again; explicit: admit no force "
        "until clear_fault is called or a trial begins.",
        choices=("automatic", "explicit"),
    )
    robot_mass: float = parameter(
        Robot().mass, "Apparent mass m of the robot, M(s) = 1/(m s + b).", unit="kg", ge=0.01, le=1000.0
    )
    robot_damping: float = parameter(
        Robot().damping, "Apparent damping b of the robot.", unit="N s/m", ge=0.0, le=10000.0
    )

    @property
    def ticks(self) -> int:
        """Number of samples in the trial."""
        return round(self.duration / self.sample_time)

    @property
    def state_limit(self) -> float:
        """How late a state may be [s]; 0: however late."""
        return self.state_timeout or (self.command_timeout if self.recovery == "explicit" else 0.0)

    @property
    def robot(self) -> Robot:
        """The admittance model."""
        return Robot(self.robot_mass, self.robot_damping)

    def make_task(self) -> Task:
        """The task with its physical parameters."""
        return tasks.get_from_text(self.task, self.task_parameters)


@dataclasses.dataclass(frozen=True)
class TaskConfig:
    """Parameters of the simulated task besides its physics."""

    initial_state: tuple[float, ...] = parameter((), "State at the start; empty: the task's.", unit="of the states")
    initial_sd: tuple[float, ...] = parameter(
        (), "Standard deviation of a random perturbation of the start, for each state; empty: none.", ge=0.0
    )
    plant_parameters: tuple[str, ...] = parameter(
        (),
        "Physical parameters, as name=value, in which the simulated plant differs from the model that filter, "
        "controller and user have.",
    )

    def make_plant(self, model: Task) -> Task:
        """The plant: the model with what differs.

        Raises
        ------
        ParameterError: a parameter that is not known, or a value out of its range.
        """
        try:
            differs = tasks.parse(self.plant_parameters)
            return tasks.get(model.name, **{**model.parameters._asdict(), **differs})
        except ParameterError as error:
            raise ParameterError("plant_parameters: " + str(error).removeprefix("task_parameters: ")) from None


_SECTIONS: dict[str, tuple[str, type[Any]]] = {
    "/**": ("loop", LoopConfig),
    "/**/mig_filter": ("filter", FilterConfig),
    "/**/admittance_sim": ("robot", AdmittanceConfig),
    "/**/user_sim": ("user", UserConfig),
    "/**/task_sim": ("task", TaskConfig),
}


@dataclasses.dataclass(frozen=True)
class Scenario:
    """Everything about a trial but its seed, which the loop's configuration only proposes."""

    name: str = "default"
    text_hash: str = ""
    loop: LoopConfig = dataclasses.field(default_factory=LoopConfig)
    filter: FilterConfig = dataclasses.field(default_factory=FilterConfig)
    robot: AdmittanceConfig = dataclasses.field(default_factory=AdmittanceConfig)
    user: UserConfig = dataclasses.field(default_factory=UserConfig)
    task: TaskConfig = dataclasses.field(default_factory=TaskConfig)


def folders() -> list[Path]:
    """Where scenarios are looked for by their names, in order: SHARED_CONTROL_CONFIG alone, where it is set."""
    named = os.environ.get("SHARED_CONTROL_CONFIG")
    beside_sources = Path(__file__).resolve().parents[3] / "config"
    return [Path(named)] if named else [Path("config"), beside_sources]


def find(name: str | os.PathLike[str]) -> Path:
    """The file that a scenario's name or path stands for.

    Raises
    ------
    ScenarioError: there is none; the message lists what there is.
    """
    given = Path(name)
    if not given.name or "\0" in str(given) or max(map(len, given.parts)) > _LONGEST_NAME:
        raise ScenarioError(f"scenario {shown(os.fspath(name))} is not the name of a file")
    for path in (given, given.with_name(given.name + ".yaml")):
        for candidate in [path] if path.is_absolute() else [path, *(folder / path for folder in folders())]:
            if candidate.is_file():
                return candidate
    there = sorted({path.name for folder in folders() if folder.is_dir() for path in folder.glob("*.yaml")})
    near = difflib.get_close_matches(given.stem, [path.removesuffix(".yaml") for path in there], n=1)
    hint = f"did you mean {near[0]}.yaml? " if near else ""
    listing = "there are: " + ", ".join(there) if there else "there are none in " + ", ".join(map(str, folders()))
    raise ScenarioError(f"scenario {shown(os.fspath(name))} not found; {hint}{listing}")


def load(source: str | os.PathLike[str] | Mapping[str, Any] | Scenario) -> Scenario:
    """A scenario from a file, from the name of a file under ``config/``, or from a mapping of the same form.

    Raises
    ------
    ScenarioError: no such file, not YAML (with the line), an unknown key (with the nearest one) or a value that is not
        allowed (with file, section, key, value and range).
    """
    if isinstance(source, Scenario):
        return source
    if isinstance(source, Mapping):
        text = json.dumps(source, sort_keys=True, default=list)
        return _read(source, "mapping", "mapping", hashlib.sha256(text.encode()).hexdigest())
    path = find(source)
    try:
        raw, content = yaml_text.read(path)
    except ParameterError as error:
        raise ScenarioError(str(error)) from None
    if content is None:
        content = {}
    return _read(content, str(path), path.stem, hashlib.sha256(raw).hexdigest())


def _read(content: Any, where: str, name: str, text_hash: str) -> Scenario:
    if not isinstance(content, Mapping):
        raise ScenarioError(f"{where}: must be a mapping of sections, as in '/**/mig_filter: {{ros__parameters: ...}}'")
    parts: dict[str, Any] = {}
    for section, body in content.items():
        known = _known_section(section, where)
        if known is None:
            continue
        attribute, cls = _SECTIONS[known]
        place = f"{where}: section {section}"
        if not isinstance(body, Mapping) or set(body) != {"ros__parameters"}:
            raise ScenarioError(f"{place}: must hold ros__parameters and nothing else")
        values = body["ros__parameters"] if body["ros__parameters"] is not None else {}
        if not isinstance(values, Mapping):
            raise ScenarioError(f"{place}: ros__parameters must be a mapping of keys to values")
        if attribute in parts:
            raise ScenarioError(f"{place}: this section is there twice")
        own = {str(key): value for key, value in values.items() if key not in _ROS_OWN}
        try:
            parts[attribute] = build(cls, own, place)
        except ParameterError as error:
            raise ScenarioError(str(error) + _yaml_hint(cls, own)) from None
    scenario = Scenario(name=name, text_hash=text_hash, **parts)
    try:
        check(scenario)
    except ParameterError as error:
        raise ScenarioError(f"{where}: {error}") from None
    return scenario


def _yaml_hint(cls: type[Any], values: Mapping[str, Any]) -> str:
    """What to say of a word that YAML took for a truth value, as it does with a bare ``off``."""
    for declaration in declarations(cls):
        if declaration.choices and isinstance(values.get(declaration.name), bool):
            return ' (YAML reads on, off, yes and no as true and false: put the word in quotes, as in "off")'
    return ""


def _known_section(section: Any, where: str) -> str | None:
    """The section of ours that a key means; None for another node's."""
    if section == "/**":
        return "/**"
    full = "/**/" + str(section).rsplit("/", 1)[-1]
    if full in _SECTIONS:
        return full
    near = difflib.get_close_matches(full, _SECTIONS, n=1, cutoff=0.85)
    if near:
        raise ScenarioError(f"{where}: unknown section {section}; did you mean {near[0]}?")
    return None


def check(scenario: Scenario) -> None:
    """Whether the parts fit together.

    Raises
    ------
    ParameterError: an array whose length is not the task's, a task parameter that is not known or not allowed, a
        robot that the task cannot use.
    """
    task = scenario.loop.make_task()
    task.check_robot(scenario.loop.robot)
    scenario.task.make_plant(task)
    admittance.check(scenario.robot, scenario.loop.robot)
    mig_filter.costs(task, scenario.filter)
    for key, values, length, of in (
        ("control_limits", scenario.filter.control_limits, task.m, "controls"),
        ("noise_sd", scenario.user.noise_sd, task.m, "controls"),
        ("noise_clip", scenario.user.noise_clip, task.m, "controls"),
        ("initial_state", scenario.task.initial_state, task.n, "states"),
        ("initial_sd", scenario.task.initial_sd, task.n, "states"),
    ):
        if values and len(values) != length:
            raise ParameterError(f"{key}: {list(values)} is not allowed; {task.name} has {length} {of}")
    if any(limit == 0.0 for limit in scenario.filter.control_limits):
        raise ParameterError(
            f"control_limits: {list(scenario.filter.control_limits)} is not allowed; each must be positive"
        )
    if scenario.user.user in ("mpc", "graded", "human"):
        presets.get(task.name, scenario.user.preset)
        tasks.get(task.name, **tasks.parse(scenario.user.model_parameters))
    for key, horizon in (
        ("horizon", scenario.filter.horizon),
        ("controller_horizon", scenario.filter.controller_horizon or scenario.filter.horizon),
    ):
        if horizon < 0.5 * scenario.loop.sample_time or not math.isfinite(horizon):
            raise ParameterError(f"{key}: {horizon!r} is not allowed; it must be at least one sample_time [s]")
