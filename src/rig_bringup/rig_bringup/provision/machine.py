"""What this machine has, and what to do about what it lacks."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

#: Versions of CPython for which the ROS wheels exist.
PYTHONS = ((3, 10), (3, 11), (3, 12), (3, 13))
DISTRO = "jazzy"


class MachineError(Exception):
    """This machine cannot be set up; the message says why and what to do."""


@dataclass(frozen=True)
class Finding:
    """One line of `./rig doctor`."""

    name: str
    ok: bool
    found: str
    remedy: str = ""


def sourced_distro() -> str:
    """Name of the ROS 2 installation that is sourced in this shell, empty if none is."""
    return os.environ.get("ROS_DISTRO", "") if os.environ.get("AMENT_PREFIX_PATH") else ""


def uses_wheels() -> bool:
    """Whether ROS comes from wheels, because no installation is sourced."""
    return not sourced_distro()


def base_python() -> str:
    """The interpreter behind any virtual environment: the one that set-up starts from, within `./rig shell` too."""
    return os.path.realpath(getattr(sys, "_base_executable", sys.executable))


def python_finding() -> Finding:
    """The interpreter: its version, and whether it can make virtual environments."""
    version = sys.version_info[:2]
    found = f"Python {platform.python_version()} at {base_python()}"
    if version < PYTHONS[0] or (uses_wheels() and version not in PYTHONS):
        low, high = (".".join(map(str, v)) for v in (PYTHONS[0], PYTHONS[-1]))
        return Finding("python", False, found, f"use Python {low} to {high}: RIG_PYTHON=/path/to/python3 ./rig ...")
    if importlib.util.find_spec("ensurepip") is None:
        return Finding("python", False, f"{found}, without venv", "install it, on Debian: apt install python3-venv")
    return Finding("python", True, found)


def headers_finding() -> Finding:
    """Python's C headers, which the message bindings are compiled against."""
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if header.exists():
        return Finding("python headers", True, str(header))
    return Finding("python headers", False, f"no {header}", "install them, on Debian: apt install python3-dev")


def compiler_finding(language: str, variable: str, names: tuple[str, ...], package: str) -> Finding:
    """A C or C++ compiler on PATH, or the one that its environment variable names."""
    wanted = os.environ.get(variable)
    path = next(filter(None, map(shutil.which, (wanted,) if wanted else names)), None)
    if path:
        return Finding(f"{language} compiler", True, path)
    looked = f"${variable} = {wanted}" if wanted else ", ".join(names)
    remedy = f"install one, on Debian: apt install {package}"
    return Finding(f"{language} compiler", False, f"none on PATH (looked for {looked})", remedy)


def processor_finding() -> Finding:
    """The processor: the ROS wheels are built for one architecture."""
    machine = platform.machine()
    if machine == "x86_64" or not uses_wheels():
        return Finding("processor", True, machine)
    return Finding(
        "processor", False, machine, "the ROS wheels exist for x86_64 only: install ROS 2 Jazzy and source it"
    )


def ros_finding() -> Finding:
    """Where ROS comes from."""
    distro = sourced_distro()
    if not distro:
        return Finding("ROS", True, "no installation sourced: ROS 2 Jazzy comes from wheels")
    if distro == DISTRO:
        return Finding("ROS", True, f"ROS 2 {distro} is sourced and is used")
    return Finding("ROS", False, f"ROS 2 {distro} is sourced", "this needs jazzy: use a shell without it")


def disk_finding(root: Path) -> Finding:
    """Room for the environment and for bags."""
    free = shutil.disk_usage(root).free / 1e9
    return Finding("disk", free > 3.0, f"{free:.1f} GB free", "" if free > 3.0 else "make 3 GB of room")


def needed_to_build(root: Path) -> list[Finding]:
    """Everything without which set-up cannot succeed."""
    return [
        processor_finding(),
        python_finding(),
        headers_finding(),
        compiler_finding("C", "CC", ("cc", "gcc", "clang"), "gcc"),
        compiler_finding("C++", "CXX", ("c++", "g++", "clang++"), "g++"),
        ros_finding(),
        disk_finding(root),
    ]


def require(findings: list[Finding]) -> None:
    """Raise for the first finding that is not ok.

    Raises
    ------
    MachineError: says what was found and what to do.
    """
    for finding in findings:
        if not finding.ok:
            raise MachineError(f"{finding.name}: {finding.found}; {finding.remedy}")
