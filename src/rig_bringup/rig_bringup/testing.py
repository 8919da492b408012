"""`./rig test`: lint, types, dependencies, then the tests; pytest's summary comes last."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

#: Packages whose types are checked.
TYPED = ("shared_control", "rig_runtime")


def main(argv: Sequence[str]) -> int:
    """Run the checks and pytest with the given arguments. With arguments (a file, -k ...) only pytest runs."""
    root = Path(os.environ["RIG_ROOT"])
    checks = [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["mypy", *(f"src/{name}/{name}" for name in TYPED)],
        ["pip", "check"],
    ]
    failed = []
    for check in [] if argv else checks:
        print(f"== {' '.join(check)}", flush=True)
        if subprocess.run([sys.executable, "-m", *check], cwd=root, check=False).returncode != 0:
            failed.append(check[0] if check[0] != "pip" else "pip check")
    # Two at a time: the live graphs, one after the other, and beside them all that needs none (`tests/conftest.py`).
    pytest = [sys.executable, "-m", "pytest", *(argv or ["-n", "2"])]
    code = subprocess.run(pytest, cwd=root, check=False).returncode
    if failed and code == 0:
        print(f"error: tests pass, but not: {', '.join(failed)} (see above)", file=sys.stderr)
    return code or int(bool(failed))
