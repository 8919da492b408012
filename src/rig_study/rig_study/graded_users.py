"""The claim that compares users with each other: who succeeds more alone is rejected less.

Users between noise and purpose act without the filter, and a filter judges afterwards what they did. There are two
populations: thirty-two on a grid, some of whom believe in a pendulum that is half as long again, and forty-eight drawn
at random, whose error about its length is at most 30 %.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from rig_study.bounds import Bound, at_most
from rig_study.claims import FIRST_SEED, Claim, scenario
from rig_study.runs import Job
from shared_control import scenario as science
from shared_control.streams import stream

__all__ = ["CLAIM", "JUDGE", "POPULATIONS", "WANTED", "User", "figures", "jobs", "sentence"]

#: The scenario whose filter judges.
JUDGE = "cart_pendulum_noise_training"
#: The scenario in which they act, and for how many trials each.
CLAIM = Claim("cart_pendulum_noise_off", {"user_sim.user": "graded", "user_sim.preset": "learner"}, 10)
WANTED: tuple[Bound, ...] = (at_most("Spearman", -0.8),)


class User(NamedTuple):
    """How much purpose, how late [s], how long the pendulum is believed to be [m] (it is 2 m long)."""

    skill: float
    delay: float
    length: float


def _grid() -> list[User]:
    delays, lengths = 8 * (0.0, 0.05, 0.1, 0.2), 4 * (2.0, 1.6, 2.4, 2.0, 3.0, 2.0, 1.2, 2.0)
    return [User(float(skill), *rest) for skill, *rest in zip(np.linspace(0.0, 1.0, 32), delays, lengths, strict=True)]


def _drawn() -> list[User]:
    draws = stream(FIRST_SEED, "graded users").uniform((0.0, 0.0, 1.4), (1.0, 0.2, 2.6), (48, 3))
    return [
        User(round(float(skill), 3), round(float(delay), 2), round(float(length), 2)) for skill, delay, length in draws
    ]


#: By the name of the claim.
POPULATIONS: dict[str, list[User]] = {"cart/graded users": _grid(), "cart/graded users drawn": _drawn()}


def jobs(population: str, seeds: int) -> list[Job]:
    """The first ``seeds`` trials of each user of a population, or all."""
    before = sum(len(POPULATIONS[name]) for name in itertools.takewhile(lambda name: name != population, POPULATIONS))
    result = []
    judge = science.load(JUDGE)
    for number, its in enumerate(POPULATIONS[population]):
        user = {
            "user_sim.skill": its.skill, "user_sim.delay": its.delay,
            "user_sim.model_parameters": [f"length={its.length}"],
        }  # fmt: skip
        loaded = scenario(CLAIM._replace(changes={**CLAIM.changes, **user}))
        for k in range(min(seeds, CLAIM.seeds)):
            seed = FIRST_SEED + 1000 * (before + number) + k
            result.append(Job(f"{population}/{number:02d}_t{k:06d}", loaded, seed, {"user": number}, judge=judge))
    return result


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Spearman's rank correlation of a user's success alone and of the share that would have been rejected."""
    from scipy.stats import spearmanr

    users = sorted({row["user"] for row in rows})
    success, rejected = (
        [float(np.mean([row[name] for row in rows if row["user"] == user])) for user in users]
        for name in ("success", "judged_pra")
    )
    return {
        "Spearman": float(spearmanr(success, rejected).statistic) if len(set(success)) > 1 else float("nan"),
        "users": len(users),
        "least success": min(success), "most success": max(success),
        "least rejected": min(rejected), "most rejected": max(rejected),
    }  # fmt: skip


def sentence(found: Mapping[str, float]) -> str:
    """The figures in words."""
    return (
        f"Spearman {found['Spearman']:.2f} over {found['users']} users; success alone {found['least success']:.2f} to "
        f"{found['most success']:.2f}, rejected {found['least rejected']:.3f} to {found['most rejected']:.3f}"
    )
