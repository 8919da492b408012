"""The report of one recorded trial: a table for the terminal, and one self-contained HTML page with figures."""

from __future__ import annotations

import html
import math
from pathlib import Path

import numpy as np

from rig_study.recorded import MODES, PACINGS, PHASES, RecordedTrial, TrialError, load, measured
from shared_control import measures
from shared_control.scenario import ScenarioError

_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
 body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; color: #222;
        background: #fff }}
 h1 {{ font-size: 1.6rem; margin-bottom: 0 }} h2 {{ font-size: 1.15rem; margin-top: 2rem }}
 table {{ border-collapse: collapse; margin: 1rem 0 }} td {{ padding: .2rem 1.5rem .2rem 0; vertical-align: top }}
 td:first-child {{ color: #666 }} figure {{ margin: 0 }} svg {{ width: 100%; height: auto }}
 code {{ overflow-wrap: anywhere }} .columns {{ display: flex; flex-wrap: wrap; gap: 0 4rem }}
</style>
<h1>{title}</h1><p>{lead}</p>
<div class="columns">{tables}</div>
{figures}
</html>
"""


def rows(trial: RecordedTrial) -> dict[str, dict[str, str]]:
    """What the tables show, group by group."""
    state = trial.trial
    shares = trial.shares()
    about = {
        "task": state.task,
        "scenario": state.scenario or "-",
        "seed": str(state.seed),
        "filter": " then ".join(dict.fromkeys(MODES[mode] for mode in trial.mode)),
        "pacing": PACINGS[state.pacing],
        "ended": f"{PHASES[state.phase]}: {state.message}",
    }
    if state.subject:
        about["subject"] = f"{state.subject}, group {state.group}, set {state.set}, trial {state.trial}"
    filtered = {name: f"{100 * share:.1f} %" for name, share in shares.items()}
    timing = {
        "ticks, decisions": f"{trial.ticks_recorded}, {trial.decisions_recorded} of {state.ticks_planned}",
        "missed deadlines": str(state.missed_deadlines),
    }
    if trial.ticks_recorded < state.ticks_published:
        timing["missing in the bag"] = (
            f"{state.ticks_published - trial.ticks_recorded} ticks; what is said is of the rest"
        )
    if trial.realtime:
        timing |= {
            "decision, p50 / p99": _percentiles(trial.compute_time * 1e6, "us"),
            "state to decision, p50 / p99": _percentiles(trial.state_age * 1e6, "us"),
            "tick interval, p1 / p99": _percentiles(np.diff(trial.received) * 1e-6, "ms", (1, 99)),
        }
    tables = {"Trial": about, "Task": _measures(trial), "Filter": filtered, "Loop": timing}
    if trial.hops:
        latency = {name: _percentiles(1e6 * seconds, "us", (50, 90, 99)) for name, seconds in trial.hops.items()}
        tables["Latency"] = {"percentiles": "50 / 90 / 99", **latency}
    return tables


def _percentiles(values: np.ndarray, unit: str, which: tuple[int, ...] = (50, 99)) -> str:
    known = values[~np.isnan(values)]
    if not len(known):
        return "-"
    return f"{' / '.join(map(_short, np.percentile(known, which)))} {unit}"


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _measures(trial: RecordedTrial) -> dict[str, str]:
    try:
        found = measured(trial)
    except (TrialError, ScenarioError) as error:
        return {"measures": f"unknown: {error}"}
    if isinstance(found, measures.CartPendulumMeasures):
        return _cart_pendulum(found)
    if isinstance(found, measures.SlipMeasures):
        return _slip(found)
    return {"in success region": f"{100 * float(np.mean(trial.in_success_region)):.1f} % of the time"}


def _cart_pendulum(found: measures.CartPendulumMeasures) -> dict[str, str]:
    return {
        "success": "yes" if found.success else "no",
        "time to success": f"{found.time_to_success:.2f} s",
        "balance time": f"{found.balance_time:.2f} s",
        "RMS error (1: hanging)": f"{found.rms_error:.3f}",
        "rejected to success": _percent(found.pra),
        "cart excursion": f"{found.cart_excursion:.2f} m",
    }


def _slip(found: measures.SlipMeasures) -> dict[str, str]:
    return {
        "fell": f"at {found.fall_time:.2f} s" if found.fell else "no",
        "override": _percent(found.override),
        "mean speed": f"{found.mean_speed:.3f} m/s",
    }


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.1f} %"


def summarize(bag: str | Path) -> str:
    """The tables as text, one under the other.

    Raises
    ------
    TrialError, BagError: as :func:`rig_study.recorded.load`.
    """
    tables = rows(load(bag))
    width = max(len(key) for values in tables.values() for key in values)
    return "\n".join(
        f"{group if first else '':8}{key:{width}}  {value}"
        for group, values in tables.items()
        for first, (key, value) in ((index == 0, item) for index, item in enumerate(values.items()))
    )


def write_report(bag: str | Path, path: Path) -> Path:
    """Write the HTML report of a bag; return where it is.

    Raises
    ------
    TrialError, BagError: as :func:`rig_study.recorded.load`.
    """
    from rig_study import figures

    trial = load(bag)
    drawn = [
        ("State", "Green: inside the success region.", figures.states(trial)),
        ("Control", "Background: the verdict of each tick.", figures.controls(trial)),
        ("Control, two seconds of it", "", figures.controls(trial, window=2.0)),
        ("Criterion", "An action is accepted where it is at or below the threshold.", figures.criterion(trial)),
    ]
    if trial.realtime:
        drawn.append(("Timing", "Wall time, as recorded with each decision.", figures.timing(trial)))
    path.write_text(
        _PAGE.format(
            title=html.escape(f"Trial: {trial.trial.scenario or trial.trial.task}"),
            lead=f"Recorded in <code>{html.escape(str(trial.bag))}</code>",
            tables="".join(_table(group, values) for group, values in rows(trial).items()),
            figures="".join(_figure(*item) for item in drawn),
        ),
        encoding="utf-8",
    )
    return path


def _table(title: str, values: dict[str, str]) -> str:
    cells = "".join(f"<tr><td>{html.escape(key)}<td>{html.escape(value)}" for key, value in values.items())
    return f"<section><h2>{title}</h2><table>{cells}</table></section>"


def _figure(title: str, caption: str, svg: str) -> str:
    return f"<h2>{title}</h2><figure>{svg}<figcaption>{caption}</figcaption></figure>"
