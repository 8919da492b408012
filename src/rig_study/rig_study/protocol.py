"""The protocol of a study as data: who does which trials, in which order, under which filter.

A protocol file has three sections: ``study``, ``groups`` and ``sets`` (:class:`StudyConfig`, :class:`GroupConfig`,
:class:`SetConfig`). A subject's plan follows from the file alone: the same file gives the same groups, orders and
seeds, for a simulation as for a session with people.

A trial has a name that is its own for ever: protocol, beginning of the hash of its text, subject, set, trial, attempt.
A trial that is repeated is another attempt, with another name and another seed.
"""

from __future__ import annotations

import hashlib
import math
import os
from dataclasses import dataclass, replace
from functools import reduce

from rig_study.declared import DeclaredFile, StudyError, base_scenario, load, section, sections
from shared_control.parameters import parameter
from shared_control.scenario import Scenario
from shared_control.streams import stream

__all__ = ["GroupConfig", "PlannedTrial", "Protocol", "SetConfig", "StudyConfig", "load_protocol"]


@dataclass(frozen=True)
class StudyConfig:
    """What all trials share."""

    title: str = parameter("", "One line for reports.")
    scenario: str = parameter("cart_pendulum_study", "Scenario with the settings of task, filter and robot.")
    seed: int = parameter(0, "Groups, orders and the seed of each trial derive from it.", ge=0, le=2**63 - 1)
    duration: float = parameter(30.0, "Length of a trial.", unit="s", ge=0.01, le=3600.0)
    allocation: str = parameter(
        "blocks",
        "How subjects are put into groups. blocks: at random within blocks that keep the ratio of the groups; random: "
        "at random over all.",
        choices=("blocks", "random"),
    )
    set_order: str = parameter(
        "fixed",
        "fixed: as listed; balanced: by the rows of a balanced Latin square, in turn within each group, so that each "
        "set comes equally often at each place and after each other set.",
        choices=("fixed", "balanced"),
    )
    instructions: str = parameter("", "Shown before the first set.")


@dataclass(frozen=True)
class GroupConfig:
    """One group."""

    subjects: int = parameter(1, "Its size.", ge=1, le=10000)
    modes: tuple[str, ...] = parameter(
        (), "Mode of the filter in each set, in the order of the file.", choices=("off", "training", "assistance")
    )


@dataclass(frozen=True)
class SetConfig:
    """One set."""

    trials: int = parameter(1, "Number of trials.", ge=1, le=10000)
    break_before: float = parameter(0.0, "Rest before the set.", unit="s", ge=0.0, le=86400.0)
    break_between: float = parameter(0.0, "Rest between its trials.", unit="s", ge=0.0, le=3600.0)
    instructions: str = parameter("", "Shown before the set.")


@dataclass(frozen=True)
class PlannedTrial:
    """One trial of one subject."""

    study: str  # name and hash of the protocol
    subject: str
    group: str
    set: str
    trial: int  # in its set, from 1
    position: int  # in the session, from 1
    mode: str
    break_before: float  # [s]
    study_seed: int
    attempt: int = 1

    @property
    def name(self) -> str:
        """Unique for ever; fit for the name of a file."""
        return f"{self.study}_{self.subject}_{self.set}_{self.trial:03d}_a{self.attempt}"

    @property
    def seed(self) -> int:
        """Of every random stream of the trial; in [0, 2^63)."""
        digest = hashlib.sha256(f"{self.study_seed}/{self.name.removeprefix(self.study)}".encode()).digest()
        return int.from_bytes(digest[:8], "big") >> 1

    def again(self) -> PlannedTrial:
        """The same trial, to be repeated."""
        return replace(self, attempt=self.attempt + 1)


@dataclass(frozen=True)
class Protocol:
    """A checked protocol."""

    file: DeclaredFile
    study: StudyConfig
    groups: dict[str, GroupConfig]
    sets: dict[str, SetConfig]
    base: Scenario

    @property
    def name(self) -> str:
        """Name and beginning of the hash, as in the names of trials."""
        return f"{self.file.path.stem}-{self.file.sha256[:6]}"

    @property
    def subjects(self) -> dict[str, str]:
        """Group of each subject, in the order of enrolment."""
        sizes = {name: group.subjects for name, group in self.groups.items()}
        total = sum(sizes.values())
        blocks = reduce(math.gcd, sizes.values()) if self.study.allocation == "blocks" else 1
        random = stream(self.study.seed, "allocation")
        order: list[str] = []
        for _ in range(blocks):
            block = [name for name, size in sizes.items() for _ in range(size // blocks)]
            order += [block[index] for index in random.permutation(len(block))]
        width = max(2, len(str(total)))
        return {f"S{number:0{width}d}": group for number, group in enumerate(order, 1)}

    def instructions(self, trial: PlannedTrial) -> str:
        """What a subject reads before this trial: the study's before the first set, each set's before it."""
        if trial.trial != 1:
            return ""
        texts = (self.study.instructions if trial.position == 1 else "", self.sets[trial.set].instructions)
        return " ".join(text.strip() for text in texts if text.strip())

    def plan(self, subject: str) -> tuple[PlannedTrial, ...]:
        """A subject's trials, in order.

        Raises
        ------
        StudyError: there is no such subject.
        """
        groups = self.subjects
        if subject not in groups:
            raise StudyError(f"subject {subject!r} is not in {self.name}; it has {', '.join(groups)}")
        group = groups[subject]
        modes = dict(zip(self.sets, self.groups[group].modes, strict=True))
        planned: list[PlannedTrial] = []
        for set_ in self._order(subject, groups):
            config = self.sets[set_]
            for trial in range(1, config.trials + 1):
                rest = config.break_before if trial == 1 else config.break_between
                planned.append(
                    PlannedTrial(
                        self.name, subject, group, set_, trial, len(planned) + 1, modes[set_], rest, self.study.seed
                    )
                )
        return tuple(planned)

    def trials(self) -> tuple[PlannedTrial, ...]:
        """All trials of all subjects."""
        return tuple(trial for subject in self.subjects for trial in self.plan(subject))

    def scenario(self, trial: PlannedTrial) -> Scenario:
        """What a trial runs with; the user is the scenario's own."""
        loop = replace(self.base.loop, seed=trial.seed, duration=self.study.duration)
        return replace(self.base, loop=loop, filter=replace(self.base.filter, mode=trial.mode))

    def session_length(self, subject: str) -> float:
        """Trials and breaks of a subject [s]."""
        return sum(self.study.duration + trial.break_before for trial in self.plan(subject))

    def _order(self, subject: str, groups: dict[str, str]) -> list[str]:
        names = list(self.sets)
        if self.study.set_order == "fixed":
            return names
        peers = [name for name, group in groups.items() if group == groups[subject]]
        rows = balanced_square(len(names))
        return [names[index] for index in rows[peers.index(subject) % len(rows)]]


def balanced_square(size: int) -> list[list[int]]:
    """Rows in which each of ``size`` comes equally often at each place and right after each other one.

    Source: Williams, Australian Journal of Scientific Research A 2, 1949; for an odd size the rows are followed by
    their mirror images.
    """
    first = [0]
    for step in range(1, size):
        first.append((size - step // 2) % size if step % 2 == 0 else (step + 1) // 2)
    rows = [[(place + shift) % size for place in first] for shift in range(size)]
    return rows + [row[::-1] for row in rows] if size % 2 else rows


def load_protocol(name: str | os.PathLike[str]) -> Protocol:
    """From a path, or a name under ``config/protocols``.

    Raises
    ------
    StudyError: as :func:`rig_study.declared.load`; a group whose modes are not as many as the sets; a name that a file
        could not carry; a scenario that is not there or not allowed.
    """
    file = load("protocols", name, ("study", "groups", "sets"))
    study = section(file, "study", StudyConfig)
    groups, sets = sections(file, "groups", GroupConfig), sections(file, "sets", SetConfig)
    for kind, names in (("groups", groups), ("sets", sets)):
        for part in names:
            if not part.replace("-", "").isalnum():
                raise StudyError(f"{file.path}: {kind}.{part}: a name may hold letters, digits and -, no other sign")
    for part, group in groups.items():
        if len(group.modes) != len(sets):
            raise StudyError(
                f"{file.path}: groups.{part}: modes: {list(group.modes)} is not allowed; it must be "
                f"{len(sets)} modes, one for each of {', '.join(sets)}"
            )
    return Protocol(file, study, groups, sets, base_scenario(file, study.scenario, "study"))
