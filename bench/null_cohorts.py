"""False-positive rate of the interaction of group and set over null cohorts, by the whole analysis of variance.

Each cohort is 28 subjects in groups of 10 and 18 whose success in thirty trials of sets 1 and 3 is binomial, with a
chance of each subject's own that rises in both groups alike; what is tested is the success rate, which is not normal.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from scipy import stats

from rig_study.statistics_anova import Cells, mixed_anova


def main() -> None:
    """Print the rate with its exact interval."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cohorts", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    groups = np.array(["control"] * 10 + ["training"] * 18)
    subjects, sets = tuple(f"S{k:02d}" for k in range(1, 29)), ("set1", "set3")
    begin, found = time.perf_counter(), 0
    for _ in range(options.cohorts):
        chance = random.beta(2.0, 12.0, (28, 1)) + random.uniform(0.0, 0.3, (28, 1)) * np.array([0.0, 1.0])
        values = random.binomial(30, chance) / 30.0
        found += mixed_anova(Cells(values, groups, subjects, sets)).effect("interaction").p < 0.05
    interval = stats.binomtest(int(found), options.cohorts).proportion_ci()
    print(
        f"{found} of {options.cohorts} null cohorts: {found / options.cohorts:.3f} "
        f"({interval.low:.3f} to {interval.high:.3f}), {time.perf_counter() - begin:.0f} s"
    )


if __name__ == "__main__":
    main()
