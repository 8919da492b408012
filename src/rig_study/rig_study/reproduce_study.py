"""What ``./rig reproduce`` measures beside the claims of the science: the paper's study with virtual subjects, what its
statistics are worth, the filter beside its baselines; and the figures.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from rig_study import study_figures
from rig_study.analyze_cli import analyze
from rig_study.cohort import jobs, load_cohort
from rig_study.figure_style import save
from rig_study.null_cohorts import false_positives
from rig_study.paper_rows import paper_rows
from rig_study.power import changes, power
from rig_study.protocol import load_protocol
from rig_study.results_page import Row
from rig_study.runs import Job, progress, run, write_table
from rig_study.statistics_anova import cells
from rig_study.study_cli import simulate
from rig_study.sweep import load_sweep, montecarlo_jobs, sweep_jobs
from rig_study.tables import subjects
from shared_control.trial import run_trial

__all__ = ["MEASUREMENTS", "Measurement", "Options"]

_CONVERGENCE = "cart_pendulum_noise_assistance"
#: Scenarios that stand together in one figure of SLIP.
_SLIP = {
    "noise": ("slip_noise_off", "slip_noise_assistance"),
    "low skill": ("slip_low_skill_off", "slip_low_skill_assistance"),
    "skilled": ("slip_skilled_off", "slip_skilled_assistance"),
}


@dataclass(frozen=True)
class Options:
    """How much is measured, with how many processes, and where the files go."""

    folder: Path
    trials: int | None = None
    workers: int | None = None

    def at_most(self, count: int) -> int:
        """``count``, or fewer for a first look."""
        return count if self.trials is None else min(count, self.trials)

    def run(self, trials: list[Job], name: str) -> pd.DataFrame:
        """Their table, with its report beside it in a folder of this name."""
        folder = self.folder / name
        write_table(run(trials, folder, workers=self.workers, report=progress(name)), folder / "trials.parquet")
        analyze([folder], folder / "report")
        return pd.read_parquet(folder / "trials.parquet")


class Measurement(NamedTuple):
    """What it gives: rows of one table of the page, which may be none."""

    table: str
    rows: Callable[[Options], list[Row]]


def _study(options: Options) -> list[Row]:
    folder = options.folder / "study"
    protocol = load_protocol("paper")
    sets = {name: replace(its, trials=options.at_most(its.trials)) for name, its in protocol.sets.items()}
    simulate(replace(protocol, sets=sets), load_cohort("learners"), folder, workers=options.workers)
    analyze([folder], folder / "report")
    return paper_rows(json.loads((folder / "report" / "statistics.json").read_text(encoding="utf-8"))["study"])


def _null(options: Options) -> list[Row]:
    found = false_positives(options.at_most(1000))
    inside = "" if found.low <= 0.05 <= found.high else ": **outside**"
    rate = f"{found.found / found.cohorts:.3f} ({found.low:.3f} to {found.high:.3f})"
    return [
        ("group x set found in null cohorts", "0.05 within its binomial interval",
         f"{found.found:,} of {found.cohorts:,}: {rate}{inside}")
    ]  # fmt: skip


def _trials_of_study(options: Options) -> pd.DataFrame:
    """Of the study, which is there if all is measured in order."""
    table = options.folder / "study" / "trials.parquet"
    if not table.exists():
        _study(options)
    return pd.read_parquet(table)


def _power(options: Options) -> list[Row]:
    pilot = cells(subjects(_trials_of_study(options)), "rms_error", ("set1", "set3"))
    rows = power(changes(pilot), [28, 56, 84], effect=0.8)
    said = "; ".join(f"{row.subjects} subjects {row.rate:.2f} ({row.low:.2f} to {row.high:.2f})" for row in rows)
    return [("power of group x set, RMS error, d = 0.8", "reported", said)]


def _jobs_of(name: str, options: Options) -> list[Job]:
    sweep = load_sweep(name)
    config = replace(sweep.config, trials=options.at_most(sweep.config.trials))
    return sweep_jobs(replace(sweep, config=config))


def _judges(options: Options) -> list[Row]:
    trials = options.run(_jobs_of("judges", options), "judges")
    rows = []
    for _, its in trials.groupby("point"):
        first = its.iloc[0]
        judge = "-" if first["mig_filter.mode"] == "off" else first["mig_filter.judge"]
        rows.append(
            (f"{first['user_sim.user']}, {first['mig_filter.mode']}, {judge}",
             f"{int(its['success'].sum())} of {len(its)}", f"{its['rms_error'].mean():.3f}",
             f"{its['balance_time'].mean():.1f}", f"{its['intervened'].mean():.3f}")
        )  # fmt: skip
    return rows


def _example(options: Options) -> list[Row]:
    """The first trial under the filter that succeeded."""
    trials = _trials_of_study(options)
    filtered = trials[trials["mode"] != "off"]
    name = filtered.sort_values("success", ascending=False, kind="stable")["name"].iloc[0]
    job = next(job for job in jobs(load_protocol("paper"), load_cohort("learners")) if job.name == name)
    shown = study_figures.Example.headless(run_trial(job.scenario, job.seed), job.scenario.loop.make_task())
    save(study_figures.example(shown), options.folder / "example" / "example_trial")
    return []


def _slip_judges(options: Options) -> list[Row]:
    options.run(_jobs_of("slip_judges", options), "slip_judges")
    return []


def _convergence(options: Options) -> list[Row]:
    options.run(montecarlo_jobs(_CONVERGENCE, options.at_most(100), 0, 5), "convergence")
    return []


def _slip(user: str, options: Options) -> list[Row]:
    trials = [job for scenario in _SLIP[user] for job in montecarlo_jobs(scenario, 1, 0, 5)]
    options.run(trials, f"slip {user}".replace(" ", "_"))
    return []


#: By name, in the order in which they are measured.
MEASUREMENTS: dict[str, Measurement] = {
    "study/paper": Measurement("study", _study),
    "study/null cohorts": Measurement("statistics", _null),
    "study/power": Measurement("statistics", _power),
    "study/judges": Measurement("judges", _judges),
    "figures/example trial": Measurement("", _example),
    "figures/convergence": Measurement("", _convergence),
    "figures/slip judges": Measurement("", _slip_judges),
    **{f"figures/slip {user}": Measurement("", lambda options, user=user: _slip(user, options)) for user in _SLIP},
}
