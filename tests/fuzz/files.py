"""Boundaries that are files and values: parameters, scenarios, studies, sweeps, bags, the pages' messages."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hand_written
import yaml
from fuzz.boundary import Boundary, refusal
from fuzz.garbage import Garbage

import rig_bag
from rig_bag.configuration import RecorderConfig
from rig_bag.mcap_audit import audit
from rig_bag.repair import repair
from rig_bringup import scenario as graph_scenario
from rig_display.parameters import DisplayConfig
from rig_display.protocol import _FIELDS, ProtocolError, parse
from rig_study.changes import PARTS, apply, value_from_text
from rig_study.cohort import CohortConfig, load_cohort
from rig_study.protocol import GroupConfig, SetConfig, StudyConfig, load_protocol
from rig_study.sweep import SweepConfig, load_sweep
from shared_control.admittance import AdmittanceConfig
from shared_control.filter import FilterConfig
from shared_control.parameters import ParameterError, build, declarations
from shared_control.scenario import LoopConfig, Scenario, TaskConfig
from shared_control.users import UserConfig
from task_sim_node.parameters import PacemakerConfig

ROOT = Path(__file__).resolve().parents[2]

_CONFIGURATIONS = (
    LoopConfig, FilterConfig, AdmittanceConfig, UserConfig, TaskConfig, RecorderConfig, DisplayConfig, PacemakerConfig,
    StudyConfig, GroupConfig, SetConfig, CohortConfig, SweepConfig,
)  # fmt: skip


class Parameters(Boundary):
    """Values for the declared parameters of every configuration; and how the parts of a scenario fit together."""

    name = "parameters"
    share = 22.0

    def send(self, garbage: Garbage) -> str:
        if garbage.maybe(0.3):
            return self._changed(garbage)
        cls = garbage.choice(_CONFIGURATIONS)
        known = list(declarations(cls))
        values = {}
        for _ in range(garbage.randint(1, 3)):
            declared = garbage.choice(known)
            values[declared.name if garbage.maybe(0.9) else garbage.text()] = likely(garbage, declared)
        return refusal(lambda: build(cls, values, "somewhere"), ParameterError, ["somewhere"])

    def _changed(self, garbage: Garbage) -> str:
        node, (_, cls) = garbage.choice(list(PARTS.items()))
        declared = garbage.choice(list(declarations(cls)))
        name = f"{node}.{declared.name}" if garbage.maybe(0.9) else garbage.text()
        if garbage.maybe(0.5):
            return refusal(lambda: value_from_text(name, garbage.bent_text("[1.0, a]"), "somewhere"), ParameterError)
        changes = {name: likely(garbage, declared), "loop.task": garbage.choice(("slip", "cart_pendulum"))}
        return refusal(lambda: apply(Scenario(), changes, "somewhere"), ParameterError)


def likely(garbage: Garbage, declared: Any) -> Any:
    """A value that often has the declared type."""
    if garbage.maybe(0.3):
        return garbage.value()
    if declared.choices is not None and garbage.maybe(0.7):
        word = garbage.choice(declared.choices)
        return [word] * garbage.randrange(4) if declared.is_array else word
    if declared.is_array:
        return [garbage.number() if garbage.maybe(0.9) else garbage.value() for _ in range(garbage.randrange(6))]
    return garbage.text() if declared.kind == "str" else garbage.number()


class _Files(Boundary):
    """Files of one kind, each made from a shipped one."""

    kind = ""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._texts = [path.read_text() for path in sorted((ROOT / "config" / self.kind).glob("*.yaml"))]
        self._trees = [yaml.safe_load(text) for text in self._texts]
        self._path = folder / f"{self.kind or 'scenario'}-fuzzed.yaml"

    def send(self, garbage: Garbage) -> str:
        kind = garbage.randrange(10)
        number = garbage.randrange(len(self._texts))
        if kind == 0:
            self._path.write_bytes(garbage.bent_bytes(self._texts[number].encode()))
        elif kind < 5:
            self._path.write_text(garbage.bent_text(self._texts[number]), encoding="utf-8")
        else:
            self._path.write_text(_yaml_of(garbage.bent_tree(self._trees[number])), encoding="utf-8")
        return refusal(self.read, ParameterError, [self._path.name])

    def read(self) -> None:
        """Read the file, and do with it what is done with every such file."""
        raise NotImplementedError


def _yaml_of(tree: Any) -> str:
    # Python does not write out very long integers in decimal.
    return yaml.safe_dump(json.loads(json.dumps(tree, default=str), parse_int=_short))


def _short(digits: str) -> Any:
    return int(digits) if len(digits) < 4000 else digits


class Scenarios(_Files):
    """Scenario files, as `./rig up` reads them."""

    name = "scenario files"
    share = 5.0

    def read(self) -> None:
        graph_scenario.load(str(self._path), {}, person=True).digest()


class Protocols(_Files):
    """Protocol files, planned for their first subject."""

    name, kind = "protocol files", "protocols"
    share = 6.0

    def read(self) -> None:
        protocol = load_protocol(self._path)
        first = protocol.plan(next(iter(protocol.subjects)))[0]
        protocol.scenario(first)


class Cohorts(_Files):
    """Cohort files, with a subject drawn."""

    name, kind = "cohort files", "cohorts"
    share = 7.0

    def read(self) -> None:
        cohort = load_cohort(self._path)
        cohort.user(cohort.subject("S01"), 3.0, 5)


class Sweeps(_Files):
    """Sweep files, their grid laid out."""

    name, kind = "sweep files", "sweeps"
    share = 5.0

    def read(self) -> None:
        load_sweep(self._path)


class Bags(Boundary):
    """Damaged bags: audited, read, and repaired."""

    name = "bags"
    share = 10.0

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        whole = hand_written.write(folder / "whole", 12)
        self._data = (whole / "whole_0.mcap").read_bytes()
        self._metadata = (whole / "metadata.yaml").read_bytes()
        self._bag = folder / "bag"
        self._bag.mkdir()

    def send(self, garbage: Garbage) -> str:
        data, metadata = self._data, self._metadata
        if garbage.maybe(0.8):
            data = garbage.bent_bytes(data)
        else:
            metadata = garbage.bent_text(metadata.decode()).encode()
        audit(data, "it")
        (self._bag / "whole_0.mcap").write_bytes(data)
        (self._bag / "metadata.yaml").write_bytes(metadata)
        if garbage.maybe(0.1):
            out = self.folder / "repaired"
            shutil.rmtree(out, ignore_errors=True)
            return refusal(lambda: repair(self._bag, out), rig_bag.BagError)
        return refusal(lambda: (rig_bag.info(self._bag), rig_bag.read(self._bag)), rig_bag.BagError)


class PageMessages(Boundary):
    """What a page may say, as text."""

    name = "page messages"
    share = 17.0

    def send(self, garbage: Garbage) -> str:
        return refusal(lambda: parse(page_message(garbage)), ProtocolError)


_GOOD: dict[str, Callable[[Garbage], Any]] = {
    "reason": lambda g: g.choice(("hidden", "leaving")),
    "mode": lambda g: g.choice(("off", "training")),
    "do": lambda g: g.choice(("pause", "repeat")),
    "on": lambda g: g.maybe(0.5),
    "trial": lambda g: g.randrange(9),
}
_TEXTS = ("subject", "group", "set")


def page_message(garbage: Garbage) -> str:
    """A text that a page could have sent, or nearly."""
    kind = garbage.choice(list(_FIELDS))
    message: dict[str, Any] = {"type": kind}
    for field in _FIELDS[kind]:
        good = "s" if field in _TEXTS else _GOOD.get(field, lambda g: g.uniform(0.0, 60.0))(garbage)
        message[field] = garbage.value() if garbage.maybe(0.15) else good
    if garbage.maybe(0.2):
        message = garbage.bent_tree(message)
    text = json.dumps(json.loads(json.dumps(message, default=str), parse_int=_short))
    return garbage.bent_text(text) if garbage.maybe(0.2) else text
