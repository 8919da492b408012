"""What the filter says of an action: its verdict, the reason, the mode it was in, and the numbers.

The numbers of the enumerations are those of ``mig_interfaces/FilterDecision``.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from shared_control.parameters import ParameterError
from shared_control.tasks.task import Array

__all__ = ["INPUT_FAULTS", "Decision", "Mode", "Reason", "Verdict"]


class Verdict(enum.IntEnum):
    """What becomes of the action."""

    ACCEPTED = 0
    REJECTED = 1
    REPLACED = 2


class Reason(enum.IntEnum):
    """Why."""

    CRITERION = 0
    FILTER_OFF = 1
    NULL_ACTION = 2
    NON_FINITE_WRENCH = 3
    NON_FINITE_STATE = 4
    STALE_WRENCH = 5
    UNKNOWN_FRAME = 6
    NOT_CONVERGED = 7
    NON_FINITE_CRITERION = 8
    EXCESSIVE_WRENCH = 9
    STALE_STATE = 10


#: Reasons that tell of a state or a wrench that is lost or not to be believed, whatever the user did.
INPUT_FAULTS = frozenset(
    {
        Reason.NON_FINITE_WRENCH,
        Reason.NON_FINITE_STATE,
        Reason.STALE_WRENCH,
        Reason.UNKNOWN_FRAME,
        Reason.EXCESSIVE_WRENCH,
        Reason.STALE_STATE,
    }
)


class Mode(enum.IntEnum):
    """Of the filter."""

    OFF = 0
    TRAINING = 1
    ASSISTANCE = 2

    @classmethod
    def of(cls, mode: str | int) -> Mode:
        """From its name, in any case, or its number.

        Raises
        ------
        ParameterError: no such mode.
        """
        try:
            return cls[mode.upper()] if isinstance(mode, str) else cls(mode)
        except (KeyError, ValueError):
            known = ", ".join(item.name.lower() for item in cls)
            raise ParameterError(f"mode: {mode!r} is not allowed; it must be one of {known}") from None


class Decision(NamedTuple):
    """What the filter decided about one action, and why."""

    verdict: Verdict
    reason: Reason
    mode: Mode
    criterion: float  # [unit of the cost], NaN if not evaluated
    threshold: float  # [unit of the cost] that it was held against: threshold - c J
    user_control: Array  # (m,)
    nominal_control: Array  # (m,) u_1, from which the criterion measures
    applied_control: Array  # (m,)
