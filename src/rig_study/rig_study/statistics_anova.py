"""Analysis of variance of a study: subjects in groups, each measured in every set.

With y_ij of subject i (in group g(i), n_g subjects) in set j, N subjects, k sets, and means over what a dot stands for,

    SS_group       = k sum_g n_g (y_g. - y_..)^2                       df = G - 1
    SS_subjects    = k sum_i (y_i. - y_g(i).)^2                        df = N - G      error of group
    SS_set         = N sum_j (y_.j - y_..)^2                           df = k - 1
    SS_interaction = sum_gj n_g (y_gj - y_g. - y_.j + y_..)^2          df = (G-1)(k-1)
    SS_residual    = sum_ij (y_ij - y_i. - y_g(i)j + y_g(i).)^2        df = (N-G)(k-1) error of set and interaction

Means over groups weigh each subject alike, so with groups of unequal size the effect of set is that of type II.
The factorial form takes every y_ij for an independent observation; the paper reported its success rate so. Its error is
SS_subjects + SS_residual and its df = (N - G) k. Source: Winer, Statistical Principles in Experimental Design, 1971.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats

from rig_study.statistics import StatisticsError, normality

__all__ = ["Anova", "Cells", "Effect", "cells", "factorial_anova", "mixed_anova"]

Array = npt.NDArray[np.float64]


class Cells(NamedTuple):
    """A complete table."""

    values: Array  # (N, k)
    groups: npt.NDArray[np.str_]  # (N,)
    subjects: tuple[str, ...]
    sets: tuple[str, ...]


class Effect(NamedTuple):
    """One row of the analysis."""

    effect: str
    ss: float
    df: float
    error_df: float
    f: float
    p: float
    eta: float  # partial eta squared; its interval: :func:`rig_study.effect_sizes.eta_interval`


class Anova(NamedTuple):
    """The rows group, set, interaction; then what may be said against them."""

    effects: tuple[Effect, ...]
    normality: tuple[float, float]  # W, p of the residuals
    sphericity: tuple[float, float]  # W, p of Mauchly; nan for two sets, which have none to lose
    epsilon: float  # Greenhouse and Geisser; df of set and interaction times this, where sphericity fails

    def effect(self, name: str) -> Effect:
        """The row of this name."""
        return next(row for row in self.effects if row.effect == name)


def cells(table: Any, measure: str, sets: Sequence[str]) -> Cells:
    """One value for each subject and set, from a table with the columns subject, group, set and the measure.

    Raises
    ------
    StatisticsError: a cell is missing, is there twice, or is not a number; a subject is in two groups; there are fewer
        than two groups, or fewer than two subjects in one. The message names cells, subjects, groups.
    """
    there: dict[tuple[str, str], float] = {}
    group_of: dict[str, str] = {}
    chosen = table[table["set"].isin(list(sets))]
    for subject, group, set_, value in zip(
        chosen["subject"], chosen["group"], chosen["set"], chosen[measure], strict=True
    ):
        if group_of.setdefault(subject, group) != group:
            raise StatisticsError(f"subject {subject} is in two groups, {group_of[subject]} and {group}")
        if (subject, set_) in there:
            raise StatisticsError(f"{measure}: subject {subject} has set {set_} twice; one value for each is wanted")
        there[subject, set_] = float(value)
    subjects = tuple(sorted(group_of))
    missing = [
        f"subject {subject} (group {group_of[subject]}), set {set_}"
        for subject in subjects
        for set_ in sets
        if not np.isfinite(there.get((subject, set_), np.nan))
    ]
    if missing:
        raise StatisticsError(
            f"{measure}: {len(missing)} cells are missing: {'; '.join(missing)}; measure them or leave these out"
        )
    groups = np.array([group_of[subject] for subject in subjects], dtype=str)
    names, sizes = np.unique(groups, return_counts=True)
    if len(names) < 2 or len(sets) < 2:
        raise StatisticsError(
            f"{measure}: groups {', '.join(names) or 'none'} and sets {', '.join(sets)}; two of each are needed"
        )
    for name, size in zip(names, sizes, strict=True):
        if size < 2:
            raise StatisticsError(f"{measure}: group {name} has {size} subject; at least two are needed")
    values = np.array([[there[subject, set_] for set_ in sets] for subject in subjects])
    return Cells(values, groups, subjects, tuple(sets))


class _Sums(NamedTuple):
    group: float
    subjects: float
    set: float
    interaction: float
    residual: float
    residuals: Array  # (N, k)


def _sums(y: Array, groups: npt.NDArray[Any]) -> _Sums:
    k, grand, by_set, by_subject = y.shape[1], y.mean(), y.mean(axis=0), y.mean(axis=1)
    in_group = np.empty_like(y)
    for group in np.unique(groups):
        mine = groups == group
        in_group[mine] = y[mine].mean(axis=0)
    of_group = in_group.mean(axis=1)
    residuals = y - by_subject[:, None] - in_group + of_group[:, None]
    return _Sums(
        group=float(k * np.sum((of_group - grand) ** 2)),
        subjects=float(k * np.sum((by_subject - of_group) ** 2)),
        set=float(len(y) * np.sum((by_set - grand) ** 2)),
        interaction=float(np.sum((in_group - of_group[:, None] - by_set + grand) ** 2)),
        residual=float(np.sum(residuals**2)),
        residuals=residuals,
    )


def _effect(name: str, ss: float, df: int, error: float, error_df: int) -> Effect:
    if error <= 0.0:
        raise StatisticsError(f"effect of {name}: the error has no spread; there is no F")
    f = (ss / df) / (error / error_df)
    return Effect(name, ss, df, error_df, f, float(stats.f.sf(f, df, error_df)), ss / (ss + error))


def mixed_anova(data: Cells) -> Anova:
    """Group between subjects, set within them.

    Raises
    ------
    StatisticsError: no spread in an error term.
    """
    y = data.values
    n, k, g = len(y), y.shape[1], len(np.unique(data.groups))
    s = _sums(y, data.groups)
    return Anova(
        effects=(
            _effect("group", s.group, g - 1, s.subjects, n - g),
            _effect("set", s.set, k - 1, s.residual, (n - g) * (k - 1)),
            _effect("interaction", s.interaction, (g - 1) * (k - 1), s.residual, (n - g) * (k - 1)),
        ),
        normality=normality(s.residuals[:, 1:]),
        sphericity=_mauchly(y, data.groups),
        epsilon=_epsilon(y, data.groups),
    )


def factorial_anova(data: Cells) -> Anova:
    """Group and set, every value taken for independent of every other.

    Raises
    ------
    StatisticsError: no spread in the error.
    """
    y = data.values
    n, k, g = len(y), y.shape[1], len(np.unique(data.groups))
    s = _sums(y, data.groups)
    error, df = s.subjects + s.residual, (n - g) * k
    cells_of = [y[data.groups == group] for group in np.unique(data.groups)]
    in_cell = np.concatenate([values - values.mean(axis=0) for values in cells_of])
    return Anova(
        effects=(
            _effect("group", s.group, g - 1, error, df),
            _effect("set", s.set, k - 1, error, df),
            _effect("interaction", s.interaction, (g - 1) * (k - 1), error, df),
        ),
        normality=normality(in_cell),
        sphericity=(float("nan"), float("nan")),
        epsilon=1.0,
    )


def _contrast_covariance(y: Array, groups: npt.NDArray[Any]) -> tuple[Array, int]:
    """Covariance (k-1, k-1) of orthonormal contrasts of the sets, pooled within groups, and its df."""
    k = y.shape[1]
    basis = np.linalg.qr(np.column_stack([np.ones(k), np.eye(k)[:, : k - 1]]))[0][:, 1:]
    centred = y @ basis
    for group in np.unique(groups):
        centred[groups == group] -= centred[groups == group].mean(axis=0)
    df = len(y) - len(np.unique(groups))
    return centred.T @ centred / df, df


def _epsilon(y: Array, groups: npt.NDArray[Any]) -> float:
    """tr(S)^2 / ((k-1) tr(S^2)), S the covariance of the contrasts (Greenhouse, Geisser, Psychometrika 24, 1959)."""
    s, _ = _contrast_covariance(y, groups)
    square = float(np.sum(s * s))
    return float(np.trace(s) ** 2 / (len(s) * square)) if square > 0.0 else 1.0


def _mauchly(y: Array, groups: npt.NDArray[Any]) -> tuple[float, float]:
    """W = det S / (tr S / p)^p with p = k - 1; chi^2 of Mauchly (Annals of Mathematical Statistics 11, 1940)."""
    s, df = _contrast_covariance(y, groups)
    p = len(s)
    if p < 2 or df < p:
        return float("nan"), float("nan")
    w = float(np.linalg.det(s) / (np.trace(s) / p) ** p)
    if w <= 0.0:
        return 0.0, 0.0
    chi = -(df - (2 * p * p + p + 2) / (6 * p)) * np.log(w)
    return w, float(stats.chi2.sf(chi, p * (p + 1) / 2 - 1))
