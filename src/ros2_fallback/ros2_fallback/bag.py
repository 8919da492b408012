"""``ros2 bag``: what follows is handed to rig_bag as it is."""

from __future__ import annotations

import importlib.util
import signal
from collections.abc import Sequence

from ros2_fallback.command import Outcome

__all__ = ["main"]


def main(argv: Sequence[str]) -> Outcome:
    """Run rig_bag's command line with `argv`."""
    try:
        installed = importlib.util.find_spec("rig_bag.cli") is not None
    except ModuleNotFoundError:
        installed = False
    if not installed:
        return (
            "ros2 bag is served by the package rig_bag, which is not installed in this environment: "
            "build it in the workspace and source its setup file"
        )
    # A bag must be closed, so Ctrl-C has to arrive as what a Python program expects.
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    from rig_bag.cli import main as bag_main

    code: Outcome = bag_main(list(argv))
    return code
