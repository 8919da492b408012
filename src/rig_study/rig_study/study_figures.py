"""Figures of a study and of many trials: groups by set, PRA against skill, convergence, conditions compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rig_study.figure_style import ALLOWED, LINES, SUCCESS, WIDTH, axes, label, plain, row, spans, wrapped
from rig_study.recorded import RecordedTrial
from rig_study.study_statistics import MEASURES
from shared_control import tasks
from shared_control.tasks.task import Task
from shared_control.trial import TrialResult

__all__ = [
    "Example",
    "comparison",
    "convergence",
    "example",
    "group_bars",
    "named",
    "rejection_and_skill",
    "running",
    "stars",
]

#: Names and units of what is no measure of the study's statistics.
_OTHERS = {
    "success": ("success rate", ""),
    "pra": ("PRA", ""),
    "fell": ("share that fell", ""),
    "override": ("override", ""),
    "mean_speed": ("mean speed", "m/s"),
}
#: A group is told by its grey as well as by its colour, and by its hatch.
_GROUPS = ((LINES[1], ""), ("#F0E442", "//"), (LINES[4], "xx"), (LINES[2], ".."))


def named(measure: str) -> str:
    """A measure as a reader has it, with its unit."""
    name, unit = {**MEASURES, **_OTHERS}.get(measure, (measure.replace("_", " "), ""))
    return f"{name} [{unit}]" if unit else name


def stars(p: float | None) -> str:
    """The marks of the paper: * p < 0.05, ** p < 0.01, *** p < 0.001."""
    return "" if p is None else "*" * sum(p < level for level in (0.05, 0.01, 0.001))


def group_bars(means: pd.DataFrame, statistics: dict[str, Any]) -> Figure:
    """Mean and standard error of each measure, by group and set; marks of the groups' difference (Welch, Holm)."""
    measures = [name for name in MEASURES if name in means]
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    panels = figure.subplots(2, 2, squeeze=False).ravel()
    sets, groups = sorted(set(means["set"])), sorted(set(means["group"]))
    for ax, measure in zip(panels, measures, strict=False):
        plain(ax)
        width, tops = 0.8 / len(groups), np.zeros(len(sets))
        for g, group in enumerate(groups):
            its = means[means["group"] == group].groupby("set")[measure]
            mean, error = its.mean().reindex(sets), its.sem().reindex(sets).fillna(0.0)
            colour, hatch = _GROUPS[g % len(_GROUPS)]
            places = np.arange(len(sets)) + (g - 0.5 * (len(groups) - 1)) * width
            ax.bar(
                places, mean, width, yerr=error, color=colour, hatch=hatch, edgecolor="#222222", lw=0.8, capsize=4,
                label=group,
            )  # fmt: skip
            tops = np.fmax(tops, (mean + error).to_numpy())
        for place, (set_, top) in enumerate(zip(sets, tops, strict=True)):
            for name, test in statistics.get("two_sample", {}).items():
                if name.startswith(f"{measure}, {set_},"):
                    ax.text(place, top, stars(test.get("p_holm")), ha="center", va="bottom", fontsize="large")
        ax.set_xticks(range(len(sets)), sets)
        ax.margins(y=0.15)
        label(ax, *MEASURES[measure])
    for ax in panels[len(measures) :]:
        ax.set_visible(False)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(groups), frameon=False)
    return figure


def rejection_and_skill(trials: pd.DataFrame, first: str) -> Figure | None:
    """PRA of each filtered trial against the subject's success rate in the first set; the line of least squares."""
    filtered = trials[(trials["mode"] != "off") & trials["pra"].notna()]
    skill = trials[trials["set"] == first].astype({"success": float}).groupby("subject")["success"].mean()
    filtered = filtered[filtered["subject"].isin(skill.index)]
    if filtered.empty:
        return None
    x, y = skill.loc[filtered["subject"]].to_numpy(), filtered["pra"].to_numpy()
    figure, (ax,) = row(1, 4.2, 7.0)
    ax.plot(x, y, "o", ms=5, mfc="none", color=LINES[0], alpha=0.6, label="one trial")
    if np.ptp(x) > 0.0:
        slope, offset = np.polyfit(x, y, 1)
        ends = np.array([x.min(), x.max()])
        r = np.corrcoef(x, y)[0, 1]
        ax.plot(ends, offset + slope * ends, color=LINES[2], lw=2, label=f"least squares, r = {r:.2f}")
    ax.set_xlabel(f"success rate in {first}, without filter")
    ax.set_ylabel("PRA under the filter")
    ax.legend(frameon=False)
    return figure


def convergence(trials: pd.DataFrame) -> Figure | None:
    """Two states of every trial over time, with median and quartiles; for tables with traces."""
    names = [column for column in trials.columns if column.startswith("trace.")]
    if not names:
        return None
    shown = [names[0], names[2]] if len(names) > 2 else names
    task = tasks.get(str(trials["task"].iloc[0]))
    units = dict(zip((f"trace.{name}" for name in task.state_names), task.state_units, strict=True))
    figure, panels = axes(len(shown), 2.2)
    step = float(trials["trace_step"].iloc[0])
    for ax, name in zip(panels, shown, strict=True):
        runs = [np.asarray(values, dtype=float) for values in trials[name]]
        angle = units[name] == "rad"
        for number, values in enumerate(runs):
            shown_values, name_once = wrapped(values) if angle else values, "a trial" if number == 0 else None
            time = step * np.arange(len(values))
            ax.plot(time, shown_values, color="#666666", lw=0.5, alpha=0.35, label=name_once)
        length = min(map(len, runs))
        table = np.array([values[:length] for values in runs])
        if angle:
            # Of an angle the magnitude says how far it is from upright.
            table = np.abs(np.arctan2(np.sin(table), np.cos(table)))
            ax.set_yticks([-np.pi, 0.0, np.pi], ["-\u03c0", "0", "\u03c0"])
        low, middle, high = np.percentile(table, [25, 50, 75], axis=0)
        time = step * np.arange(length)
        ax.fill_between(time, low, high, color=LINES[1], alpha=0.35, lw=0, label="quartiles")
        ax.plot(time, middle, color=LINES[1], lw=2, label="median")
        ax.margins(x=0.0)
        label(ax, name.removeprefix("trace."), units[name])
    panels[-1].set_xlabel("trial time [s]")
    figure.legend(*panels[-1].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
    return figure


def running(trials: pd.DataFrame, by: list[str]) -> Figure | None:
    """Height and speed of a runner's mass, a condition a row: its first trial. Broad where the user was overridden."""
    if not {"trace.z_m", "trace.x_m_dot", "trace_intervened"} <= set(trials.columns):
        return None
    conditions = trials[trials["task"] == "slip"].groupby(by, sort=False).head(1)
    if conditions.empty:
        return None
    figure = Figure(figsize=(WIDTH, 2.6 * len(conditions)), layout="constrained")
    panels = figure.subplots(len(conditions), 2, sharex=True, sharey="col", squeeze=False)
    for (height, speed), (_, trial) in zip(panels, conditions.iterrows(), strict=True):
        intervened = np.asarray(trial["trace_intervened"], dtype=float)
        time = trial["trace_step"] * np.arange(len(intervened))
        # After a fall there is nothing to see.
        shown = time <= trial["fall_time"]
        for ax, name in ((height, "trace.z_m"), (speed, "trace.x_m_dot")):
            plain(ax)
            values = np.asarray(trial[name], dtype=float)[: len(time)]
            ax.plot(time[shown], values[shown], color=LINES[0], lw=0.8)
            overridden = np.where(shown & (intervened >= 0.5), values, np.nan)
            ax.plot(time, overridden, color=LINES[2], lw=2.6, alpha=0.8, label="overridden")
            if trial["fell"]:
                ax.axvline(trial["fall_time"], color=LINES[0], ls="--", lw=1)
        if trial["fell"]:
            height.annotate(
                f" falls at {trial['fall_time']:.1f} s", (trial["fall_time"], 0.9), xycoords=("data", "axes fraction")
            )
        wanted = trial.get("trace_wanted_speed")
        if isinstance(wanted, (list, np.ndarray)):
            speed.plot(
                time, np.asarray(wanted, dtype=float)[: len(time)], color=LINES[1], lw=1.4, ls=":", label="wanted"
            )
        height.set_title(", ".join(str(trial[key]).replace("_", " ") for key in by), loc="left", fontsize="medium")
        speed.set_title(f"overridden {100 * trial['override']:.0f} % of the time", loc="left", fontsize="medium")
        label(height, "height", "m")
        label(speed, "speed", "m/s")
    for ax in panels[-1]:
        ax.set_xlabel("trial time [s]")
    handles = {
        text: handle for ax in panels[:, 1] for handle, text in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles, loc="outside upper right", ncols=len(handles), frameon=False)
    return figure


def comparison(trials: pd.DataFrame, by: list[str], measures: list[str]) -> Figure:
    """Mean and standard error of measures for each condition; the conditions ran the same seeds."""
    keys = trials[by].astype(str).agg(", ".join, axis=1)
    # Those that share the first parameter stand together.
    first = list(dict.fromkeys(trials[by[0]].astype(str)))
    order = sorted(dict.fromkeys(keys), key=lambda key: first.index(key.split(", ")[0]))
    figure = Figure(figsize=(WIDTH, 1.0 + 0.32 * len(order)), layout="constrained")
    panels = figure.subplots(1, len(measures), sharey=True, squeeze=False)[0]
    for ax, measure in zip(panels, measures, strict=True):
        plain(ax)
        ax.grid(visible=False, axis="y")
        its = trials.assign(**{measure: trials[measure].astype(float)}).groupby(keys)[measure]
        mean, error = its.mean().reindex(order), its.sem().reindex(order).fillna(0.0)
        ax.barh(range(len(order)), mean, xerr=error, color=LINES[1], edgecolor="#222222", lw=0.8, capsize=3, height=0.7)
        ax.set_xlabel(named(measure))
    panels[0].set_yticks(range(len(order)), order)
    panels[0].invert_yaxis()
    return figure


@dataclass(frozen=True)
class Example:
    """What is drawn of one trial, recorded or headless: N ticks."""

    time: np.ndarray  # (N,) [s]
    force: np.ndarray  # (N, 3) [N] the user's
    accepted: np.ndarray  # (N,) bool
    state: np.ndarray  # (N,) the first
    success: np.ndarray  # (N,) bool: in the success region
    name: str  # of the state
    unit: str

    @classmethod
    def recorded(cls, trial: RecordedTrial) -> Example:
        """From a bag."""
        known = trial.trial
        return cls(
            trial.time, trial.user_force, trial.verdict == 0, trial.states[:, 0], trial.in_success_region,
            known.state_names[0], known.state_units[0],
        )  # fmt: skip

    @classmethod
    def headless(cls, trial: TrialResult, task: Task) -> Example:
        """From a run without the graph."""
        inside = np.array([task.success_region(x) for x in trial.states[:-1]])
        return cls(
            trial.time, trial.user_force, trial.verdict == 0, trial.states[:-1, 0], inside,
            task.state_names[0], task.state_units[0],
        )  # fmt: skip


def example(trial: Example) -> Figure:
    """The user's force, what was allowed of it marked, and the first state with the success region in green."""
    pushed = [k for k in range(3) if np.any(trial.force[:, k])] or [0]
    figure, panels = axes(len(pushed) + 1, 2.2)
    for ax, k in zip(panels, pushed, strict=False):
        _force(ax, trial, k)
        label(ax, f"force of the user, {'xyz'[k]}", "N")
    bottom = panels[-1]
    sample = trial.time[1] - trial.time[0] if len(trial.time) > 1 else 0.0
    for first, last in spans(trial.success):
        bottom.axvspan(trial.time[first], trial.time[last - 1] + sample, color=SUCCESS, lw=0)
    angle = trial.unit == "rad"
    bottom.plot(trial.time, wrapped(trial.state) if angle else trial.state, color=LINES[0], lw=1.2)
    if angle:
        bottom.set_ylim(-3.4, 3.4)
        bottom.set_yticks([-np.pi, 0.0, np.pi], ["-\u03c0", "0", "\u03c0"])
    label(bottom, trial.name, trial.unit)
    bottom.set_xlabel("trial time [s]")
    for ax in panels:
        ax.margins(x=0.0)
    handles, labels = panels[0].get_legend_handles_labels()
    handles.append(Patch(color=SUCCESS))
    figure.legend(handles, [*labels, "in the success region"], loc="outside upper right", ncols=3, frameon=False)
    return figure


def _force(ax: Axes, trial: Example, axis: int) -> None:
    """One axis of it, each tick's held to the next; allowed ticks filled down to zero."""
    sample = trial.time[1] - trial.time[0] if len(trial.time) > 1 else 0.0
    # Both ends of each tick, so that one that stands alone is as wide as it lasts.
    time = np.repeat(np.append(trial.time, trial.time[-1] + sample), 2)[1:-1]
    force = np.repeat(trial.force[:, axis], 2)
    ax.fill_between(time, force, where=np.repeat(trial.accepted, 2), color=ALLOWED, lw=0, label="allowed")
    ax.plot(time, force, color=LINES[0], lw=0.5, label="force of the user")
