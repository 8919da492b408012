"""What the commands share: how they say what is wrong, and how they stop."""

from __future__ import annotations

import sys
from collections.abc import Callable

from rig_bag import BagError
from rig_study.recorded import TrialError
from rig_study.statistics import StatisticsError
from shared_control.parameters import ParameterError

__all__ = ["carry_out"]


def carry_out(body: Callable[[], int], *, resumes: bool = False) -> int:
    """A command's body; its status, 2 for bad input, 130 if interrupted.

    Parameters
    ----------
    resumes: the same command goes on where it was interrupted, and this is said.
    """
    try:
        return body()
    except (ParameterError, StatisticsError, BagError, TrialError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        if not resumes:
            raise
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130
