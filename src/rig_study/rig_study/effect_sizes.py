"""Standardised effects with exact intervals, from the noncentral t and F distributions.

    two groups      d = (mean_1 - mean_2) / s,  s^2 = ((n_1-1) s_1^2 + (n_2-1) s_2^2) / (n_1 + n_2 - 2)
    pairs           d_z = mean(x - y) / sd(x - y),   d_av = mean(x - y) / ((s_x + s_y) / 2)
    an effect in F  eta_p^2 = SS_effect / (SS_effect + SS_error) = F df / (F df + df_error)

The interval of d is that of the noncentrality of t divided by what makes t of d, sqrt(n_1 n_2 / (n_1 + n_2)) for two
groups and sqrt(n) for pairs; that of eta_p^2 is lambda / (lambda + df + df_error + 1), lambda the noncentrality of F.
Source: Steiger, Psychological Methods 9, 2004; d_av: Cumming, Understanding the New Statistics, 2012.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from scipy import stats
from scipy.optimize import brentq

__all__ = ["eta_interval", "noncentral_t"]


def noncentral_t(t: float, df: float, confidence: float = 0.95) -> tuple[float, float]:
    """The noncentralities under which a t so large, or so small, has half of 1 - confidence left."""
    if not math.isfinite(t):
        return t, t
    tail = 0.5 * (1.0 - confidence)
    limits = [
        _root(lambda delta, part=part: float(stats.nct.cdf(t, df, delta)) - part, t) for part in (1.0 - tail, tail)
    ]
    return limits[0], limits[1]


def _root(falling: Callable[[float], float], near: float) -> float:
    """Where a function that falls with its argument crosses zero."""
    reach = 2.0 + 0.1 * abs(near)
    while falling(near - reach) <= 0.0 or falling(near + reach) >= 0.0:
        reach *= 1.5
        if reach > 1e4:
            return math.nan
    return float(brentq(falling, near - reach, near + reach))


def eta_interval(f: float, df: float, error_df: float, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of partial eta squared for an F; a limit that no noncentrality reaches is 0."""
    if not math.isfinite(f):
        return f, f
    tail = 0.5 * (1.0 - confidence)
    limits = []
    for part in (1.0 - tail, tail):
        if stats.f.cdf(f, df, error_df) <= part:
            limits.append(0.0)
            continue
        high = max(1.0, f * df)
        while stats.ncf.cdf(f, df, error_df, high) > part:
            high *= 2.0
        lam = float(brentq(lambda x, part=part: stats.ncf.cdf(f, df, error_df, x) - part, 1e-12, high))
        limits.append(lam / (lam + df + error_df + 1.0))
    return limits[0], limits[1]
