"""`./rig test`: lint, types, dependencies, then the tests; pytest's summary comes last."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from rig_bringup.provision.steps import Places, check_command

#: Packages whose types are checked.
TYPED = ("shared_control", "rig_runtime")


def main(argv: Sequence[str]) -> int:
    """Run the checks and pytest with the given arguments. With arguments (a file, -k ...) only pytest runs."""
    root = Path(os.environ["RIG_ROOT"])
    checks = {
        "ruff check": [sys.executable, "-m", "ruff", "check", "."],
        "ruff format": [sys.executable, "-m", "ruff", "format", "--check", "."],
        "mypy": [sys.executable, "-m", "mypy", *(f"src/{name}/{name}" for name in TYPED)],
        "pip check": check_command(Places(root)),
    }
    failed = []
    for name, check in {} if argv else checks.items():
        print(f"== {name}", flush=True)
        if subprocess.run(check, cwd=root, check=False).returncode != 0:
            failed.append(name)
    # Two at a time: the live graphs, one after the other, and beside them all that needs none (`tests/conftest.py`).
    pytest = [sys.executable, "-m", "pytest", *(argv or ["-n", "2"])]
    code = subprocess.run(pytest, cwd=root, check=False).returncode
    if code < 0:
        print(f"error: pytest was ended by {signal.Signals(-code).name} before it could sum up", file=sys.stderr)
        return 128 - code
    if failed and code == 0:
        print(f"error: tests pass, but not: {', '.join(failed)} (see above)", file=sys.stderr)
    return code or int(bool(failed))
