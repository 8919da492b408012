"""How many subjects a study needs: the test of the interaction of group and set, over cohorts drawn from a pilot.

With two sets the interaction of a mixed analysis of variance is the t test of the subjects' changes c_i = y_i,after -
y_i,before between two groups (F = t^2), so a cohort is drawn as changes: n_g of each group's, with replacement, from a
pilot, recorded or simulated. A wanted effect d replaces the pilot's own: changes less their group's mean, drawn from
all groups alike, and d pooled standard deviations between the groups; d = 0 is the null cohort, whose rate of rejection
is the test's false-positive rate. Rates have exact binomial intervals (Clopper, Pearson, Biometrika 26, 1934).
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats

from rig_study.declared import StudyError
from rig_study.statistics_anova import Cells
from shared_control.streams import stream

__all__ = ["Needed", "Power", "changes", "needed", "power", "sizes_for"]

Array = npt.NDArray[np.float64]


class Power(NamedTuple):
    """Share of cohorts in which the interaction was found."""

    subjects: int
    sizes: tuple[int, int]
    found: int
    cohorts: int
    rate: float
    low: float
    high: float


class Needed(NamedTuple):
    """The fewest subjects with which the interaction is found as often as is wanted.

    At ``subjects`` the rate reaches it, at ``low`` the upper end of the rate's interval, at ``high`` the lower end.
    """

    subjects: int
    low: int
    high: int


def changes(data: Cells) -> dict[str, Array]:
    """From the first to the second set, for each subject, by group.

    Raises
    ------
    StudyError: not two sets and two groups.
    """
    names = np.unique(data.groups)
    if data.values.shape[1] != 2 or len(names) != 2:
        raise StudyError(f"power is of two sets and two groups; there are {data.values.shape[1]} and {len(names)}")
    change = data.values[:, 1] - data.values[:, 0]
    return {str(name): change[data.groups == name] for name in names}


def sizes_for(total: int, ratio: Sequence[int]) -> tuple[int, int]:
    """``total`` subjects in two groups, in a ratio as near to the one given as it goes.

    Raises
    ------
    StudyError: too few for two in each group.
    """
    first = round(total * ratio[0] / sum(ratio))
    first = min(max(first, 2), total - 2)
    if total < 4:
        raise StudyError(f"subjects: {total} is not allowed; it must be at least 4, two in each group")
    return first, total - first


def power(
    pilot: Mapping[str, Array],
    totals: Sequence[int],
    *,
    effect: float | None = None,
    cohorts: int = 2000,
    alpha: float = 0.05,
    seed: int = 0,
    confidence: float = 0.95,
) -> list[Power]:
    """For each number of subjects, how often cohorts show the interaction at level ``alpha``.

    Parameters
    ----------
    pilot: changes by group, two of them.
    effect: d between the groups; the pilot's own difference if left out.

    Raises
    ------
    StudyError: fewer than two subjects in a group of the pilot, or changes without any spread.
    """
    if cohorts < 1 or not 0.0 < alpha < 1.0:
        raise StudyError(f"cohorts {cohorts}, alpha {alpha}: there must be one cohort or more, and 0 < alpha < 1")
    groups = list(pilot.values())
    if len(groups) != 2 or min(len(group) for group in groups) < 2:
        raise StudyError(
            f"a pilot of {[len(group) for group in groups]} subjects is too small; two in each group at least"
        )
    spread = float(np.sqrt(sum(np.sum((g - g.mean()) ** 2) for g in groups) / (sum(map(len, groups)) - 2)))
    if spread == 0.0:
        raise StudyError("all subjects of the pilot change alike; there is no spread to draw from")
    ratio = [len(group) for group in groups]
    if effect is not None:
        pool = np.concatenate([group - group.mean() for group in groups])
        groups = [pool, pool + effect * spread]
    result = []
    for total in totals:
        random = stream(seed, f"power {total}")
        sizes = sizes_for(total, ratio)
        drawn: list[Any] = [random.choice(g, (cohorts, n)) for g, n in zip(groups, sizes, strict=True)]
        with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
            # Among few, one subject can be drawn so often that there is next to no spread.
            warnings.simplefilter("ignore", RuntimeWarning)
            p = stats.ttest_ind(*drawn, axis=1).pvalue
        found = int(np.sum(p < alpha))
        low, high = stats.binomtest(found, cohorts).proportion_ci(confidence)
        result.append(Power(total, sizes, found, cohorts, found / cohorts, float(low), float(high)))
    return result


def needed(pilot: Mapping[str, Array], wanted: float = 0.8, *, most: int = 2000, **options: Any) -> Needed | None:
    """How many subjects it takes, by bisection: more subjects find more. None if ``most`` do not suffice.

    Parameters
    ----------
    wanted: rate.
    most: subjects at which the search ends.
    options: of :func:`power`.

    Raises
    ------
    StudyError: as :func:`power`; or not a rate between 0 and 1.
    """
    if not 0.0 < wanted < 1.0:
        raise StudyError(f"power: {wanted} is not allowed; it must be between 0 and 1")

    @functools.cache
    def at(subjects: int) -> Power:
        return power(pilot, [subjects], **options)[0]

    def fewest(end: Callable[[Power], float]) -> int | None:
        few, enough = 3, 4
        while end(at(enough)) < wanted:
            if enough == most:
                return None
            few, enough = enough, min(2 * enough, most)
        while enough - few > 1:
            between = (few + enough) // 2
            few, enough = (few, between) if end(at(between)) >= wanted else (between, enough)
        return enough

    found = fewest(lambda p: p.rate), fewest(lambda p: p.high), fewest(lambda p: p.low)
    return None if None in found else Needed(*map(int, found))
