"""The statistics of a study, as the paper reports them: what is asked, in which order, of which trials.

Skill is a subject's mean over the first set, all trials or the last ten; PRA is of single trials under the filter, as
in the paper, and of subjects' means beside it, for trials of one subject are not independent. Group and set are
compared by subjects' means over the first and the last set. p-values of one family (one kind of question over all
measures) are corrected by Holm's method.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from rig_study.effect_sizes import eta_interval
from rig_study.statistics import StatisticsError, holm, normality, paired_t, pearson, two_sample_t
from rig_study.statistics_anova import cells, factorial_anova, mixed_anova
from rig_study.tables import subjects

__all__ = ["MEASURES", "compute", "outer_sets"]

#: What the paper compares, with names and units for a reader.
MEASURES: dict[str, tuple[str, str]] = {
    "success_rate": ("success rate", ""),
    "rms_error": ("RMS error", "1: hanging"),
    "balance_time": ("balance time", "s"),
    "time_to_success": ("time to success", "s"),
}
LAST = 10


def outer_sets(trials: pd.DataFrame) -> tuple[str, str]:
    """The first and the last set, by name.

    Raises
    ------
    StatisticsError: fewer than two sets.
    """
    sets = sorted(set(trials["set"]))
    if len(sets) < 2:
        raise StatisticsError(f"sets: {', '.join(sets) or 'none'}; there is nothing to compare")
    return sets[0], sets[-1]


def compute(trials: pd.DataFrame, sets: tuple[str, str]) -> dict[str, Any]:
    """Everything, as it is written to ``statistics.json``; what cannot be computed holds ``error``, which says why."""
    means = subjects(trials)
    measures = [name for name in MEASURES if name in means]
    return {
        "sets": list(sets),
        "groups": {group: int(n) for group, n in means.groupby("group")["subject"].nunique().items()},
        "correlation": _family("p", {k: v for m in measures for k, v in _correlations(trials, m, sets[0]).items()}),
        "mixed_anova": {m: _try(lambda m=m: _anova(mixed_anova, means, m, sets)) for m in measures},
        "factorial_anova": {m: _try(lambda m=m: _anova(factorial_anova, means, m, sets)) for m in measures},
        "paired": _family("p", {k: v for m in measures for k, v in _paired(means, m, sets).items()}),
        "two_sample": _family("p", {k: v for m in measures for k, v in _two_sample(means, m).items()}),
        "two_sample_of_trials": _family("p", {k: v for m in measures for k, v in _two_sample(_raw(trials), m).items()}),
    }


def _try(make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    try:
        return make()
    except StatisticsError as error:
        return {"error": str(error)}


def _family(key: str, tests: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """With the corrected p beside each."""
    valid = [name for name, test in tests.items() if key in test and math.isfinite(test[key])]
    for name, corrected in zip(valid, holm([tests[name][key] for name in valid]), strict=True):
        tests[name]["p_holm"] = corrected
    return tests


def _raw(trials: pd.DataFrame) -> pd.DataFrame:
    return trials.rename(columns={"success": "success_rate"})


def _correlations(trials: pd.DataFrame, measure: str, first: str) -> dict[str, dict[str, Any]]:
    raw = _raw(trials)
    filtered = raw[(raw["mode"] != "off") & raw["pra"].notna()]
    baseline = raw[raw["set"] == first].sort_values("trial")
    result = {}
    for which, chosen in (("all trials", baseline), (f"last {LAST} trials", baseline.groupby("subject").tail(LAST))):
        skill = chosen.astype({measure: float}).groupby("subject")[measure].mean()
        known = filtered[filtered["subject"].isin(skill.index)]
        by_subject = known.groupby("subject")["pra"].mean()
        for of, x, y in (
            ("trials", skill.loc[known["subject"]], known["pra"]),
            ("subjects", skill.loc[by_subject.index], by_subject),
        ):
            result[f"{measure}, {which} of {first}, PRA of {of}"] = _try(
                lambda x=x, y=y: pearson(x.to_numpy(), y.to_numpy())._asdict()
            )
    return result


def _anova(which: Callable[..., Any], means: pd.DataFrame, measure: str, sets: tuple[str, str]) -> dict[str, Any]:
    found = which(cells(means, measure, sets))
    effects = {}
    for row in found.effects:
        low, high = eta_interval(row.f, row.df, row.error_df)
        effects[row.effect] = {**row._asdict(), "eta_low": low, "eta_high": high}
    return {"effects": effects, "normality": [found.normality]}


def _paired(means: pd.DataFrame, measure: str, sets: tuple[str, str]) -> dict[str, dict[str, Any]]:
    result = {}
    for group, its in means.groupby("group"):
        wide = its.pivot(index="subject", columns="set", values=measure)

        def test(wide: pd.DataFrame = wide) -> dict[str, Any]:
            lacking = [str(subject) for subject in wide.index[wide.reindex(columns=list(sets)).isna().any(axis=1)]]
            if lacking:
                raise StatisticsError(f"{measure}: {', '.join(lacking)} lack set {sets[0]} or {sets[1]}")
            after, before = wide[sets[1]].to_numpy(), wide[sets[0]].to_numpy()
            return {**paired_t(after, before)._asdict(), "normality": [normality(after - before)]}

        result[f"{measure}, {group}, {sets[1]} less {sets[0]}"] = _try(test)
    return result


def _two_sample(table: pd.DataFrame, measure: str) -> dict[str, dict[str, Any]]:
    groups = sorted(set(table["group"]))
    if len(groups) != 2:
        return {f"{measure}": {"error": f"groups: {', '.join(groups)}; two are compared"}}
    result = {}
    for set_, its in table.groupby("set"):
        samples = [its[its["group"] == group][measure].to_numpy(dtype=float) for group in groups]
        result[f"{measure}, {set_}, {groups[1]} less {groups[0]}"] = _try(
            lambda samples=samples: {
                **two_sample_t(samples[1], samples[0])._asdict(),
                "normality": [normality(samples[1]), normality(samples[0])],
            }
        )
    return result


def finite(value: Any) -> Any:
    """For JSON, which knows no NaN: null in its place, everywhere below."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
