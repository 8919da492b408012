"""``rederive BAG``: whether the filter, given what a bag holds, decides as it did; or what another would have said."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rig_study.changes import apply, value_from_text
from rig_study.commands import carry_out
from rig_study.declared import StudyError
from rig_study.recorded import VERDICTS, load
from rig_study.recorded_inputs import RecordedInputs, load_inputs, user_forces
from rig_study.rederive import Rederived, rederive, simulate
from rig_study.trial_report import rows
from shared_control.scenario import Scenario, ScenarioError

__all__ = ["main"]

#: What `--set` may change: the user is the recorded one.
_NODES = ("mig_filter", "admittance_sim", "task_sim")

_CAUTION = (
    "A counterfactual on the recorded states and wrenches: from the first other verdict on, the trajectory itself\n"
    "would have been another one. --closed-loop simulates that."
)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="./rig rederive",
        description="Run the filter again over the states and wrenches of a bag, without ROS. With the recorded "
        "configuration every decision must be the same to the last bit (exit status 0), or the first that is not is "
        "shown (1). With --set: what another filter would have said.",
    )
    result.add_argument("bag", type=Path, help="bag of one trial")
    result.add_argument(
        "--set",
        dest="changes",
        action="append",
        default=[],
        metavar="NODE.KEY=VALUE",
        help="change a parameter, as in mig_filter.horizon=1.2; may be repeated",
    )
    result.add_argument("--scenario", help="name or path, where none is attached to the bag")
    result.add_argument(
        "--closed-loop",
        action="store_true",
        help="simulate the whole loop again, with the recorded force as a user who does not look",
    )
    result.add_argument(
        "--plot", type=Path, metavar="FILE", help="SVG of a changed filter (default: rederive.svg beside the bag)"
    )
    return result


def main(argv: Sequence[str]) -> int:
    """Returns 0 if all is as recorded, or was changed on purpose; 1 if not; 2 for bad input."""
    arguments = parser().parse_args(argv)
    return carry_out(lambda: _rederive(arguments))


def _rederive(arguments: argparse.Namespace) -> int:
    inputs = load_inputs(arguments.bag, arguments.scenario)
    changed = _changed(inputs.scenario, arguments.changes, closed_loop=arguments.closed_loop)
    if arguments.closed_loop:
        return _closed_loop(inputs, changed)
    derived = rederive(inputs, changed)
    if inputs.dropped:
        print(f"note: {inputs.dropped} decisions at the end are left out: their state or wrench is not in the bag")
    speed = f"{len(derived.decisions)} decisions in {derived.seconds:.2f} s"
    if changed == inputs.scenario:
        return _same(derived, speed)
    print(f"{arguments.bag} with {', '.join(arguments.changes)}: {speed}\n{_CAUTION}\n\n{_table(derived)}")
    return _plot(derived, arguments.plot or arguments.bag.resolve().parent / "rederive.svg", arguments.changes)


def _changed(scenario: Scenario, changes: Sequence[str], *, closed_loop: bool) -> Scenario:
    values: dict[str, Any] = {}
    for change in changes:
        name, equals, text = change.partition("=")
        node = name.partition(".")[0]
        if not equals or "." not in name or node not in _NODES:
            raise ScenarioError(f"--set {change}: write NODE.KEY=VALUE with NODE one of {', '.join(_NODES)}")
        if node != "mig_filter" and not closed_loop:
            raise ScenarioError(
                f"--set {change}: only --closed-loop simulates {node}; the filter alone does not ask it"
            )
        values[name] = value_from_text(name, text, "--set")
    return apply(scenario, values, "--set")


def _same(derived: Rederived, speed: str) -> int:
    difference = derived.difference()
    if difference is None:
        print(f"identical: {speed}, each the same as recorded to the last bit")
        return 0
    print(f"NOT as recorded: {speed}\n{difference.text()}")
    return 1


def _table(derived: Rederived) -> str:
    confusion = derived.confusion()
    total = max(int(confusion.sum()), 1)
    lines = [f"{'verdict':10} {'recorded':>10} {'this filter':>12}"]
    for place, name in enumerate(VERDICTS):
        shares = (100 * confusion[place].sum() / total, 100 * confusion[:, place].sum() / total)
        lines.append(f"{name:10} {shares[0]:8.1f} % {shares[1]:10.1f} %")
    lines += [
        "",
        f"{'decisions: recorded, below; this filter, right':48}" + "".join(f"{name:>10}" for name in VERDICTS),
    ]
    for name, counts in zip(VERDICTS, confusion, strict=True):
        lines.append(f"{name:48}" + "".join(f"{count:10}" for count in counts))
    other = total - int(np.trace(confusion))
    lines.append(f"\n{other} of {total} verdicts ({100 * other / total:.1f} %) would have been others")
    return "\n".join(lines)


def _plot(derived: Rederived, path: Path, changes: Sequence[str]) -> int:
    # Imported here: who only compares pays for no figures.
    from rig_study.figures import counterfactual

    try:
        path.write_text(counterfactual(derived, ", ".join(changes)), encoding="utf-8")
    except OSError as error:
        raise StudyError(f"{path} cannot be written: {error.strerror}") from None
    print(f"plot  {path}")
    return 0


def _closed_loop(inputs: RecordedInputs, changed: Scenario) -> int:
    recorded = load(inputs.bag)
    result = simulate(inputs, user_forces(inputs.bag), changed)
    count = min(len(recorded.time), len(result.time))
    task = changed.loop.make_task()
    again = replace(
        recorded,
        time=result.time,
        states=result.states[:-1],
        in_success_region=np.array([task.success_region(x) for x in result.states[:-1]]),
        user_control=result.user_control,
        applied_control=result.applied_control,
        verdict=result.verdict,
        criterion=result.criterion,
    )
    print(f"{inputs.bag}: the loop simulated again; the user's force is the recorded one, and does not react\n")
    print(f"{'':28} {'recorded':>14} {'simulated':>14}")
    tables = rows(recorded), rows(again)
    for group in ("Task", "Filter"):
        for key, value in tables[0][group].items():
            print(f"{key:28} {value:>14} {tables[1][group][key]:>14}")
    differs = np.flatnonzero(np.any(recorded.states[:count] != again.states[:count], axis=1))
    if len(differs):
        print(f"\nthe states are the same up to tick {differs[0] - 1}, and others from then on")
    else:
        print(f"\nall {count} states are the same to the last bit")
    unchanged = changed == inputs.scenario and not recorded.realtime
    return int(unchanged and bool(len(differs)))
