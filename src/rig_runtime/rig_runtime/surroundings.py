"""What a process runs in and with: what a recorded trial must say of it to be understood years later."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from functools import cache

import rclpy

__all__ = ["scheduling", "surroundings"]

#: Those that decide what a trial computes, and what it is recorded with.
_PACKAGES = ("shared_control", "rig_bag", "mig_interfaces", "numpy", "numba", "rclpy", "zstandard")


def surroundings() -> dict[str, str]:
    """Host, machine, system, versions of what decides a trial (``version PACKAGE``), and scheduling, at this moment."""
    return _lasting() | {"scheduling": scheduling()}


def scheduling() -> str:
    """How this process is scheduled, at this moment."""
    return {0: "other", 1: "fifo", 2: "round robin"}.get(os.sched_getscheduler(0), "unknown")


@cache
def _lasting() -> dict[str, str]:
    found = {
        "host": platform.node(),
        "machine": platform.machine(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "rmw": rclpy.get_rmw_implementation_identifier(),
    }
    for name in _PACKAGES:
        try:
            found[f"version {name}"] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            # Built by colcon, or a wheel of another name.
            continue
    return found
