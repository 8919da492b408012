"""The one style of all figures: colours of Okabe and Ito, told apart by the colour-blind and in grey.

Text in an SVG stays text, so that it can be searched; no date is written, so that the same data give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

VERDICT_COLOURS = ("#009E73", "#D55E00", "#0072B2")
SUCCESS = "#B8E2C8"
ALLOWED = "#E69F00"
LINES = ("#222222", "#0072B2", "#D55E00", "#CC79A7", "#009E73")
WIDTH = 11.0  # [in]


def axes(count: int, height: float, width: float = WIDTH) -> tuple[Figure, list[Axes]]:
    """Panels one under the other, with a common abscissa."""
    figure = Figure(figsize=(width, height * count), layout="constrained")
    made = list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    for ax in made:
        plain(ax)
    return figure, made


def row(count: int, height: float, width: float = WIDTH) -> tuple[Figure, list[Axes]]:
    """Panels side by side."""
    figure = Figure(figsize=(width, height), layout="constrained")
    made = list(figure.subplots(1, count, squeeze=False)[0])
    for ax in made:
        plain(ax)
    return figure, made


def plain(ax: Axes) -> None:
    """No frame, a faint grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(alpha=0.25)
    ax.set_axisbelow(True)


def svg(figure: Figure) -> str:
    """The figure as SVG text, from the tag on."""
    out = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "rig"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def save(figure: Figure, stem: Path) -> str:
    """Write SVG and PNG beside each other; returns the SVG text."""
    text = svg(figure)
    stem.parent.mkdir(parents=True, exist_ok=True)
    stem.with_suffix(".svg").write_text(text, encoding="utf-8")
    figure.savefig(stem.with_suffix(".png"), dpi=150, metadata={"Software": None})
    return text


def label(ax: Axes, name: str, unit: str) -> None:
    """Name and unit at the ordinate."""
    ax.set_ylabel(f"{name}\n[{unit}]" if unit else name)


def wrapped(values: np.ndarray) -> np.ndarray:
    """Angles in (-pi, pi], broken where they jump: a line across the page at each turn would hide the motion."""
    turned = np.arctan2(np.sin(values), np.cos(values))
    return np.where(np.abs(np.diff(turned, prepend=turned[:1])) > np.pi, np.nan, turned)


def spans(mask: np.ndarray | Sequence[bool]) -> list[tuple[int, int]]:
    """First index and end of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask).astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
