"""The figures of a claim, from the rows of its trials, and the sentence that says them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

__all__ = ["figures", "sentence"]

Rows = Sequence[Mapping[str, Any]]


def figures(rows: Rows) -> dict[str, float]:
    """By name; shares are of the trials, means over the trials. NaN where nothing is known.

    Raises
    ------
    KeyError: the rows are of a task that makes no claims.
    """
    return {"cart_pendulum": _cart, "slip": _slip}[str(rows[0]["task"])](rows)


def sentence(found: Mapping[str, float], trials: int) -> str:
    """The figures in words."""
    if "inverted" in found:
        return (
            f"{_count(found['inverted'], trials)} inverted, {found['upright at the end'] * trials:,.0f} upright at the "
            f"end; rejected {found['rejected']:.3f} to success, {found['rejected over the trial']:.3f} over the trial; "
            f"cart p50 {found['cart p50']:.1f}, p99 {found['cart p99']:.1f} m; "
            f"time to success p50 {found['time to success p50']:.1f}, most {found['time to success, most']:.1f} s"
        )
    said = f"{_count(found['fell'], trials)} fell"
    if found["fell"] > 0.0:
        said += " (quartiles {:.1f}, {:.1f}, {:.1f} s)".format(*(found[f"fall time p{p}"] for p in (25, 50, 75)))
    said += f"; override {found['override']:.3f}; {found['mean speed']:.3f} m/s"
    for reading, words in (("", "from the wanted speed"), ("stride's ", "of the strides' means")):
        if np.isfinite(found[f"{reading}speed error"]):
            said += f", {found[f'{reading}speed error']:.3f} m/s RMS {words}"
        if np.isfinite(found[f"{reading}speed correlation"]):
            said += f", r {found[f'{reading}speed correlation']:.3f}"
    return said


def _count(share: float, trials: int) -> str:
    return f"{share * trials:,.0f} of {trials:,}"


def _field(rows: Rows, name: str) -> np.ndarray:
    return np.array([row[name] for row in rows], dtype=float)


def _mean(values: np.ndarray) -> float:
    """Of what is known."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else float("nan")


def _cart(rows: Rows) -> dict[str, float]:
    excursion, to_success = _field(rows, "cart_excursion"), _field(rows, "time_to_success")
    return {
        "inverted": float(_field(rows, "success").mean()),
        "upright at the end": float(_field(rows, "upright_at_end").mean()),
        "rejected": _mean(_field(rows, "pra")),
        "rejected over the trial": _mean(_field(rows, "pra_trial")),
        "cart p50": float(np.median(excursion)),
        "cart p99": float(np.percentile(excursion, 99)),
        "time to success p50": float(np.median(to_success)),
        "time to success, most": float(to_success.max()),
    }


def _slip(rows: Rows) -> dict[str, float]:
    quartiles = np.percentile(_field(rows, "fall_time"), (25, 50, 75))
    return {
        "fell": float(_field(rows, "fell").mean()),
        **{f"fall time p{p}": float(value) for p, value in zip((25, 50, 75), quartiles, strict=True)},
        "override": _mean(_field(rows, "override")),
        "mean speed": _mean(_field(rows, "mean_speed")),
        "speed error": _mean(_field(rows, "speed_rmse")),
        "speed correlation": _mean(_field(rows, "speed_correlation")),
        "stride's speed error": _mean(_field(rows, "stride_speed_rmse")),
        "stride's speed correlation": _mean(_field(rows, "stride_speed_correlation")),
    }
