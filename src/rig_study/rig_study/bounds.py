"""What a claim asks of its figures, as data: its words, and whether a row of the results is met or missed, follow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

__all__ = ["Bound", "all_of", "at_least", "at_most", "near", "none_of", "result", "wanted"]


class Bound(NamedTuple):
    """low <= figure <= high; a figure that is not a number is outside."""

    figure: str
    low: float
    high: float
    words: str

    def holds(self, value: float) -> bool:
        """Whether the figure is within."""
        return self.low <= value <= self.high


def all_of(share: str) -> Bound:
    """A share that must be 1."""
    return Bound(share, 1.0, 1.0, f"all {share}")


def none_of(share: str) -> Bound:
    """A share that must be 0."""
    return Bound(share, 0.0, 0.0, f"none {share}")


def near(figure: str, value: float, within: float, unit: str = "") -> Bound:
    """|figure - value| <= within."""
    # Half a unit in the ninth place, so that a figure on the edge does not depend on how value - within is rounded.
    slack = within * (1.0 + 1e-9)
    return Bound(figure, value - slack, value + slack, f"{figure} {value} +- {within} {unit}".rstrip())


def at_most(figure: str, value: float, unit: str = "") -> Bound:
    """Figure <= value."""
    return Bound(figure, -math.inf, value, f"{figure} at most {value:g} {unit}".rstrip())


def at_least(figure: str, value: float, unit: str = "") -> Bound:
    """Figure >= value."""
    return Bound(figure, value, math.inf, f"{figure} at least {value:g} {unit}".rstrip())


def wanted(bounds: Sequence[Bound]) -> str:
    """The bounds in words."""
    return "; ".join(bound.words for bound in bounds) or "reported"


def result(bounds: Sequence[Bound], figures: Mapping[str, float]) -> str:
    """Met, or missed with the figures that are outside; nothing where nothing was wanted.

    Raises
    ------
    KeyError: a bound is of a figure that there is not.
    """
    missed = [bound.figure for bound in bounds if not bound.holds(figures[bound.figure])]
    return f"**missed**: {', '.join(missed)}" if missed else "met" if bounds else "-"
