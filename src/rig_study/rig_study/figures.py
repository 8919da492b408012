"""Figures of a recorded trial, as SVG text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from rig_study.figure_style import LINES, SUCCESS, VERDICT_COLOURS, label, spans, svg, wrapped
from rig_study.figure_style import axes as axes_of
from rig_study.recorded import VERDICTS, RecordedTrial

if TYPE_CHECKING:
    from rig_study.rederive import Rederived


def states(trial: RecordedTrial) -> str:
    """Each state over time; angles wrapped to (-pi, pi]; the success region marked."""
    names: Sequence[str] = trial.trial.state_names
    units: Sequence[str] = trial.trial.state_units
    figure, axes = axes_of(len(names), 1.5)
    box = _success_box(trial.trial.task)
    for index, (ax, name, unit) in enumerate(zip(axes, names, units, strict=True)):
        values = trial.states[:, index]
        if unit == "rad":
            values = wrapped(values)
        for first, last in spans(trial.in_success_region):
            ax.axvspan(trial.time[first], trial.time[last - 1] + trial.sample_time, color=SUCCESS, lw=0)
        if index in box:
            ax.axhspan(-box[index], box[index], facecolor="none", edgecolor="#009E73", ls="--", lw=1)
        ax.plot(trial.time, values, color=LINES[0], lw=1)
        label(ax, name, unit)
    axes[-1].set_xlabel("trial time [s]")
    figure.legend(
        handles=[
            Patch(color=SUCCESS, label="in the success region"),
            Patch(facecolor="none", edgecolor="#009E73", ls="--", label="success box"),
        ],
        loc="outside upper right",
        ncols=2,
        frameon=False,
    )
    return svg(figure)


def _success_box(task: str) -> dict[int, float]:
    """Half width of the success box for each state that it bounds."""
    if task != "cart_pendulum":
        return {}
    from shared_control.tasks.cart_pendulum import CartPendulum

    return {0: CartPendulum.success_angle, 1: CartPendulum.success_rate}


def controls(trial: RecordedTrial, window: float | None = None) -> str:
    """User's and applied control over time with the verdicts behind; the first `window` seconds if it is given."""
    until = len(trial.time) if window is None else min(len(trial.time), round(window / trial.sample_time))
    names: Sequence[str] = trial.trial.control_names
    units: Sequence[str] = trial.trial.control_units
    figure, axes = axes_of(len(names), 2.6)
    time, verdict = trial.time[:until], trial.verdict[:until]
    for index, (ax, name, unit) in enumerate(zip(axes, names, units, strict=True)):
        user, applied = trial.user_control[:until, index], trial.applied_control[:until, index]
        _shade(ax, time, verdict, trial.sample_time)
        ax.step(time, user, where="post", color="#888888", lw=0.8 if window else 0.4, label="user")
        ax.step(time, applied, where="post", color=LINES[0], lw=1.4 if window else 0.6, label="applied")
        label(ax, name, unit)
    axes[-1].set_xlabel("trial time [s]")
    lines, labels = axes[0].get_legend_handles_labels()
    patches: list[Any] = [
        Patch(color=colour, alpha=0.35, label=name) for name, colour in zip(VERDICTS, VERDICT_COLOURS, strict=True)
    ]
    figure.legend(
        handles=[*lines, *patches], labels=[*labels, *VERDICTS], loc="outside upper right", ncols=5, frameon=False
    )
    return svg(figure)


def _shade(ax: Axes, time: np.ndarray, verdict: np.ndarray, sample: float) -> None:
    # One picture instead of thousands of rectangles.
    ax.imshow(
        verdict[np.newaxis, :],
        extent=(time[0], time[-1] + sample, 0.0, 1.0),
        transform=ax.get_xaxis_transform(),
        aspect="auto",
        cmap=ListedColormap(VERDICT_COLOURS),
        vmin=0,
        vmax=2,
        alpha=0.35,
        interpolation="nearest",
        zorder=0,
    )


def criterion(trial: RecordedTrial) -> str:
    """The integral of the mode insertion gradient, by verdict, on a scale that is linear around zero."""
    figure, (ax,) = axes_of(1, 2.6)
    for number, (name, colour) in enumerate(zip(VERDICTS, VERDICT_COLOURS, strict=True)):
        chosen = trial.verdict == number
        ax.plot(trial.time[chosen], trial.criterion[chosen], ".", ms=2, color=colour, label=name)
    _linear_around_zero(ax, trial.criterion)
    ax.axhline(0.0, color=LINES[0], lw=0.8)
    ax.set_xlabel("trial time [s]")
    label(ax, "criterion", "unit of the cost")
    figure.legend(loc="outside upper right", ncols=3, frameon=False, markerscale=5)
    return svg(figure)


def _linear_around_zero(ax: Axes, values: np.ndarray) -> None:
    """A logarithmic scale that is linear up to the power of ten above the median, so that no labels meet at zero."""
    sizes = np.abs(values[np.isfinite(values)])
    median = float(np.median(sizes)) if sizes.size else 0.0
    ax.set_yscale("symlog", linthresh=10.0 ** np.ceil(np.log10(median)) if median > 0 else 1.0)


def timing(trial: RecordedTrial) -> str:
    """Time from tick to tick, from state to decision, and in the decision itself; late ticks marked."""
    figure, axes = axes_of(3, 1.6)
    axes[0].plot(trial.time[1:], np.diff(trial.received) * 1e-6, lw=0.5, color=LINES[0])
    label(axes[0], "tick interval", "ms")
    for tick in np.flatnonzero(trial.held):
        axes[0].axvline(trial.time[tick], color=VERDICT_COLOURS[1], lw=0.8)
    for ax, values, name in (
        (axes[1], trial.state_age, "state to decision"),
        (axes[2], trial.compute_time, "decision"),
    ):
        ax.plot(trial.time, values * 1e6, ".", ms=1.5, color=LINES[1])
        ax.set_yscale("log")
        label(ax, name, "us")
    axes[-1].set_xlabel("trial time [s]")
    return svg(figure)


#: [s] over which differing verdicts are counted.
_WINDOW = 0.5


def counterfactual(derived: Rederived, title: str) -> str:
    """Criterion, verdicts and applied control of each decision, as recorded and as another filter would have it."""
    recorded, other = derived.inputs.decisions, derived.decisions
    sample = derived.inputs.scenario.loop.sample_time
    time = recorded["tick"] * sample
    figure, axes = axes_of(4 + other["applied_control"].shape[1], 1.7)
    figure.suptitle(
        f"{title}\nA counterfactual on the recorded states and wrenches: the trajectory would have been another one",
        fontsize="medium",
    )
    for values, name, colour in ((recorded, "recorded", "#888888"), (other, "this filter", LINES[1])):
        axes[0].plot(time, values["criterion"], ".", ms=2, color=colour, label=name)
    _linear_around_zero(axes[0], recorded["criterion"])
    axes[0].axhline(0.0, color=LINES[0], lw=0.8)
    label(axes[0], "criterion", "unit of the cost")
    for ax, values, name in ((axes[1], recorded, "recorded"), (axes[2], other, "this filter")):
        _shade(ax, time, values["verdict"], sample)
        ax.set_yticks([])
        ax.set_ylabel(name)
    # A user that is noise has verdicts too short to be seen; how many of them differ, and when, can be.
    window = np.ones(max(1, min(round(_WINDOW / sample), len(time))))
    # At the begin and the end of the trial the window holds fewer.
    there = np.convolve(np.ones(len(time)), window, "same")
    differs = np.convolve(recorded["verdict"] != other["verdict"], window, "same") / there
    axes[3].fill_between(time, 100.0 * differs, color=LINES[0], lw=0.0, alpha=0.6)
    axes[3].set_ylim(0.0, 100.0)
    label(axes[3], f"other verdicts\nwithin {_WINDOW} s", "%")
    names, units = derived.inputs.trial.control_names, derived.inputs.trial.control_units
    for index, ax in enumerate(axes[4:]):
        for values, name, colour in ((recorded, "recorded", "#888888"), (other, "this filter", LINES[1])):
            ax.step(time, values["applied_control"][:, index], where="post", color=colour, lw=0.8, label=name)
        label(ax, f"applied\n{names[index]}", units[index])
    axes[-1].set_xlabel("trial time [s]")
    lines, labels = axes[0].get_legend_handles_labels()
    patches: list[Any] = [
        Patch(color=colour, alpha=0.35, label=name) for name, colour in zip(VERDICTS, VERDICT_COLOURS, strict=True)
    ]
    figure.legend(handles=[*lines, *patches], labels=[*labels, *VERDICTS], loc="outside lower center", ncols=5)
    return svg(figure)
