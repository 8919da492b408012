"""Measures of a trial, of the cart-pendulum and of SLIP.

Those of the cart-pendulum are as the paper defines them ('Performance Measures'), with the readings that its numbers
fit.

``success``
    theta within 0.4 rad (wrapped) and theta_dot within 0.75 rad/s for at least 2 s without a break.
``time_to_success`` [s]
    When the first such stay begins (``success_time="entry"``: the paper's 8.3 s + 19.7 s = 30 s - 2 s fits) or when its
    2 s are over (``"dwell"``); the length of the trial if there is none.
``balance_time`` [s]
    Cumulative time in the region, counted from 2 s after the entry of each such stay (``balance="after_dwell"``) or all
    of the time in the region (``"in_region"``); 0 without success.
``rms_error``
    RMS of wrapped theta, divided by pi, that of hanging still (``error="angle"``: what the paper's 0.57 to 0.65 fit) or
    RMS of the state's norm, theta wrapped, likewise divided by pi (``"state"``).
``pra``
    Share of the actions (inputs that are not null) that were rejected or replaced, up to success: to when its 2 s are
    over, or over the trial if there is none; NaN without an action.
``pra_trial``
    The same over the whole trial.
``cart_excursion`` [m]
    max |x_c|.
``upright_at_end``
    Wrapped theta within 0.4 rad at the last node.

Of SLIP:

``fell``, ``fall_time`` [s]
    Whether and when the mass came to ``fall_height`` or below; the length of the trial if it did not.
``override``
    Share of the actions that were rejected or replaced, until the fall; NaN without an action.
``mean_speed`` [m/s]
    Mean of x_m_dot until the fall.
``speed_rmse`` [m/s], ``speed_correlation``
    RMS of x_m_dot less the wanted speed, and their Pearson correlation, until the fall; NaN where no speed is wanted
    (or, for the correlation, where it does not vary).
``stride_speed_rmse`` [m/s], ``stride_speed_correlation``
    The same of the strides' means, one of each whole stride i from touchdown to touchdown (nodes k_i to k_i+1):

        v_i = (x_m(k_i+1) - x_m(k_i)) / (t(k_i+1) - t(k_i)),    RMS over i of v_i - w_i,    correlation of v_i and w_i

    with w_i the mean of the wanted speed over the stride (trapezoid rule). That is how the speed of running is commonly
    defined (stride length over stride time: Alexander, Principles of Animal Locomotion, 2003), and leaves out that a
    springy leg brakes and pushes off within each stride, which ``speed_rmse`` counts as error. NaN without a whole
    stride, and where it is not known when the leg stood.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from shared_control.parameters import ParameterError
from shared_control.tasks.cart_pendulum import CartPendulum
from shared_control.tasks.task import Array

__all__ = ["CartPendulumMeasures", "SlipMeasures", "cart_pendulum", "slip"]

_READINGS = {
    "success_time": ("entry", "dwell"),
    "balance": ("after_dwell", "in_region"),
    "error": ("angle", "state"),
}


class CartPendulumMeasures(NamedTuple):
    """See the module."""

    success: bool
    time_to_success: float
    balance_time: float
    rms_error: float
    pra: float
    pra_trial: float
    cart_excursion: float
    upright_at_end: bool


class SlipMeasures(NamedTuple):
    """See the module."""

    fell: bool
    fall_time: float
    override: float
    mean_speed: float
    speed_rmse: float
    speed_correlation: float
    stride_speed_rmse: float
    stride_speed_correlation: float


def cart_pendulum(
    states: ArrayLike,
    sample_time: float,
    *,
    action: ArrayLike | None = None,
    intervened: ArrayLike | None = None,
    success_time: str = "entry",
    balance: str = "after_dwell",
    error: str = "angle",
) -> CartPendulumMeasures:
    """Measures of one trial.

    Parameters
    ----------
    states: (N+1, 4), the nodes of the trial.
    sample_time: [s].
    action: (N,) bool, whether the user's input of each tick is an action (not null); all, if left out.
    intervened: (N,) bool, whether it was rejected or replaced; none, if left out.
    success_time, balance, error: readings, see the module.

    Raises
    ------
    ParameterError: a reading that is not known, or shapes that do not fit.
    """
    for key, value in (("success_time", success_time), ("balance", balance), ("error", error)):
        if value not in _READINGS[key]:
            raise ParameterError(f"{key}: {value!r} is not allowed; it must be one of {', '.join(_READINGS[key])}")
    x = np.asarray(states, dtype=float)
    if x.ndim != 2 or x.shape[1] != 4 or len(x) < 1:
        raise ParameterError(f"states: shape {x.shape} is not allowed; it must be (N+1, 4)")
    ticks = len(x) - 1
    acted, stopped = _flags(ticks, action, intervened)

    # To the nearest turn; at the very ends of (-pi, pi] the sign does not matter to any measure.
    theta = x[:, 0] - 2.0 * math.pi * np.round(x[:, 0] / (2.0 * math.pi))
    inside = (np.abs(theta) <= CartPendulum.success_angle) & (np.abs(x[:, 1]) <= CartPendulum.success_rate)
    dwell = round(CartPendulum.success_dwell / sample_time)
    # A stay is a run of nodes inside, from its first to its last; it lasts as many samples as it has nodes, less one.
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    stays = [(int(first), int(end) - 1) for first, end in zip(edges[::2], edges[1::2], strict=True)]
    successes = [(first, last) for first, last in stays if last - first >= dwell]
    success = bool(successes)

    if success:
        entry = successes[0][0]
        time_to_success = (entry if success_time == "entry" else entry + dwell) * sample_time
        if balance == "after_dwell":
            balance_time = sum(last - first - dwell for first, last in successes) * sample_time
        else:
            balance_time = sum(last - first for first, last in stays) * sample_time
        until = entry + dwell
    else:
        time_to_success, balance_time, until = ticks * sample_time, 0.0, ticks

    squares = theta**2
    if error == "state":
        squares = squares + np.sum(x[:, 1:] ** 2, axis=1)
    return CartPendulumMeasures(
        success=success,
        time_to_success=time_to_success,
        balance_time=balance_time,
        rms_error=float(np.sqrt(np.mean(squares)) / math.pi),
        pra=_share(stopped[:until], acted[:until]),
        pra_trial=_share(stopped, acted),
        cart_excursion=float(np.max(np.abs(x[:, 2]))),
        upright_at_end=bool(abs(theta[-1]) <= CartPendulum.success_angle),
    )


def slip(
    states: ArrayLike,
    sample_time: float,
    *,
    action: ArrayLike | None = None,
    intervened: ArrayLike | None = None,
    wanted_speed: ArrayLike | None = None,
    stance: ArrayLike | None = None,
    fall_height: float = 0.0,
) -> SlipMeasures:
    """Measures of one trial.

    Parameters
    ----------
    states: (N+1, 5), the nodes of the trial.
    sample_time: [s].
    action, intervened: (N,) bool, as for :func:`cart_pendulum`.
    wanted_speed: (N+1,) [m/s], what the user is after, if it is known.
    stance: (N+1,) bool, whether the leg stood at each node, if it is known.
    fall_height: [m], the task's.

    Raises
    ------
    ParameterError: shapes that do not fit.
    """
    x = np.asarray(states, dtype=float)
    if x.ndim != 2 or x.shape[1] != 5 or len(x) < 1:
        raise ParameterError(f"states: shape {x.shape} is not allowed; it must be (N+1, 5)")
    ticks = len(x) - 1
    acted, stopped = _flags(ticks, action, intervened)
    fallen = np.flatnonzero(x[:, 2] <= fall_height)
    until = int(fallen[0]) if len(fallen) else ticks
    speed = x[: until + 1, 1]
    of_nodes = of_strides = math.nan, math.nan
    if wanted_speed is not None:
        wanted = _of_nodes("wanted_speed", np.asarray(wanted_speed, dtype=float), ticks)[: until + 1]
        of_nodes = _error(speed, wanted)
        if stance is not None:
            stood = _of_nodes("stance", np.asarray(stance, dtype=bool), ticks)[: until + 1]
            touchdowns = 1 + np.flatnonzero(np.diff(stood.astype(np.int8)) > 0)
            of_strides = _error(*_stride_means(x[:, 0], wanted, touchdowns, sample_time))
    return SlipMeasures(
        fell=bool(len(fallen)),
        fall_time=until * sample_time,
        override=_share(stopped[:until], acted[:until]),
        mean_speed=float(np.mean(speed)),
        speed_rmse=of_nodes[0],
        speed_correlation=of_nodes[1],
        stride_speed_rmse=of_strides[0],
        stride_speed_correlation=of_strides[1],
    )


def _stride_means(place: Array, wanted: Array, touchdowns: np.ndarray, sample_time: float) -> tuple[Array, Array]:
    """v_i and w_i of the strides between touchdowns."""
    # Above the first, so that a wanted speed that does not vary gives means that do not, to the last bit.
    above = wanted - wanted[0]
    # At each node but the first, which is no touchdown.
    distance = np.cumsum(0.5 * sample_time * (above[1:] + above[:-1]))
    lasted = sample_time * np.diff(touchdowns)
    return np.diff(place[touchdowns]) / lasted, wanted[0] + np.diff(distance[touchdowns - 1]) / lasted


def _error(speed: Array, wanted: Array) -> tuple[float, float]:
    """RMS of the difference, and the correlation."""
    if not len(speed):
        return math.nan, math.nan
    rmse = float(np.sqrt(np.mean((speed - wanted) ** 2)))
    varies = np.ptp(wanted) > 0.0 and np.ptp(speed) > 0.0
    return rmse, float(np.corrcoef(speed, wanted)[0, 1]) if varies else math.nan


def _of_nodes(name: str, values: np.ndarray, ticks: int) -> np.ndarray:
    if values.shape != (ticks + 1,):
        raise ParameterError(f"{name}: shape {values.shape} is not allowed; it must be ({ticks + 1},)")
    return values


def _flags(ticks: int, action: ArrayLike | None, intervened: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
    acted = np.ones(ticks, bool) if action is None else np.asarray(action, dtype=bool)
    stopped = np.zeros(ticks, bool) if intervened is None else np.asarray(intervened, dtype=bool)
    if acted.shape != (ticks,) or stopped.shape != (ticks,):
        raise ParameterError(f"action, intervened: shapes {acted.shape}, {stopped.shape}; they must be ({ticks},)")
    return acted, stopped


def _share(stopped: np.ndarray, acted: np.ndarray) -> float:
    actions = int(np.count_nonzero(acted))
    return float(np.count_nonzero(stopped & acted) / actions) if actions else math.nan
