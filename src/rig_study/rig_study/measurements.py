"""What ``./rig reproduce`` measures: of each table of ``docs/results.md``, and of each figure, the trials and the rows.

The claims of the science, then the paper's study with virtual subjects, what its statistics are worth, the filter
beside its baselines, and the figures. A trial that two of them need is run once.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from rig_study import graded_users, study_figures
from rig_study.analyze_cli import analyze
from rig_study.bounds import Bound, at_least, at_most, result, wanted
from rig_study.claim_figures import figures, sentence
from rig_study.claims import CART, FIRST_SEED, MAP, SLIP, Claim
from rig_study.claims import jobs as claim_jobs
from rig_study.cohort import jobs as cohort_jobs
from rig_study.cohort import load_cohort
from rig_study.figure_style import save
from rig_study.null_cohorts import false_positives
from rig_study.paper_rows import paper_rows
from rig_study.power import changes, needed, power
from rig_study.protocol import Protocol, load_protocol
from rig_study.results_page import Row
from rig_study.runs import Job, write_table
from rig_study.runs import Row as Trial
from rig_study.statistics_anova import cells
from rig_study.study_cli import keep
from rig_study.sweep import load_sweep, montecarlo_jobs, sweep_jobs
from rig_study.tables import subjects
from shared_control.trial import run_trial

__all__ = ["Measurement", "Options", "measurements"]

_CONVERGENCE = "cart_pendulum_noise_assistance"
#: Scenarios that stand together in one figure of SLIP.
_SLIP = {
    "noise": ("slip_noise_off", "slip_noise_assistance"),
    "low skill": ("slip_low_skill_off", "slip_low_skill_assistance"),
    "skilled": ("slip_skilled_off", "slip_skilled_assistance"),
}


@dataclass(frozen=True)
class Options:
    """Where the files go, and at most how many trials there are of each kind; all, if left out."""

    folder: Path
    trials: int | None = None

    def at_most(self, count: int) -> int:
        """``count``, or fewer for a first look."""
        return count if self.trials is None else min(count, self.trials)


class Measurement(NamedTuple):
    """Which table of the page it gives rows of (none: ""), its trials, and its rows from what came out."""

    table: str
    jobs: Callable[[Options], list[Job]]
    rows: Callable[[Options, Sequence[Trial]], list[Row]]


def measurements() -> dict[str, Measurement]:
    """All of them by name, in the order of the page."""
    return {
        **{name: _claim("claims", name, claim) for name, claim in CART.items()},
        **{name: _graded(name) for name in graded_users.POPULATIONS},
        **{name: _claim("claims", name, claim) for name, claim in SLIP.items()},
        **{name: _claim("map", name, claim) for name, claim in MAP.items()},
        "study/paper": Measurement("study", _study_jobs, _study),
        "study/null cohorts": Measurement("statistics", lambda _: [], _null),
        "study/power": Measurement("statistics", _study_jobs, _power),
        "study/judges": Measurement("judges", functools.partial(_sweep_jobs, "judges"), _judges),
        "study/slip judges": Measurement(
            "slip_judges", functools.partial(_sweep_jobs, "slip_judges"), _slip_judges
        ),
        "figures/example trial": Measurement("", _study_jobs, _example),
        "figures/convergence": Measurement(
            "", lambda options: montecarlo_jobs(_CONVERGENCE, options.at_most(100), 0, 5),
            functools.partial(_report, "convergence"),
        ),
        **{
            f"figures/slip {user}": Measurement(
                "", functools.partial(_slip_jobs, user), functools.partial(_report, f"slip {user}".replace(" ", "_"))
            )
            for user in _SLIP
        },
    }  # fmt: skip


def _claim(table: str, name: str, claim: Claim) -> Measurement:
    def rows(_: Options, trials: Sequence[Trial]) -> list[Row]:
        found = figures(trials)
        changed = [f"{key}: {value}" for key, value in claim.changes.items()]
        what = ", ".join(f"`{part}`" for part in (claim.base, *changed))
        seeds = f"{len(trials):,} seeds from {FIRST_SEED}"
        return [_row(name, claim.wanted, found, sentence(found, len(trials)), f"{what}; {seeds}")]

    return Measurement(table, lambda options: claim_jobs(name, claim, options.at_most(claim.seeds)), rows)


def _row(name: str, bounds: Sequence[Bound], found: dict[str, float], said: str, *rest: str) -> Row:
    return (name, wanted(bounds), said, result(bounds, found), *rest)


def _graded(population: str) -> Measurement:
    def rows(_: Options, trials: Sequence[Trial]) -> list[Row]:
        found = graded_users.figures(trials)
        what = f"`{graded_users.CLAIM.base}`, judged afterwards by `{graded_users.JUDGE}`; {len(trials)} trials"
        return [_row(population, graded_users.WANTED, found, graded_users.sentence(found), what)]

    def jobs(options: Options) -> list[Job]:
        return graded_users.jobs(population, options.at_most(graded_users.CLAIM.seeds))

    return Measurement("claims", jobs, rows)


def _protocol(options: Options) -> Protocol:
    protocol = load_protocol("paper")
    sets = {name: replace(its, trials=options.at_most(its.trials)) for name, its in protocol.sets.items()}
    return replace(protocol, sets=sets)


def _study_jobs(options: Options) -> list[Job]:
    return cohort_jobs(_protocol(options), load_cohort("learners"))


def _study(options: Options, trials: Sequence[Trial]) -> list[Row]:
    folder = options.folder / "study"
    keep(_protocol(options), load_cohort("learners"), trials, folder)
    analyze([folder], folder / "report")
    return paper_rows(json.loads((folder / "report" / "statistics.json").read_text(encoding="utf-8"))["study"])


def _null(options: Options, _: Sequence[Trial]) -> list[Row]:
    found = false_positives(options.at_most(1000))
    bounds = at_most("lower limit", 0.05), at_least("upper limit", 0.05)
    limits = {"lower limit": found.low, "upper limit": found.high}
    said = (
        f"{found.found:,} of {found.cohorts:,}: {found.found / found.cohorts:.3f} ({found.low:.3f} to {found.high:.3f})"
    )
    return [_row("group x set found in null cohorts, binomial interval", bounds, limits, said)]


def _power(_: Options, trials: Sequence[Trial]) -> list[Row]:
    pilot = changes(cells(subjects(pd.DataFrame(trials)), "rms_error", ("set1", "set3")))
    rows, enough = power(pilot, [28, 56, 84], effect=0.8), needed(pilot, 0.8, effect=0.8)
    said = "; ".join(f"{row.subjects} subjects {row.rate:.2f} ({row.low:.2f} to {row.high:.2f})" for row in rows)
    if enough is not None:
        said += f"; 0.8 takes {enough.subjects} subjects ({enough.low} to {enough.high})"
    return [_row("power of group x set, RMS error, d = 0.8", (), {}, said)]


def _sweep_jobs(name: str, options: Options) -> list[Job]:
    sweep = load_sweep(name)
    config = replace(sweep.config, trials=options.at_most(sweep.config.trials))
    return sweep_jobs(replace(sweep, config=config))


def _report(name: str, options: Options, trials: Sequence[Trial]) -> list[Row]:
    """Table and report in a folder of this name; no row."""
    folder = options.folder / name
    write_table(trials, folder / "trials.parquet")
    analyze([folder], folder / "report")
    return []


def _judges(options: Options, trials: Sequence[Trial]) -> list[Row]:
    _report("judges", options, trials)
    return [
        (f"{first['user_sim.user']}, {_judge(first)}", f"{int(its['success'].sum())} of {len(its)}",
         f"{its['rms_error'].mean():.3f}", f"{its['balance_time'].mean():.1f}", f"{its['intervened'].mean():.3f}")
        for first, its in _points(trials)
    ]  # fmt: skip


def _slip_judges(options: Options, trials: Sequence[Trial]) -> list[Row]:
    _report("slip_judges", options, trials)
    return [
        (_judge(first), f"{int(its['fell'].sum())} of {len(its)}", f"{its['fall_time'].median():.1f}",
         f"{its['override'].mean():.3f}", f"{its['mean_speed'].mean():.3f}")
        for first, its in _points(trials)
    ]  # fmt: skip


def _points(trials: Sequence[Trial]) -> list[tuple[pd.Series, pd.DataFrame]]:
    """Of each point of a sweep its first trial and all of them."""
    return [(its.iloc[0], its) for _, its in pd.DataFrame(trials).groupby("point")]


def _judge(trial: pd.Series) -> str:
    mode = trial["mig_filter.mode"]
    return f"{mode}, {'-' if mode == 'off' else trial['mig_filter.judge']}"


def _example(options: Options, trials: Sequence[Trial]) -> list[Row]:
    """The first trial under the filter that succeeded."""
    filtered = [trial for trial in trials if trial["mode"] != "off"]
    name = next((trial for trial in filtered if trial["success"]), filtered[0])["name"]
    job = next(job for job in _study_jobs(options) if job.name == name)
    shown = study_figures.Example.headless(run_trial(job.scenario, job.seed), job.scenario.loop.make_task())
    save(study_figures.example(shown), options.folder / "example" / "example_trial")
    return []


def _slip_jobs(user: str, _: Options) -> list[Job]:
    return [job for scenario in _SLIP[user] for job in montecarlo_jobs(scenario, 1, 0, 5)]
