"""``study``: a protocol's plan, its simulation with virtual subjects, and the number of subjects that it needs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rig_study import cohort as cohorts
from rig_study.declared import StudyError
from rig_study.protocol import load_protocol
from rig_study.runs import progress, run, write_table
from rig_study.statistics import StatisticsError
from shared_control.parameters import ParameterError

__all__ = ["add_run_options", "main"]


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="./rig study", description=__doc__)
    commands = result.add_subparsers(dest="command", required=True, metavar="COMMAND")

    plan = commands.add_parser("plan", help="who does what: groups, or the trials of one subject")
    plan.add_argument("protocol", help="path, or a name under config/protocols")
    plan.add_argument("--subject", help="as in S07; all subjects, one a line, if left out")

    simulate = commands.add_parser("simulate", help="every trial of a protocol with virtual subjects, headless")
    simulate.add_argument("protocol", help="path, or a name under config/protocols")
    simulate.add_argument("--cohort", default="learners", help="path, or a name under config/cohorts (%(default)s)")
    add_run_options(simulate)

    power = commands.add_parser(
        "power",
        help="how many subjects an effect needs, by cohorts drawn from a pilot",
        description="Draw cohorts from the subjects of a pilot and count in how many the interaction of group and set "
        "is found, with an exact binomial interval.",
    )
    power.add_argument("pilot", type=Path, help="folder or table of trials, simulated or analysed")
    power.add_argument("--measure", default="rms_error", help="of the subjects' means over a set (%(default)s)")
    power.add_argument("--subjects", type=int, nargs="+", default=[14, 28, 42, 56, 84], metavar="N", help="in all")
    power.add_argument(
        "--effect", type=float, metavar="D", help="wanted d between the groups' changes; 0: a null cohort"
    )
    power.add_argument("--cohorts", type=int, default=2000, help="drawn for each number of subjects (%(default)s)")
    power.add_argument("--alpha", type=float, default=0.05, help="level of the test (%(default)s)")
    power.add_argument("--seed", type=int, default=0)
    power.add_argument("--sets", nargs=2, metavar="SET", help="before and after (first and last, if left out)")
    return result


def add_run_options(to: argparse.ArgumentParser) -> None:
    """What every command has that runs many trials."""
    to.add_argument("--out", type=Path, help="folder of the run, which a second call resumes (under runs/)")
    to.add_argument("--workers", type=int, help="processes; as many as there are cores, if left out")
    to.add_argument("--scheduler", metavar="tcp://...", help="a Dask scheduler, instead of processes here")


def main(argv: Sequence[str]) -> int:
    """Returns 0, or 2 for bad input; 130 if interrupted, and then the same call goes on where it stopped."""
    options = parser().parse_args(argv)
    try:
        return {"plan": _plan, "simulate": _simulate, "power": _power}[options.command](options)
    except (ParameterError, StatisticsError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130


def _plan(options: argparse.Namespace) -> int:
    protocol = load_protocol(options.protocol)
    if options.subject is None:
        print(f"{protocol.name}: {protocol.study.title}\n{'subject':10}{'group':12}{'sets':32}{'length':>8}")
        for subject, group in protocol.subjects.items():
            order = dict.fromkeys(trial.set for trial in protocol.plan(subject))
            print(f"{subject:10}{group:12}{', '.join(order):32}{protocol.session_length(subject) / 60:6.1f} min")
        return 0
    for trial in protocol.plan(options.subject):
        print(f"{trial.position:4}  {trial.set:10}{trial.trial:4}  {trial.mode:12}{trial.name}  seed {trial.seed}")
    return 0


def _simulate(options: argparse.Namespace) -> int:
    protocol, cohort = load_protocol(options.protocol), cohorts.load_cohort(options.cohort)
    folder = options.out or Path("runs") / f"study_{protocol.file.path.stem}_{cohort.file.path.stem}"
    jobs = cohorts.jobs(protocol, cohort)
    shown = progress(protocol.file.path.stem)
    rows = run(jobs, folder, workers=options.workers, scheduler=options.scheduler, report=shown)
    (folder / "protocol.yaml").write_text(protocol.file.text, encoding="utf-8")
    (folder / "cohort.yaml").write_text(cohort.file.text, encoding="utf-8")
    print(f"{len(rows)} trials of {len(protocol.subjects)} subjects: {write_table(rows, folder / 'trials.parquet')}")
    print(f"next: ./rig analyze {folder} --out {folder / 'report'}")
    return 0


def _power(options: argparse.Namespace) -> int:
    # Imported here: plans and simulations need no tables.
    from rig_study.power import changes, power
    from rig_study.statistics_anova import cells
    from rig_study.tables import read, subjects

    table = subjects(read([options.pilot]).trials)
    if options.measure not in table:
        raise StudyError(f"measure: {options.measure!r} is not there; the table has {', '.join(table.columns[4:])}")
    sets = options.sets or [sorted(set(table["set"]))[0], sorted(set(table["set"]))[-1]]
    pilot = changes(cells(table, options.measure, sets))
    wanted = "the pilot's own effect" if options.effect is None else f"d = {options.effect:g}"
    print(f"{options.measure}, {sets[0]} to {sets[1]}, {wanted}, {options.cohorts} cohorts, alpha {options.alpha:g}")
    print(f"{'subjects':>8}  {'groups':>14}  {'found':>7}  95 % interval")
    for row in power(
        pilot, options.subjects, effect=options.effect, cohorts=options.cohorts, alpha=options.alpha, seed=options.seed
    ):
        groups = " + ".join(f"{size} {name}" for size, name in zip(row.sizes, pilot, strict=True))
        print(f"{row.subjects:8}  {groups:>14}  {row.rate:7.3f}  {row.low:.3f} to {row.high:.3f}")
    return 0
