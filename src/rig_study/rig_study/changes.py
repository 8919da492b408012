"""Changes to a scenario by dotted name: ``mig_filter.horizon``, ``user_sim.skill``, ``loop.duration``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from shared_control import scenario as science
from shared_control import yaml_text
from shared_control.admittance import AdmittanceConfig
from shared_control.filter import FilterConfig
from shared_control.parameters import ParameterError, build, declarations
from shared_control.scenario import LoopConfig, Scenario, ScenarioError, TaskConfig
from shared_control.users import UserConfig

__all__ = ["PARTS", "apply", "split", "value_from_text"]

#: The name of the node (``loop``: what they share), the part of the scenario, its declaration.
PARTS: dict[str, tuple[str, type[Any]]] = {
    "mig_filter": ("filter", FilterConfig),
    "admittance_sim": ("robot", AdmittanceConfig),
    "task_sim": ("task", TaskConfig),
    "user_sim": ("user", UserConfig),
    "loop": ("loop", LoopConfig),
}


def split(name: str, where: str) -> tuple[str, str]:
    """Node and key of a dotted name.

    Raises
    ------
    ScenarioError: no such node, or no dot.
    """
    node, dot, key = name.partition(".")
    if not dot or node not in PARTS:
        raise ScenarioError(f"{where}: {name}: write NODE.KEY with NODE one of {', '.join(PARTS)}")
    return node, key


def apply(scenario: Scenario, changes: Mapping[str, Any], where: str) -> Scenario:
    """The scenario with other values.

    Raises
    ------
    ParameterError: a name that is not known, a value that is refused, or parts that no longer fit together.
    """
    values: dict[str, dict[str, Any]] = {}
    for name, value in changes.items():
        node, key = split(name, where)
        values.setdefault(node, {})[key] = value
    for node, given in values.items():
        part, cls = PARTS[node]
        scenario = replace(scenario, **{part: build(cls, {**asdict(getattr(scenario, part)), **given}, where)})
    try:
        science.check(scenario)
    except ParameterError as error:
        raise ScenarioError(f"{where}: {error}") from None
    return scenario


def value_from_text(name: str, text: str, where: str) -> Any:
    """A value as a person writes it on a command line.

    Raises
    ------
    ScenarioError: as :func:`split`; or the text is no value.
    """
    node, key = split(name, where)
    # A word is a word: YAML would take a bare off for false.
    if any(known.name == key and known.kind == "str" for known in declarations(PARTS[node][1])):
        return text
    try:
        return yaml_text.parse(text, f"{where}: {name}")
    except ParameterError as error:
        raise ScenarioError(str(error)) from None
