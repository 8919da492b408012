"""Where and with what a run of `./rig bench` was made."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import time
from pathlib import Path
from typing import Any

_PACKAGES = ("numpy", "numba", "mcap", "rosbags", "ros-rclpy", "rclpy")


def describe() -> dict[str, Any]:
    """Processor, load, versions, commit."""
    return {
        "processor": _processor(),
        "processors usable": len(os.sched_getaffinity(0)),
        "load average": [round(value, 2) for value in os.getloadavg()],
        "kernel": platform.release(),
        "10 million turns of a Python loop [s]": _speed(),
        "versions": {"python": platform.python_version()} | _versions(),
        "middleware": os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp (the default)"),
        "RIG_REALTIME": os.environ.get("RIG_REALTIME", "off"),
        "RIG_CPUS": os.environ.get("RIG_CPUS", ""),
        "commit": _commit(),
    }


def _speed() -> float:
    """How fast the machine is at the moment: the best of several, since others take their share."""
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        for _ in range(1_000_000):
            pass
        times.append(10.0 * (time.perf_counter() - begin))
    return round(min(times), 2)


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def _commit() -> str:
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""
