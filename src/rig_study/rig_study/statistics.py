"""Comparisons of two samples, correlation, and the correction for asking more than once.

    correlation   r = cov(x, y) / (s_x s_y);  interval by Fisher: tanh(artanh r -+ z / sqrt(n - 3))
    paired        t = mean(x - y) / (sd(x - y) / sqrt(n)),  df = n - 1
    two samples   t = (mean x - mean y) / sqrt(s_x^2 / n_x + s_y^2 / n_y),  df by Welch

The distributions are scipy's. Effects d and their intervals: :mod:`rig_study.effect_sizes`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from rig_study.effect_sizes import noncentral_t

__all__ = ["Correlation", "StatisticsError", "TTest", "holm", "normality", "paired_t", "pearson", "two_sample_t"]


class StatisticsError(ValueError):
    """The data do not allow what is asked of them; the message names what is missing."""


class Correlation(NamedTuple):
    """r with its interval; n pairs."""

    r: float
    low: float
    high: float
    p: float
    n: int


class TTest(NamedTuple):
    """Difference of two means with its interval, and the effect d with its own."""

    difference: float  # [unit of the measure]
    low: float
    high: float
    t: float
    df: float
    p: float
    d: float
    d_low: float
    d_high: float
    mean: tuple[float, float]
    sd: tuple[float, float]
    n: tuple[int, int]


def _sample(values: ArrayLike, name: str, least: int) -> np.ndarray:
    x = np.asarray(values, dtype=float).ravel()
    bad = np.flatnonzero(~np.isfinite(x))
    if len(bad):
        raise StatisticsError(f"{name}: value {bad[0]} of {len(x)} is {x[bad[0]]}; leave out what was not measured")
    if len(x) < least:
        raise StatisticsError(f"{name}: {len(x)} values are too few; at least {least} are needed")
    return x


def pearson(x: ArrayLike, y: ArrayLike, confidence: float = 0.95) -> Correlation:
    """Product-moment correlation of pairs, two-sided.

    Raises
    ------
    StatisticsError: fewer than four pairs, not as many x as y, a number that is not finite, or one that never changes.
    """
    a, b = _sample(x, "x", 4), _sample(y, "y", 4)
    if len(a) != len(b):
        raise StatisticsError(f"{len(a)} values of x and {len(b)} of y are not pairs")
    for name, values in (("x", a), ("y", b)):
        if np.ptp(values) == 0.0:
            raise StatisticsError(f"{name}: all {len(values)} values are {values[0]:g}; there is nothing to correlate")
    found = stats.pearsonr(a, b)
    low, high = found.confidence_interval(confidence)
    return Correlation(float(found.statistic), float(low), float(high), float(found.pvalue), len(a))


def paired_t(x: ArrayLike, y: ArrayLike, confidence: float = 0.95) -> TTest:
    """x against y, pair by pair; d is d_av, its interval that of d_z on the scale of d_av.

    Raises
    ------
    StatisticsError: as :func:`pearson`, with two pairs at least; or pairs that all differ by the same.
    """
    a, b = _sample(x, "x", 2), _sample(y, "y", 2)
    if len(a) != len(b):
        raise StatisticsError(f"{len(a)} values of x and {len(b)} of y are not pairs")
    n, difference = len(a), a - b
    spread = float(np.std(difference, ddof=1))
    if spread == 0.0:
        raise StatisticsError(f"all {n} pairs differ by {difference[0]:g}; without spread there is no t")
    found = stats.ttest_rel(a, b)
    interval = found.confidence_interval(confidence)
    sd = (float(np.std(a, ddof=1)), float(np.std(b, ddof=1)))
    mean = float(np.mean(difference))
    scale = spread / (0.5 * sum(sd)) / math.sqrt(n)
    low, high = (scale * limit for limit in noncentral_t(float(found.statistic), n - 1, confidence))
    return TTest(
        mean, float(interval.low), float(interval.high), float(found.statistic), float(n - 1), float(found.pvalue),
        mean / (0.5 * sum(sd)), low, high, (float(np.mean(a)), float(np.mean(b))), sd, (n, n),
    )  # fmt: skip


def two_sample_t(x: ArrayLike, y: ArrayLike, confidence: float = 0.95, *, equal_variances: bool = False) -> TTest:
    """x against y, which are independent; Welch's t unless the variances are taken to be equal.

    d divides by the pooled deviation in either case, and its interval rests on the pooled t.

    Raises
    ------
    StatisticsError: fewer than two values in either, one that is not finite, or no spread at all.
    """
    a, b = _sample(x, "x", 2), _sample(y, "y", 2)
    sd = (float(np.std(a, ddof=1)), float(np.std(b, ddof=1)))
    n = (len(a), len(b))
    if max(sd) == 0.0:
        raise StatisticsError("neither sample has any spread; there is no t")
    with warnings.catch_warnings():
        if min(np.ptp(a), np.ptp(b)) == 0.0:
            # Values that are all the same lose no precision, of which scipy warns.
            warnings.filterwarnings("ignore", "Precision loss", RuntimeWarning)
        found = stats.ttest_ind(a, b, equal_var=equal_variances)
    interval = found.confidence_interval(confidence)
    mean = (float(np.mean(a)), float(np.mean(b)))
    df = sum(n) - 2
    pooled = math.sqrt(((n[0] - 1) * sd[0] ** 2 + (n[1] - 1) * sd[1] ** 2) / df)
    d, scale = (mean[0] - mean[1]) / pooled, math.sqrt(n[0] * n[1] / sum(n))
    low, high = (limit / scale for limit in noncentral_t(d * scale, df, confidence))
    return TTest(
        mean[0] - mean[1], float(interval.low), float(interval.high), float(found.statistic), float(found.df),
        float(found.pvalue), d, low, high, mean, sd, n,
    )  # fmt: skip


def holm(p: Sequence[float]) -> list[float]:
    """p-values corrected for their number, step down.

        p'_(i) = max_{j <= i} min(1, (m - j + 1) p_(j)),  p_(1) <= ... <= p_(m)

    Source: Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    if not len(p):
        return []
    from statsmodels.stats.multitest import multipletests

    return [float(value) for value in multipletests(p, method="holm")[1]]


def normality(values: ArrayLike) -> tuple[float, float]:
    """W and p of Shapiro and Wilk (Biometrika 52, 1965); (nan, nan) for fewer than three values or no spread."""
    x = np.asarray(values, dtype=float).ravel()
    if len(x) < 3 or np.ptp(x) == 0.0:
        return math.nan, math.nan
    found = stats.shapiro(x)
    return float(found.statistic), float(found.pvalue)
