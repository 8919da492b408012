"""The steps of the set-up. Each names its inputs by a digest, so that it is done once and again only if they change."""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rig_bringup.provision.machine import MachineError, base_python, uses_wheels

Run = Callable[[list[str]], None]

#: Include paths of the machine that the wheels were built on; CMake refuses paths that do not exist.
_FOREIGN_INCLUDE = re.compile(r"/opt/python/cp3\d+-cp3\d+/include/python3\.\d+")
_FOREIGN_PACKAGES = re.compile(r"/opt/python/cp3\d+-cp3\d+/lib/python3\.\d+/site-packages")


@dataclass(frozen=True)
class Places:
    """Where things are, from the root of the checkout."""

    root: Path

    @property
    def venv(self) -> Path:
        return self.root / ".venv"

    @property
    def python(self) -> Path:
        return self.venv / "bin" / "python"

    @property
    def packages(self) -> Path:
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        return self.venv / "lib" / version / "site-packages"

    @property
    def state(self) -> Path:
        return self.root / ".rig"

    @property
    def workspace(self) -> Path:
        return self.root / "ros2_ws"

    @property
    def source(self) -> Path:
        return self.root / "src"

    @property
    def requirements(self) -> Path:
        return self.source / "rig_bringup" / "requirements"


@dataclass(frozen=True)
class Step:
    """One step: what a person reads while it runs, the digest of its inputs, and what it does."""

    name: str
    title: str
    digest: str
    act: Callable[[Run], None]


def steps(places: Places) -> list[Step]:
    """All steps, in order."""
    wheels = uses_wheels()
    route = f"{sys.version} {base_python()} {'wheels' if wheels else os.environ['AMENT_PREFIX_PATH']}"
    found = [Step("venv", "virtual environment", _digest([route]), lambda run: _make_venv(places, run))]
    files = ["rig.txt", "test.txt"]
    if wheels:
        ros, support = places.requirements / "ros.txt", places.requirements / "ros-support.txt"
        found.append(
            Step("ros", "ROS 2 Jazzy wheels", _digest([route], [ros]), lambda run: _install_ros(places, ros, run))
        )
        files.insert(0, support.name)
    lists = [places.requirements / name for name in files]
    found.append(Step("packages", "Python packages", _digest([route], lists), lambda run: _install(places, lists, run)))
    build = [*_build_inputs(places.source)]
    found.append(
        Step("build", "workspace (colcon build)", _digest([route], build), lambda run: _build(places, wheels, run))
    )
    science = sorted((places.source / "shared_control").rglob("*.py"))
    found.append(
        Step(
            "kernels",
            "compiled kernels (numba cache)",
            _digest([route], science),
            lambda run: _warm(places, run),
        )
    )
    return found


def _digest(words: Iterable[str], files: Iterable[Path] = ()) -> str:
    digest = hashlib.sha256()
    for word in words:
        digest.update(word.encode())
    for path in files:
        digest.update(f"\n{path.name}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _build_inputs(source: Path) -> Iterator[Path]:
    # Python sources are linked into the workspace, so only what decides its shape needs a new build.
    wanted = {"package.xml", "setup.py", "setup.cfg", "CMakeLists.txt"}
    for path in sorted(source.rglob("*")):
        if path.name in wanted or path.suffix in (".msg", ".srv") or path.name.endswith(".launch.py"):
            yield path


def _make_venv(places: Places, run: Run) -> None:
    extra = [] if uses_wheels() else ["--system-site-packages"]
    run([base_python(), "-m", "venv", "--clear", *extra, str(places.venv)])


def _pip(places: Places, *arguments: str) -> list[str]:
    return [str(places.python), "-m", "pip", "--disable-pip-version-check", "--no-input", *arguments]


def _get(places: Places, arguments: list[str], run: Run, link: str = "hardlink") -> None:
    """Install packages: with uv, which takes a third of pip's time, or with pip where uv cannot.

    Byte code is left to the first import: most modules of the large packages are never imported.
    """
    try:
        if not (places.venv / "bin" / "uv").exists():
            run(_pip(places, "install", "uv>=0.5,<1"))
        uv = ["env", f"VIRTUAL_ENV={places.venv}", f"UV_LINK_MODE={link}", str(places.venv / "bin" / "uv")]
        run([*uv, "pip", "install", *arguments])
    except MachineError:
        run(_pip(places, "install", *arguments))


def _install_ros(places: Places, pins: Path, run: Run) -> None:
    # Copied, since files are mended: a link would mend the cache that other environments are made from.
    _get(places, ["--no-deps", "-r", str(pins)], run, link="copy")
    mend_include_paths(places.venv, places.packages)


def _install(places: Places, lists: list[Path], run: Run) -> None:
    _get(places, [part for path in lists for part in ("-r", str(path))], run)
    run(check_command(places))


def check_command(places: Places) -> list[str]:
    """The command that finds out whether the installed packages fit together.

    Beside a ROS installation the environment sees the system's packages too, and pip would fail for any two of those
    that do not fit: there only what the rig itself has installed is looked at, which uv can and pip cannot.
    """
    uv = places.venv / "bin" / "uv"
    if uses_wheels() or not uv.exists():
        return _pip(places, "check")
    return [str(uv), "pip", "check", "--python", str(places.python)]


def mend_include_paths(prefix: Path, packages: Path) -> int:
    """Point the wheels' exported CMake targets at this interpreter's headers; return how many files changed.

    Doing it again changes nothing.
    """
    include = sysconfig.get_path("include")
    changed = 0
    for path in prefix.glob("share/*/cmake/*.cmake"):
        text = path.read_text()
        mended = _FOREIGN_PACKAGES.sub(lambda _: str(packages), _FOREIGN_INCLUDE.sub(lambda _: include, text))
        if mended != text:
            path.write_text(mended)
            changed += 1
    return changed


def _build(places: Places, wheels: bool, run: Run) -> None:
    # colcon alone would let make hold back by the machine's load, and a busy machine would build on one core.
    environment = [f"MAKEFLAGS={os.environ.get('MAKEFLAGS') or f'-j{os.cpu_count()}'}"]
    if wheels:
        environment += [
            f"PATH={places.venv / 'bin'}:{os.environ.get('PATH', '')}",
            f"AMENT_PREFIX_PATH={places.venv}",
            f"CMAKE_PREFIX_PATH={places.venv}",
        ]
    colcon = ["python", "-m", "colcon"] if wheels else ["colcon"]
    colcon += ["build", "--symlink-install", "--event-handlers", "console_direct+", "event_log-", "status-"]
    options = ["--cmake-args", "-DCMAKE_BUILD_TYPE=Release", "-Wno-dev"]
    if wheels:
        # The wheels have no C++ side that could use the messages.
        options.append("-DMIG_INTERFACES_CPP=OFF")
    run(["env", "-C", str(places.workspace), *environment, *colcon, *options])


def _warm(places: Places, run: Run) -> None:
    # Needed by the command below, before the set-up as a whole has come to its end.
    write_environment(places)
    run([str(places.root / "rig"), "run", "python", "-m", "shared_control.warm_up"])


def write_environment(places: Places) -> None:
    """Write `.rig/environment.sh`, which `./rig` sources: everything that a node needs, on either route."""
    lines = [f"export NUMBA_CACHE_DIR={shlex.quote(str(places.state / 'numba'))}"]
    if uses_wheels():
        libraries = [places.venv / "lib", *sorted(places.packages.glob("ros_*.libs"))]
        lines += [
            f"export VIRTUAL_ENV={shlex.quote(str(places.venv))}",
            'export PATH="$VIRTUAL_ENV/bin:$PATH"',
            'export AMENT_PREFIX_PATH="$VIRTUAL_ENV" CMAKE_PREFIX_PATH="$VIRTUAL_ENV"',
            # The wheels would find these out at every start, and start the interpreter a second time for it.
            f"export LD_LIBRARY_PATH={shlex.quote(':'.join(map(str, libraries)))} _ROS_WHEELS_BOOTSTRAP_COMPLETE=1",
            f"export PATH={shlex.quote(str(_write_ros2(places)))}:$PATH",
        ]
    else:
        lines += [
            f"export PATH=$PATH:{shlex.quote(str(places.venv / 'bin'))}",
            f"export PYTHONPATH=${{PYTHONPATH:+$PYTHONPATH:}}{shlex.quote(str(places.packages))}",
        ]
    lines += [
        f"source {shlex.quote(str(places.workspace / 'install' / 'local_setup.bash'))}",
        "export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}",
        # Byte code is written at the first import; without, every start of every node compiles its packages again.
        "unset PYTHONDONTWRITEBYTECODE",
        # One thread each: the arrays are small, and a thread pool for each node costs start-up time and steadiness.
        "export OPENBLAS_NUM_THREADS=${OPENBLAS_NUM_THREADS:-1} OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}",
    ]
    (places.state / "environment.sh").write_text("\n".join(lines) + "\n")


def _write_ros2(places: Places) -> Path:
    """Put the fallback `ros2` into a directory of its own, which only the wheel environment has on its path."""
    directory = places.state / "bin"
    directory.mkdir(exist_ok=True)
    command = directory / "ros2"
    command.write_text('#!/bin/sh\nexec python -m ros2_fallback "$@"\n')
    command.chmod(0o755)
    return directory


def failure_reason(log: str) -> str:
    """One sentence for what is behind a failed step, from what it printed."""
    if re.search(r"NewConnectionError|Temporary failure in name|ConnectionError|ProxyError|Network is unreach", log):
        return "the package registry cannot be reached; check the network, or pip's configuration of an index"
    if re.search(r"No matching distribution found|Could not find a version", log):
        missing = re.search(r"No matching distribution found for (\S+)", log)
        what = missing.group(1) if missing else "a package"
        return f"{what} is not in the package registry for this Python and processor"
    if re.search(r"No space left on device", log):
        return "the disk is full"
    if re.search(r"fatal error: Python.h", log):
        return "Python's headers are missing; on Debian: apt install python3-dev"
    return "see the log"


def run_logged(command: list[str], log: Path, environment: dict[str, str]) -> int:
    """Run a command with its output appended to a log file; return its exit code."""
    with log.open("ab") as out:
        out.write(f"$ {' '.join(command)}\n".encode())
        out.flush()
        return subprocess.run(
            command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=environment, check=False
        ).returncode
