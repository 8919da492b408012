"""``study``: a protocol's plan, its sessions, its simulation, and the number of subjects that it needs."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rig_study import cohort as cohorts
from rig_study.commands import carry_out
from rig_study.declared import StudyError, folders
from rig_study.progress import progress
from rig_study.protocol import Protocol, load_protocol
from rig_study.runs import Row, run, write_table
from rig_study.session import LOG, Progress
from rig_study.studies import Studies

__all__ = ["add_run_options", "keep", "main", "sessions", "studies", "where"]


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="./rig study", description=__doc__)
    commands = result.add_subparsers(dest="command", required=True, metavar="COMMAND")

    plan = commands.add_parser("plan", help="who does what: groups, or the trials of one subject")
    plan.add_argument("protocol", help="path, or a name under config/protocols")
    plan.add_argument("--subject", help="as in S07; all subjects, one a line, if left out")

    session = commands.add_parser(
        "run",
        help="a subject's session on the live graph, trial by trial; a second call resumes it",
        description="Run a subject's session: start the graph, lead through the trials that are left, record each into "
        "a bag of its own. With Enter after each: p pauses after the trial, r repeats the last one, a aborts the "
        "running one, Enter alone goes on. Ctrl-C ends the session; the same command resumes it. With --display and "
        "without --subject, the operator chooses on the page whose session is led, one after the other.",
    )
    session.add_argument(
        "protocol", nargs="?", help="path, or a name under config/protocols; with --display all are offered if left out"
    )
    session.add_argument("--subject", help="as in S07; with --display it is chosen on the operator's page if left out")
    session.add_argument("--protocols", type=Path, metavar="DIR", help="a folder whose protocols are offered too")
    session.add_argument("--out", type=Path, help="folder of the study's sessions (under runs/)")
    session.add_argument("--display", action="store_true", help="a person at the browser page, not the simulated user")
    session.add_argument("--port", type=int, metavar="N", help="port of the page (8600)")
    session.add_argument("--host", metavar="ADDR", help="address to listen on (127.0.0.1); any other needs the token")
    session.add_argument(
        "--token", metavar="T", help="what a browser elsewhere must know (made and printed if not given)"
    )
    session.add_argument("--pacing", choices=("realtime", "lockstep"), default="realtime")
    session.add_argument("--compose", action="store_true", help="all nodes in one process")
    session.add_argument("--namespace", default="rig", help="stands in front of every topic (%(default)s)")

    status = commands.add_parser("status", help="how far each subject's session is")
    status.add_argument("protocol", help="path, or a name under config/protocols")
    status.add_argument("--out", type=Path, help="folder of the study's sessions (under runs/)")

    simulate = commands.add_parser("simulate", help="every trial of a protocol with virtual subjects")
    simulate.add_argument("protocol", help="path, or a name under config/protocols")
    simulate.add_argument("--cohort", default="learners", help="path, or a name under config/cohorts (%(default)s)")
    simulate.add_argument(
        "--graph",
        action="store_true",
        help="through the real graph, in lockstep, subject after subject: the same trials, each in a bag",
    )
    add_run_options(simulate)

    power = commands.add_parser(
        "power",
        help="how many subjects an effect needs, by cohorts drawn from a pilot",
        description="Draw cohorts from the subjects of a pilot and count in how many the interaction of group and set "
        "is found, with an exact binomial interval; then look for the fewest subjects that find it as often as wanted.",
    )
    power.add_argument("pilot", type=Path, help="folder or table of trials, simulated or analysed")
    power.add_argument("--measure", default="rms_error", help="of the subjects' means over a set (%(default)s)")
    power.add_argument("--subjects", type=int, nargs="+", default=[14, 28, 42, 56, 84], metavar="N", help="in all")
    power.add_argument(
        "--effect", type=float, metavar="D", help="wanted d between the groups' changes; 0: a null cohort"
    )
    power.add_argument("--power", type=float, default=0.8, help="how often it is to be found (%(default)s)")
    power.add_argument("--cohorts", type=int, default=2000, help="drawn for each number of subjects (%(default)s)")
    power.add_argument("--alpha", type=float, default=0.05, help="level of the test (%(default)s)")
    power.add_argument("--seed", type=int, default=0)
    power.add_argument("--sets", nargs=2, metavar="SET", help="before and after (first and last, if left out)")
    return result


def add_run_options(to: argparse.ArgumentParser) -> None:
    """What every command has that runs many trials."""
    to.add_argument("--out", type=Path, help="folder of the run, which a second call resumes (under runs/)")
    to.add_argument("--workers", type=int, help="processes; as many as there are cores, if left out")
    to.add_argument(
        "--scheduler",
        metavar="tls://HOST:PORT",
        help="a Dask scheduler, instead of processes here; it and its workers can run code here, for Dask pickles. "
        "tcp:// only on this machine (tcp://127.0.0.1:PORT)",
    )
    to.add_argument(
        "--trusted-network",
        action="store_true",
        help="a tcp:// scheduler on another machine: everybody who can reach it may run code here and there",
    )


def where(options: argparse.Namespace) -> dict[str, Any]:
    """What these say of where the trials run, for :func:`rig_study.runs.run`."""
    return {name: getattr(options, name) for name in ("workers", "scheduler", "trusted_network")}


def main(argv: Sequence[str], conduct: Callable[[argparse.Namespace], int] | None = None) -> int:
    """Returns 0, or 2 for bad input; 130 if interrupted, and then the same call goes on where it stopped.

    ``conduct`` runs a session: it starts a graph, of which this package knows nothing.
    """
    options = parser().parse_args(argv)
    commands = {"plan": _plan, "run": conduct or _no_graph, "status": _status, "simulate": _simulate, "power": _power}
    if options.command == "simulate" and options.graph:
        commands["simulate"] = conduct or _no_graph
    return carry_out(lambda: commands[options.command](options), resumes=True)


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


def _no_graph(_: argparse.Namespace) -> int:
    raise StudyError("a session needs the graph; start it with ./rig study run")


def studies(options: argparse.Namespace) -> Studies:
    """What `study run --display` lets the operator choose from.

    Raises
    ------
    StudyError: there is nothing to choose from, or no page to choose on.
    """
    if not options.display:
        raise StudyError(
            "study run: a protocol and --subject are needed, as in: ./rig study run demo --subject S07; with --display "
            "the operator can choose them on the page"
        )
    if options.protocol is not None:
        protocol = load_protocol(options.protocol)
        folder = sessions(options, protocol).resolve()
        return Studies([protocol.file.path], lambda _: folder)
    sources = folders("protocols")
    if options.protocols is not None:
        if not options.protocols.is_dir():
            raise StudyError(f"--protocols {options.protocols}: is no folder")
        sources.append(options.protocols)
    root = (options.out or Path("runs")).resolve()
    return Studies(sources, lambda name: root / f"study_{name}")


def sessions(options: argparse.Namespace, protocol: Protocol) -> Path:
    """Where the sessions of a study are, a folder for each subject."""
    name = f"study_{protocol.file.path.stem}"
    if options.command == "simulate":
        name += f"_{Path(options.cohort).stem}" + ("_graph" if options.graph else "")
    return options.out or Path("runs") / name


def _status(options: argparse.Namespace) -> int:
    protocol = load_protocol(options.protocol)
    folder = sessions(options, protocol)
    print(f"{protocol.name} in {folder}\n{'subject':10}{'group':12}{'trials':>9}{'aborted':>9}{'left':>11}  last")
    for subject, group in protocol.subjects.items():
        found = Progress(protocol, subject)
        if (folder / subject / LOG).exists():
            found.read(folder / subject / LOG)
        done = f"{len(found.done)}/{len(found.plan)}"
        left = f"{found.remaining / 60.0:.1f} min"
        print(f"{subject:10}{group:12}{done:>9}{found.aborted:>9}{left:>11}  {found.last or 'not begun'}")
    return 0


def _simulate(options: argparse.Namespace) -> int:
    protocol, cohort = load_protocol(options.protocol), cohorts.load_cohort(options.cohort)
    folder = sessions(options, protocol)
    shown = progress(protocol.file.path.stem)
    jobs = cohorts.jobs(protocol, cohort)
    rows = run(jobs, folder, **where(options), report=shown)
    keep(protocol, cohort, rows, folder)
    print(f"{len(rows)} trials of {len(protocol.subjects)} subjects: {folder / 'trials.parquet'}")
    print(f"next: ./rig analyze {folder} --out {folder / 'report'}")
    return 0


def keep(protocol: Protocol, cohort: cohorts.Cohort, rows: Sequence[Row], folder: Path) -> None:
    """The table of a simulated study, with protocol and cohort as used beside it.

    Raises
    ------
    StudyError: the folder cannot be written.
    """
    write_table(rows, folder / "trials.parquet")
    (folder / "protocol.yaml").write_text(protocol.file.text, encoding="utf-8")
    (folder / "cohort.yaml").write_text(cohort.file.text, encoding="utf-8")


def _power(options: argparse.Namespace) -> int:
    # Imported here: plans and simulations need no tables.
    from rig_study.power import changes, needed, power
    from rig_study.statistics_anova import cells
    from rig_study.tables import read, subjects

    table = subjects(read([options.pilot]).trials)
    if options.measure not in table:
        raise StudyError(f"measure: {options.measure!r} is not there; the table has {', '.join(table.columns[4:])}")
    sets = options.sets or [min(table["set"]), max(table["set"])]
    pilot = changes(cells(table, options.measure, sets))
    wanted = "the pilot's own effect" if options.effect is None else f"d = {options.effect:g}"
    print(f"{options.measure}, {sets[0]} to {sets[1]}, {wanted}, {options.cohorts} cohorts, alpha {options.alpha:g}")
    print(f"{'subjects':>8}  {'groups':>26}  {'found':>7}  95 % interval")
    how = {"effect": options.effect, "cohorts": options.cohorts, "alpha": options.alpha, "seed": options.seed}
    for row in power(pilot, options.subjects, **how):
        groups = " + ".join(f"{size} {name}" for size, name in zip(row.sizes, pilot, strict=True))
        print(f"{row.subjects:8}  {groups:>26}  {row.rate:7.3f}  {row.low:.3f} to {row.high:.3f}")
    if options.effect != 0.0:
        found = needed(pilot, options.power, **how)
        said = (
            "more than 2,000 subjects" if found is None else f"{found.subjects} subjects ({found.low} to {found.high})"
        )
        print(f"to find it {options.power:g} of the time: {said}")
    return 0
