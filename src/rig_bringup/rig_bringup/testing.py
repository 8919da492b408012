"""`./rig test`: lint, types, dependencies, then the tests; pytest's summary comes last.

`./rig test --coverage`: how much of the science and of the runtime the tests reach; it fails if they take less than
BRANCHES of the branches of either.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rig_bringup.provision.steps import Places, check_command

#: Packages whose types are checked.
TYPED = ("shared_control", "rig_runtime")


#: [%] Least share of a package's branches that its tests take.
BRANCHES = 95.0

_UNCOMPILED = {"NUMBA_DISABLE_JIT": "1"}

#: What pytest is given for coverage, and what the environment gets. A compiled kernel cannot be followed: the tests
#: of kernels run once more on the ordinary Python that these are written in, which is too slow for whole trials.
COVERAGE: tuple[tuple[tuple[str, ...], dict[str, str]], ...] = (
    (("tests/shared_control",), {}),
    (
        tuple(f"tests/shared_control/test_{name}.py" for name in ("double_integrator", "integrate", "mig", "slip")),
        _UNCOMPILED,
    ),
    (("tests/shared_control/test_controllers.py", "-k", "sac"), _UNCOMPILED),
    (("tests/rig_runtime", "tests/mig_filter_node", "tests/admittance_sim_node", "tests/user_sim_node"), {}),
    (("tests/task_sim_node", "tests/rig_display/test_display_node.py", "tests/rig_display/test_display_losses.py"), {}),
)


def main(argv: Sequence[str]) -> int:
    """Run the checks and pytest with the given arguments. With arguments (a file, -k ...) only pytest runs."""
    root = Path(os.environ["RIG_ROOT"])
    if list(argv[:1]) == ["--coverage"]:
        return coverage(root, argv[1:])
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


def coverage(root: Path, argv: Sequence[str]) -> int:
    """Measure and report the coverage; further arguments are pytest's."""
    if importlib.util.find_spec("coverage") is None:
        install = [sys.executable, "-m", "pip", "install", "--quiet", "coverage>=7.10,<8"]
        if subprocess.run(install, check=False).returncode != 0:
            print("error: coverage is not installed, and could not be (see above)", file=sys.stderr)
            return 2
    tool = [sys.executable, "-m", "coverage"]
    subprocess.run([*tool, "erase"], cwd=root, check=True)
    code = 0
    for tests, more in COVERAGE:
        command = [*tool, "run", "-m", "pytest", "-q", *tests, *argv]
        code |= subprocess.run(command, cwd=root, env={**os.environ, **more}, check=False).returncode
    subprocess.run([*tool, "combine", "-q"], cwd=root, check=True)
    code |= subprocess.run([*tool, "report"], cwd=root, check=False).returncode
    found = subprocess.run([*tool, "json", "-q", "-o", "-"], cwd=root, check=True, capture_output=True, text=True)
    for name, (taken, there) in branches(json.loads(found.stdout)).items():
        share = 100.0 * taken / there
        print(f"{name}: {taken} of {there} branches, {share:.1f} % (at least {BRANCHES:g} %)")
        if share < BRANCHES:
            print(f"error: {name}: too few branches are taken by a test", file=sys.stderr)
            code = code or 1
    return code


def branches(report: dict[str, Any]) -> dict[str, tuple[int, int]]:
    """Branches of each package that were taken, and that there are, by coverage's JSON report."""
    found = {}
    for name in TYPED:
        files = [of["summary"] for path, of in report["files"].items() if f"/{name}/" in f"/{path}"]
        found[name] = sum(of["covered_branches"] for of in files), sum(of["num_branches"] for of in files)
    return found
