"""Statistics against published data, against hand-computed cases, and against a second library."""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, stats

from rig_study import statistics
from rig_study.effect_sizes import eta_interval, noncentral_t
from rig_study.statistics import StatisticsError
from rig_study.statistics_anova import Cells, cells, factorial_anova, mixed_anova

# Anscombe, The American Statistician 27, 1973, first of four data sets.
ANSCOMBE_X = [10, 8, 13, 9, 11, 14, 6, 4, 12, 7, 5]
ANSCOMBE_Y = [8.04, 6.95, 7.58, 8.81, 8.33, 9.96, 7.24, 4.26, 10.84, 4.82, 5.68]
# Student, Biometrika 6, 1908: hours of sleep gained by ten patients under two drugs.
SLEEP_1 = [0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0]
SLEEP_2 = [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4]
# Winer, Statistical Principles in Experimental Design, 2nd ed. 1971, section 7.2: two groups of three, four settings.
WINER = [[0, 0, 5, 3], [3, 1, 5, 4], [4, 3, 6, 2], [4, 2, 7, 8], [5, 4, 6, 6], [7, 5, 8, 9]]
# Shapiro and Wilk, Biometrika 52, 1965: weights of eleven men.
WEIGHTS = [148, 154, 158, 160, 161, 162, 166, 170, 182, 195, 236]
# Maxwell and Delaney, Designing Experiments and Analyzing Data, 2nd ed. 2004, table 11.5: McCarthy scores of twelve
# children at 30, 36, 42 and 48 months.
MCCARTHY = [
    [108, 96, 110, 122], [103, 117, 127, 133], [96, 107, 106, 107], [84, 85, 92, 99],
    [118, 125, 125, 116], [110, 107, 96, 91], [129, 128, 123, 128], [90, 84, 101, 113],
    [84, 104, 100, 88], [96, 100, 103, 105], [105, 114, 105, 112], [113, 117, 132, 130],
]  # fmt: skip
# Henderson and Velleman, Biometrics 37, 1981: miles per gallon of cars that shift by themselves, and of the others.
AUTOMATIC = [
    21.4, 18.7, 18.1, 14.3, 24.4, 22.8, 19.2, 17.8, 16.4, 17.3, 15.2, 10.4, 10.4, 14.7, 21.5, 15.5, 15.2, 13.3, 19.2,
]  # fmt: skip
MANUAL = [21.0, 21.0, 22.8, 32.4, 30.4, 33.9, 27.3, 26.0, 30.4, 15.8, 19.7, 15.0, 21.4]
# Benjamini and Hochberg, Journal of the Royal Statistical Society B 57, 1995, section 3.2: fifteen p-values of one
# clinical trial, of which methods that control the familywise error reject three.
THROMBOLYSIS = [
    0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0,
]  # fmt: skip


def frame(values: Any, groups: list[str]) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {"subject": f"S{i}", "group": group, "set": f"set{j}", "y": float(y)}
            for i, (row, group) in enumerate(zip(values, groups, strict=True))
            for j, y in enumerate(row)
        ]
    )


def unbalanced(sets: int = 3) -> Cells:
    random = np.random.default_rng(5)
    groups = ["control"] * 5 + ["training"] * 9
    table = frame(random.standard_normal((14, sets)) + random.standard_normal((14, 1)), groups)
    return cells(table, "y", [f"set{j}" for j in range(sets)])


def long(data: Cells) -> pd.DataFrame:
    return frame(data.values, list(data.groups))


def test_pearson_of_anscombe() -> None:
    found = statistics.pearson(ANSCOMBE_X, ANSCOMBE_Y)
    assert (found.r, found.p) == (pytest.approx(0.81642, abs=1e-5), pytest.approx(0.00217, abs=1e-5))
    # Fisher's interval by hand: tanh(1.14605 -+ 1.95996 / sqrt(8)).
    assert (found.low, found.high) == (pytest.approx(0.4244, abs=1e-4), pytest.approx(0.9507, abs=1e-4))
    pingouin = importlib.import_module("pingouin").pairwise_corr(pd.DataFrame({"x": ANSCOMBE_X, "y": ANSCOMBE_Y}))
    assert found.r == pytest.approx(pingouin["r"][0], abs=1e-12)
    assert (found.low, found.high) == pytest.approx(tuple(pingouin["CI95"][0]), abs=6e-3)  # rounded there


def test_t_of_students_sleep() -> None:
    paired = statistics.paired_t(SLEEP_1, SLEEP_2)
    assert paired.t == pytest.approx(-4.0621, abs=1e-4)
    assert paired.p == pytest.approx(0.002833, abs=1e-6)
    assert (paired.df, paired.low, paired.high) == (
        9,
        pytest.approx(-2.459886, abs=1e-6),
        pytest.approx(-0.700114, abs=1e-6),
    )
    # By hand: -1.58 over the mean of the deviations 1.789010 and 2.002249.
    assert paired.d == pytest.approx(-0.833496, abs=1e-5)
    welch = statistics.two_sample_t(SLEEP_1, SLEEP_2)
    assert (welch.t, welch.p) == (pytest.approx(-1.8608, abs=1e-4), pytest.approx(0.07939, abs=1e-5))
    assert welch.df == pytest.approx(17.776, abs=1e-3)
    pooled = statistics.two_sample_t(SLEEP_1, SLEEP_2, equal_variances=True)
    assert (pooled.df, pooled.p) == (18, pytest.approx(0.07919, abs=1e-5))
    assert pooled.d == pytest.approx(-1.58 / math.sqrt((1.789010**2 + 2.002249**2) / 2), abs=1e-5)
    from statsmodels.stats.weightstats import ttest_ind

    assert ttest_ind(SLEEP_1, SLEEP_2, usevar="unequal") == pytest.approx((welch.t, welch.p, welch.df), abs=1e-12)


@pytest.mark.parametrize("t", [-4.0621, 0.0, 1.3])
def test_the_interval_of_d_holds_by_its_definition(t: float) -> None:
    """P(T <= t) at each limit, from the definition (Z + delta) / sqrt(chi^2 / df), integrated numerically."""

    def below(delta: float) -> float:
        return float(
            integrate.quad(lambda v: stats.norm.cdf(t * math.sqrt(v / 9) - delta) * stats.chi2.pdf(v, 9), 0, 80)[0]
        )

    low, high = noncentral_t(t, 9)
    assert (below(low), below(high)) == (pytest.approx(0.975, abs=1e-6), pytest.approx(0.025, abs=1e-6))


def test_the_interval_of_d_of_cars() -> None:
    """-1.48 (-2.27 to -0.67): Ben-Shachar, Luedecke, Makowski, Journal of Open Source Software 5(56), 2020."""
    from statsmodels.stats.power import TTestIndPower

    found = statistics.two_sample_t(AUTOMATIC, MANUAL)
    assert (found.d, found.d_low, found.d_high) == pytest.approx((-1.48, -2.27, -0.67), abs=5e-3)
    # By another library: at each limit, a t as far out as the one found has half of 5 % left.
    t = stats.ttest_ind(AUTOMATIC, MANUAL).statistic
    for limit, side in ((found.d_high, "smaller"), (found.d_low, "larger")):
        alpha = stats.t.cdf(t, 30) if side == "smaller" else stats.t.sf(t, 30)
        left = TTestIndPower().power(limit, 19, alpha, ratio=13 / 19, alternative=side)
        assert left == pytest.approx(0.025, abs=1e-6)


def test_mixed_anova_of_winer() -> None:
    found = mixed_anova(cells(frame(WINER, ["a"] * 3 + ["b"] * 3), "y", [f"set{j}" for j in range(4)]))
    group, within, interaction = found.effects
    assert (group.ss, group.df, group.error_df) == (pytest.approx(51.04, abs=5e-3), 1, 4)
    assert (within.ss, within.df, within.error_df) == (pytest.approx(47.46, abs=5e-3), 3, 12)
    assert (interaction.ss, interaction.df) == (pytest.approx(7.46, abs=5e-3), 3)
    assert [row.f for row in found.effects] == pytest.approx([11.89, 12.80, 2.01], abs=0.01)
    assert group.eta == pytest.approx(51.04 / (51.04 + 17.17), abs=1e-4)


def test_factorial_anova_of_winer() -> None:
    """Subjects and residual make one error: 17.167 + 14.833 = 32 with 16 degrees of freedom."""
    found = factorial_anova(cells(frame(WINER, ["a"] * 3 + ["b"] * 3), "y", [f"set{j}" for j in range(4)]))
    assert [row.error_df for row in found.effects] == [16, 16, 16]
    assert [row.f for row in found.effects] == pytest.approx([51.0417 / 2, 47.4583 / 6, 7.4583 / 6], abs=1e-4)


@pytest.mark.parametrize("sets", [2, 3])
def test_two_libraries_agree_on_groups_of_unequal_size(sets: int) -> None:
    pingouin = importlib.import_module("pingouin")
    from statsmodels.api import OLS
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    data = unbalanced(sets)
    table = long(data).rename(columns={"set": "level"})
    mixed, factorial = mixed_anova(data), factorial_anova(data)
    theirs = pingouin.mixed_anova(data=table, dv="y", within="level", subject="subject", between="group")
    assert [row.f for row in mixed.effects] == pytest.approx(list(theirs["F"]), rel=1e-9)
    assert [row.eta for row in mixed.effects] == pytest.approx(list(theirs["np2"]), rel=1e-9)
    # Nested linear models: with subjects, then set, then its interaction with group.
    subjects = pd.get_dummies(table["subject"], dtype=float).to_numpy()
    level = pd.get_dummies(table["level"], dtype=float).to_numpy()[:, 1:]
    crossed = level * (table["group"] == "training").to_numpy(dtype=float)[:, None]
    bare, within, full = (
        OLS(table["y"].to_numpy(), np.hstack(parts)).fit()
        for parts in ([subjects], [subjects, level], [subjects, level, crossed])
    )
    assert mixed.effect("interaction").f == pytest.approx(full.compare_f_test(within)[0], rel=1e-9)
    assert mixed.effect("set").f == pytest.approx((bare.ssr - within.ssr) / (sets - 1) / full.mse_resid, rel=1e-9)
    flat = anova_lm(ols("y ~ C(group) * C(level)", table).fit(), typ=2)
    assert [row.f for row in factorial.effects] == pytest.approx(
        list(flat.loc[["C(group)", "C(level)", "C(group):C(level)"], "F"]), rel=1e-9
    )


def test_the_interaction_of_two_sets_is_the_t_of_the_changes() -> None:
    data = unbalanced(2)
    change = data.values[:, 1] - data.values[:, 0]
    split = [change[data.groups == name] for name in ("control", "training")]
    assert mixed_anova(data).effect("interaction").f == pytest.approx(stats.ttest_ind(*split).statistic ** 2, rel=1e-10)


def test_sphericity_of_maxwell_and_delaney() -> None:
    # Two groups of the same children have, pooled, the covariance of one; neither W nor epsilon knows its scale.
    twice = cells(frame(MCCARTHY * 2, ["a"] * 12 + ["b"] * 12), "y", [f"set{j}" for j in range(4)])
    found = mixed_anova(twice)
    assert found.epsilon == pytest.approx(0.609, abs=1e-3)
    assert found.sphericity[0] == pytest.approx(0.243, abs=1e-3)
    assert found.sphericity[1] < 0.05


def test_sphericity_against_another_library() -> None:
    pingouin = importlib.import_module("pingouin")
    random = np.random.default_rng(1)
    wide = random.standard_normal((12, 4)) @ np.diag([1.0, 2.0, 3.0, 1.0])
    # Two groups with the same values have, pooled, the covariance of one.
    found = mixed_anova(Cells(wide, np.array(["a", "b"] * 6), tuple("abcdefghijkl"), tuple("wxyz")))
    one = np.concatenate([wide[::2] - wide[::2].mean(axis=0), wide[1::2] - wide[1::2].mean(axis=0)])
    assert found.epsilon == pytest.approx(pingouin.epsilon(pd.DataFrame(one), correction="gg"), rel=1e-9)
    assert found.sphericity[0] == pytest.approx(pingouin.sphericity(pd.DataFrame(one)).W, rel=1e-9)
    assert np.isnan(mixed_anova(unbalanced(2)).sphericity[0])
    assert mixed_anova(unbalanced(2)).epsilon == pytest.approx(1.0)


def test_the_interval_of_eta_holds_by_its_definition() -> None:
    low, high = eta_interval(11.9, 1, 26)
    for limit, part in ((low, 0.975), (high, 0.025)):
        noncentrality = limit * 28 / (1 - limit)
        assert stats.ncf.cdf(11.9, 1, 26, noncentrality) == pytest.approx(part, abs=1e-6)
    assert eta_interval(0.1, 1, 26)[0] == 0.0


def test_the_interval_of_eta_of_steiger() -> None:
    """F(3, 76) = 5 has noncentralities from 1.8666 to 32.563: Steiger, Psychological Methods 9, 2004, example 3."""
    from statsmodels.stats.oneway import confint_noncentrality

    low, high = eta_interval(5.0, 3, 76)
    noncentral = 80 * low / (1 - low), 80 * high / (1 - high)
    assert noncentral == (pytest.approx(1.8666, abs=1e-4), pytest.approx(32.563, abs=1e-3))
    assert noncentral == pytest.approx(tuple(confint_noncentrality(5.0, (3, 76))), rel=1e-4)


def test_normality_of_shapiro_and_wilk() -> None:
    assert statistics.normality(WEIGHTS) == (pytest.approx(0.79, abs=5e-3), pytest.approx(0.0067, abs=1e-4))
    assert math.isnan(statistics.normality([1.0, 1.0, 1.0, 1.0])[0])


def test_t_and_d_by_another_library() -> None:
    pingouin = importlib.import_module("pingouin")
    paired = pingouin.ttest(SLEEP_1, SLEEP_2, paired=True)
    found = statistics.paired_t(SLEEP_1, SLEEP_2)
    assert (found.t, found.p) == pytest.approx((paired["T"].iloc[0], paired["p_val"].iloc[0]), rel=1e-9)
    assert found.d == pytest.approx(pingouin.compute_effsize(SLEEP_1, SLEEP_2, paired=True, eftype="cohen"), rel=1e-2)
    pooled = pingouin.compute_effsize(SLEEP_1, SLEEP_2, eftype="cohen")
    assert statistics.two_sample_t(SLEEP_1, SLEEP_2).d == pytest.approx(pooled, rel=1e-9)


def test_holm_by_hand_and_by_another_library() -> None:
    p = [0.01, 0.04, 0.03, 0.005]
    assert statistics.holm(p) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert statistics.holm(p) == pytest.approx(list(importlib.import_module("pingouin").multicomp(p, method="holm")[1]))
    assert statistics.holm([]) == []


def test_holm_of_benjamini_and_hochbergs_trial() -> None:
    found = statistics.holm(THROMBOLYSIS)
    assert sum(p <= 0.05 for p in found) == 3
    # By hand: times 15, 14, 13, ..., and never less than the one before.
    assert found[:8] == pytest.approx([0.0015, 0.0056, 0.0247, 0.114, 0.2211, 0.278, 0.278, 0.278])
    assert found[8:] == pytest.approx([0.3213, *[1.0] * 6])
    pingouin = importlib.import_module("pingouin")
    assert found == pytest.approx(list(pingouin.multicomp(THROMBOLYSIS, method="holm")[1]))


def test_missing_cells_are_named() -> None:
    table = frame(WINER, ["a"] * 3 + ["b"] * 3)
    sets = ["set0", "set2"]
    gone = table.drop(table[(table["subject"] == "S1") & (table["set"] == "set2")].index)
    gone.loc[(gone["subject"] == "S4") & (gone["set"] == "set0"), "y"] = math.nan
    with pytest.raises(StatisticsError, match=r"2 cells.*S1 \(group a\), set set2; subject S4 \(group b\), set set0"):
        cells(gone, "y", sets)
    with pytest.raises(StatisticsError, match="S0 has set set0 twice"):
        cells(pd.concat([table, table.head(1)]), "y", sets)
    with pytest.raises(StatisticsError, match="groups a and sets set0, set2; two of each"):
        cells(table[table["group"] == "a"], "y", sets)
    with pytest.raises(StatisticsError, match="group b has 1 subject"):
        cells(table[table["subject"].isin(["S0", "S1", "S5"])], "y", sets)


def test_a_sample_without_spread_is_compared_without_a_warning(recwarn: pytest.WarningsRecorder) -> None:
    found = statistics.two_sample_t([30.0] * 4, [28.0, 29.0, 30.0, 31.0])
    # By hand: the deviation of the second is 1.290994, its standard error 0.645497; Welch's df are those of the second.
    assert (found.t, found.df) == pytest.approx((0.5 / 0.6454972, 3.0))
    assert not recwarn.list


def test_what_cannot_be_computed_says_why() -> None:
    for call, says in (
        (lambda: statistics.pearson([1, 2, 3, 4], [1, 2, 3, 4, 5]), "are not pairs"),
        (lambda: statistics.pearson([1, 2, 3, math.nan], [1, 2, 3, 4]), "x: value 3 of 4 is nan"),
        (lambda: statistics.pearson([1, 1, 1, 1], [1, 2, 3, 4]), "nothing to correlate"),
        (lambda: statistics.paired_t([1, 2], [2, 3]), "all 2 pairs differ by -1"),
        (lambda: statistics.two_sample_t([1, 1], [2, 2]), "neither sample has any spread"),
        (lambda: statistics.two_sample_t([1], [2, 2]), "1 values are too few"),
    ):
        with pytest.raises(StatisticsError, match=says):
            call()
