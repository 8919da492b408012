"""Null cohorts: how often the interaction of group and set is found where there is none, by the whole analysis.

Each cohort is 28 subjects in groups of 10 and 18 whose successes in thirty trials of sets 1 and 3 are binomial, with a
chance of each subject's own that rises alike in both groups; what is tested is the success rate, which is not normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import stats

from rig_study.statistics_anova import Cells, mixed_anova

__all__ = ["FalsePositives", "false_positives"]


class FalsePositives(NamedTuple):
    """How often it was found, with the exact binomial interval of the rate (Clopper, Pearson, Biometrika 26, 1934)."""

    found: int
    cohorts: int
    low: float
    high: float


def false_positives(cohorts: int, *, alpha: float = 0.05, seed: int = 0) -> FalsePositives:
    """Over ``cohorts`` null cohorts, at level ``alpha``."""
    random = np.random.default_rng(seed)
    groups = np.array(["control"] * 10 + ["training"] * 18)
    subjects, sets = tuple(f"S{k:02d}" for k in range(1, 29)), ("set1", "set3")
    found = 0
    for _ in range(cohorts):
        chance = random.beta(2.0, 12.0, (28, 1)) + random.uniform(0.0, 0.3, (28, 1)) * np.array([0.0, 1.0])
        values = random.binomial(30, chance) / 30.0
        found += int(mixed_anova(Cells(values, groups, subjects, sets)).effect("interaction").p < alpha)
    interval = stats.binomtest(found, cohorts).proportion_ci()
    return FalsePositives(found, cohorts, float(interval.low), float(interval.high))
