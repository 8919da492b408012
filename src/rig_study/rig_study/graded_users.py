"""The claim that compares users with each other: who succeeds more alone is rejected less.

Thirty-two users between noise and purpose act without the filter, and a filter judges afterwards what they did.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rig_study.bounds import Bound, at_most
from rig_study.claims import FIRST_SEED, Claim, scenario
from rig_study.runs import Job
from shared_control import scenario as science

__all__ = ["CLAIM", "JUDGE", "WANTED", "figures", "jobs", "sentence"]

#: The scenario whose filter judges.
JUDGE = "cart_pendulum_noise_training"
#: The scenario in which they act, and for how many trials each.
CLAIM = Claim("cart_pendulum_noise_off", {"user_sim.user": "graded", "user_sim.preset": "learner"}, 10)
WANTED: tuple[Bound, ...] = (at_most("Spearman", -0.8),)

#: How much purpose, how late [s], how wrong about the pendulum's length [m].
_USERS = [
    (float(skill), delay, length)
    for skill, delay, length in zip(
        np.linspace(0.0, 1.0, 32), 8 * (0.0, 0.05, 0.1, 0.2), 4 * (2.0, 1.6, 2.4, 2.0, 3.0, 2.0, 1.2, 2.0), strict=True
    )
]


def jobs(seeds: int) -> list[Job]:
    """The first ``seeds`` trials of each user, or all."""
    judge, result = science.load(JUDGE), []
    for number, (skill, delay, length) in enumerate(_USERS):
        user = {
            "user_sim.skill": skill, "user_sim.delay": delay, "user_sim.model_parameters": [f"length={length}"],
        }  # fmt: skip
        loaded = scenario(CLAIM._replace(changes={**CLAIM.changes, **user}))
        for k in range(min(seeds, CLAIM.seeds)):
            name = f"cart/graded users/{number:02d}_t{k:06d}"
            result.append(Job(name, loaded, FIRST_SEED + 1000 * number + k, {"user": number}, judge=judge))
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
