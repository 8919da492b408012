"""Latency of each tick, hop by hop, from the wall times that the nodes put into their messages.

A stage begins ``delay`` after t_k and takes ``compute_time``; ages say for how long its inputs had waited then. Counted
from t_k, the state is out at

    s_k = delay + compute time of the state k,

and the motion is back at

    m_k = t_s + delay - motion age of the state k+1.

The hops are the differences between what follows each other round the loop. A wrench says nothing of the kind, as a
sensor's does not: of the user there is how much later than the state the recorder got it, which is the user's stage and
one way.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["hops"]

Array = npt.NDArray[Any]

_TIMED = {"delay", "compute_time"}


def hops(state: Any, decision: Any, motion: Any, sample_time: float, wrench: Any = None) -> dict[str, Array]:
    """Seconds of each hop, (N,) by state, NaN where a tick has no such message; in the order of the loop.

    Parameters
    ----------
    state, decision, motion: tables of ``task/state``, ``mig_filter/decision``, ``admittance/end_effector``.
    sample_time: t_s [s].
    wrench: table of ``force_sensor/wrench``; without one the user's hop is left out.

    Empty if the bag holds no such times: it is from lockstep, or from before there were any, or lacks a topic.
    """
    tables = (state, decision, motion)
    if not all(isinstance(table, np.ndarray) and set(table.dtype.names or ()) >= _TIMED for table in tables):
        return {}
    if not all(map(len, tables)) or not np.any(state["compute_time"]):
        return {}
    ticks = state["tick"]
    following = _on(state, ticks + 1)
    decided, moved = _on(decision, ticks), _on(motion, ticks)
    out = state["delay"] + state["compute_time"]
    heard = decided("delay") - decided("state_age")
    made = decided("delay") + decided("compute_time")
    # The robot has no times of its own where it moved on without a command.
    commanded = np.where(moved("compute_time") > 0.0, moved("delay"), np.nan)
    sent = commanded + moved("compute_time")
    spare = np.where(following("held") == 0.0, following("motion_age"), np.nan)
    back = sample_time + following("delay") - spare
    user = {}
    if isinstance(wrench, np.ndarray) and len(wrench):
        got = _on(wrench, state["stamp"], "stamp")("log_time")
        user = {"user and one way, at the recorder": 1e-9 * (got - state["log_time"])}
    return {
        "state, due to out": out,
        "state to filter": heard - out,
        **user,
        "state to decision, by way of the user": decided("delay") - out,
        "decision": decided("compute_time"),
        "decision to robot": commanded - made,
        "robot": sent - commanded,
        "robot to task": back - sent,
        "loop, state out to motion in": back - out,
        "spare, motion in to next state": spare,
    }


def _on(table: Any, keys: Array, key: str = "tick") -> Any:
    """A field of a table where its key is one of these, NaN where there is none."""
    order = np.argsort(table[key], kind="stable")
    place = np.minimum(np.searchsorted(table[key][order], keys), len(order) - 1)
    found = table[key][order][place] == keys
    return lambda field: np.where(found, table[field][order][place].astype(float), np.nan)
