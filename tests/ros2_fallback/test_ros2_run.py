"""``ros2 run`` and ``ros2 pkg`` on a package that the test makes."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Start = Callable[..., Any]


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A prefix with the package ``toy``: an ament index marker and some executables."""
    marker = tmp_path / "share" / "ament_index" / "resource_index" / "packages" / "toy"
    marker.parent.mkdir(parents=True)
    marker.touch()
    scripts = {
        "say": '#!/bin/sh\nprintf "%s\\n" "$$" "$@"\nexit 3\n',
        "ignored": "#!/bin/sh\nexec grep SigIgn /proc/self/status\n",
        "wait": f"#!{sys.executable}\nimport signal\nsignal.signal(signal.SIGINT, lambda *_: exit(7))\n"
        "print('ready', flush=True)\nsignal.pause()\n",
        "broken": "#!/nowhere/interpreter\n",
        "nested/deep": "#!/bin/sh\n",
        "twice": "#!/bin/sh\n",
        "nested/twice": "#!/bin/sh\n",
        ".hidden/secret": "#!/bin/sh\n",
    }
    for name, text in scripts.items():
        path = tmp_path / "lib" / "toy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)
    (tmp_path / "lib" / "toy" / "readme.txt").write_text("not executable")
    return tmp_path


def test_everything_behind_the_executable_is_passed_on(package: Path, ros2_process: Start) -> None:
    process = ros2_process(
        "run", "toy", "say", "--ros-args", "-p", "a:=b c", "--prefix", "x", "-h", AMENT_PREFIX_PATH=str(package)
    )
    result = process.finish()
    pid, *arguments = result.out.splitlines()
    assert arguments == ["--ros-args", "-p", "a:=b c", "--prefix", "x", "-h"]
    assert result.code == 3
    assert int(pid) == process.pid, "the executable takes over the process"


def test_prefix_stands_in_front(package: Path, ros2_process: Start) -> None:
    prefix = "env -u HOME 'A=1 2' sh -c 'echo \"$A\"; exec \"$@\"' --"
    result = ros2_process("run", "--prefix", prefix, "toy", "say", "x", AMENT_PREFIX_PATH=str(package)).finish()
    assert result.code == 3
    assert result.out.splitlines()[0] == "1 2"
    assert result.out.splitlines()[-1] == "x"


def test_signals_reach_the_executable(package: Path, ros2_process: Start) -> None:
    process = ros2_process("run", "toy", "wait", AMENT_PREFIX_PATH=str(package))
    assert process.line() == "ready\n"
    process.send(signal.SIGINT)
    assert process.finish() == (7, "", "")


def test_executable_finds_signals_as_a_shell_would_leave_them(package: Path, ros2_process: Start) -> None:
    result = ros2_process("run", "toy", "ignored", AMENT_PREFIX_PATH=str(package)).finish()
    mask = int(result.out.split()[1], 16)
    assert not mask & (1 << (signal.SIGPIPE - 1))


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["nowhere", "say"], "Package 'nowhere' not found"),
        (["toy", "nothing"], "No executable found"),
        (["toy", "secret"], "No executable found"),
        (["toy", "readme.txt"], "No executable found"),
        (["toy", "twice"], "Multiple executables found:"),
        (["--prefix", "/nowhere/gdb", "toy", "say"], "Cannot run '/nowhere/gdb'"),
        (["toy", "broken"], "Cannot run"),
    ],
)
def test_what_cannot_be_run_is_said(
    argv: list[str], message: str, package: Path, ros2: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(package))
    result = ros2("run", *argv)
    assert result.code == 1
    assert message in result.err


def test_running_does_not_wait_for_rclpy(environment: dict[str, str]) -> None:
    code = "import sys, ros2_fallback.cli, ros2_fallback.run; sys.exit('rclpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 0


def test_packages(package: Path, ros2: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(package))
    assert ros2("pkg", "list") == (0, "toy\n", "")
    assert ros2("pkg", "prefix", "toy") == (0, f"{package}\n", "")
    assert ros2("pkg", "prefix", "--share", "toy").out == f"{package}/share/toy\n"
    assert ros2("pkg", "prefix", "nowhere") == (1, "", "Package not found\n")
    names = ["toy broken", "toy ignored", "toy deep", "toy twice", "toy say", "toy twice", "toy wait"]
    assert ros2("pkg", "executables", "toy").out.splitlines() == names
    assert ros2("pkg", "executables").out.splitlines() == names
    assert str(Path(package) / "lib/toy/nested/deep") in ros2("pkg", "executables", "--full-path").out.splitlines()
    assert ros2("pkg", "executables", "nowhere") == (1, "", "Package 'nowhere' not found\n")
