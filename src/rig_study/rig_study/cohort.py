"""Virtual subjects: simulated users with their own skill, who learn at their own pace.

Subject i begins with skill s_i, would reach c_i, and has had practice P when a trial begins:

    skill = c_i - (c_i - s_i) exp(-P / L_i) + e,   e ~ N(0, trial_sd^2) for each trial, kept within 0 and 1
    P     = trials without filter + filtered_practice * trials with it

s_i, c_i and L_i are normal over subjects, cut off at 0 and 1 (L at 1 trial). ``filtered_practice: 1`` is a null cohort:
the groups learn alike; more than 1 plants an effect of training. The exponential is that of Heathcote, Brown, Mewhort,
Psychonomic Bulletin & Review 7, 2000. What skill means to a user: :mod:`shared_control.users`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rig_study.declared import DeclaredFile, load, section
from rig_study.protocol import PlannedTrial, Protocol
from rig_study.runs import Job
from shared_control import scenario as science
from shared_control.parameters import parameter
from shared_control.streams import stream
from shared_control.users import UserConfig, presets

__all__ = ["Cohort", "CohortConfig", "Subject", "jobs", "load_cohort"]


@dataclass(frozen=True)
class CohortConfig:
    """The population that subjects are drawn from."""

    user: str = parameter("graded", "Which simulated user.", choices=("graded", "human"))
    preset: str = parameter("", "What the users want; empty: the task's first.", choices=("", *presets.names()))
    seed: int = parameter(0, "The subjects derive from it.", ge=0, le=2**63 - 1)
    skill_mean: float = parameter(0.3, "Mean of the skill at the start.", ge=0.0, le=1.0)
    skill_sd: float = parameter(0.1, "Its standard deviation over subjects.", ge=0.0, le=1.0)
    ceiling_mean: float = parameter(0.6, "Mean of the skill that practice leads to.", ge=0.0, le=1.0)
    ceiling_sd: float = parameter(0.1, "Its standard deviation over subjects.", ge=0.0, le=1.0)
    pace_mean: float = parameter(
        40.0, "Mean of L, the practice after which 1/e is left to learn.", unit="trials", ge=1.0, le=1e6
    )
    pace_sd: float = parameter(10.0, "Its standard deviation over subjects.", unit="trials", ge=0.0, le=1e6)
    trial_sd: float = parameter(0.0, "Standard deviation of the skill from trial to trial.", ge=0.0, le=1.0)
    filtered_practice: float = parameter(
        1.0, "Practice that a trial with filter is worth, in trials without.", unit="trials", ge=0.0, le=100.0
    )
    delay: float = parameter(0.0, "From seeing to acting, for graded users.", unit="s", ge=0.0, le=2.0)
    replan: int = parameter(1, "Ticks from plan to plan; in between the user follows the last.", ge=1, le=1000)
    noise_sd: tuple[float, ...] = parameter(
        (), "Noise of users without skill, for each control; empty: the task's.", unit="of the control", ge=0.0
    )
    noise_hold: int = parameter(1, "Ticks for which one sample of it is held.", ge=1, le=100000)


class Subject(NamedTuple):
    """One virtual subject."""

    skill: float
    ceiling: float
    pace: float  # [trials]

    def at(self, practice: float) -> float:
        """Skill after practice [trials], before what a trial adds to it."""
        return self.ceiling - (self.ceiling - self.skill) * math.exp(-practice / self.pace)


@dataclass(frozen=True)
class Cohort:
    """A checked cohort."""

    file: DeclaredFile
    config: CohortConfig

    def subject(self, name: str) -> Subject:
        """The subject of this name; depends on the cohort's seed and the name alone."""
        c = self.config
        skill, ceiling, pace = stream(c.seed, f"subject {name}").standard_normal(3)
        return Subject(
            skill=float(np.clip(c.skill_mean + c.skill_sd * skill, 0.0, 1.0)),
            ceiling=float(np.clip(c.ceiling_mean + c.ceiling_sd * ceiling, 0.0, 1.0)),
            pace=float(max(1.0, c.pace_mean + c.pace_sd * pace)),
        )

    def user(self, subject: Subject, practice: float, seed: int) -> UserConfig:
        """The simulated user of one trial."""
        c = self.config
        skill = subject.at(practice) + c.trial_sd * stream(seed, "skill").standard_normal()
        return UserConfig(
            user=c.user, preset=c.preset, skill=float(np.clip(skill, 0.0, 1.0)), delay=c.delay, replan=c.replan,
            noise_sd=c.noise_sd, noise_hold=c.noise_hold,
        )  # fmt: skip

    def users(self, protocol: Protocol, subject: str) -> Callable[[PlannedTrial], UserConfig]:
        """Who stands in a subject's place, trial by trial: practice is that of the trials before it in the plan."""
        own, practice, before = self.subject(subject), 0.0, dict[int, float]()
        for planned in protocol.plan(subject):
            before[planned.position] = practice
            practice += 1.0 if planned.mode == "off" else self.config.filtered_practice
        return lambda trial: self.user(own, before[trial.position], trial.seed)


def load_cohort(name: str | os.PathLike[str]) -> Cohort:
    """From a path, or a name under ``config/cohorts``.

    Raises
    ------
    StudyError: as :func:`rig_study.declared.load`.
    """
    file = load("cohorts", name, ("cohort",))
    return Cohort(file, section(file, "cohort", CohortConfig))


def jobs(protocol: Protocol, cohort: Cohort) -> list[Job]:
    """Every trial of a protocol, with a virtual subject in the place of each person.

    Raises
    ------
    ParameterError: the cohort's users do not fit the protocol's task.
    """
    result = []
    for name in protocol.subjects:
        user_of = cohort.users(protocol, name)
        for trial in protocol.plan(name):
            user = user_of(trial)
            scenario = replace(protocol.scenario(trial), user=user)
            if not result:
                science.check(scenario)
            result.append(Job(trial.name, scenario, trial.seed, {**labels(trial), "skill": user.skill}))
    return result


def labels(trial: PlannedTrial) -> dict[str, object]:
    """The columns that say which trial it is."""
    return {
        "subject": trial.subject,
        "group": trial.group,
        "set": trial.set,
        "trial": trial.trial,
        "position": trial.position,
        "mode": trial.mode,
    }
