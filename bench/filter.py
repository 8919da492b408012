"""One filter evaluation with numba beside a hand-written C version of the same arithmetic, compiled here.

Runs of the two alternate, so that both see the same load; medians and their ratio are what counts. Usage:
``python bench/filter.py [TASK ...] [--horizon 1.5] [--runs 60] [--calls 200]``. Needs a C compiler (``$CC``, else cc
or gcc). The C versions are in ``bench/c``.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from shared_control import controllers, tasks
from shared_control.cost import quadratic
from shared_control.filter import FilterConfig, MigFilter
from shared_control.mig import Criterion
from shared_control.scenario import load
from shared_control.tasks.task import SAMPLE_TIME

#: A scenario, a state, and a control that is pushed one way and the other.
CASES: dict[str, tuple[str, list[float], list[float]]] = {
    "cart_pendulum": ("cart_pendulum_noise_assistance", [1.0, 0.2, 0.3, 0.4], [3.0]),
    # Sinking towards the ground: a touchdown and a lift-off within the horizon.
    "slip": ("slip_noise_assistance", [0.0, 0.8, 1.1, -1.0, 0.1], [5.0, 2.0]),
}


def compile_c(source: Path, folder: Path) -> Any:
    """The C version's function.

    Raises
    ------
    SystemExit: no compiler.
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        raise SystemExit("no C compiler found: install gcc or set CC")
    library = folder / f"{source.stem}.so"
    subprocess.run([compiler, "-O3", "-march=native", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    criterion = ctypes.CDLL(str(library)).criterion
    criterion.restype = ctypes.c_double
    return criterion


def seconds(call: Callable[[], object], calls: int) -> float:
    """Mean seconds of a call."""
    begin = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - begin) / calls


def measure(name: str, horizon: float | None, runs: int, calls: int) -> None:
    """Print the table of a task."""
    scenario, state, push = CASES[name]
    config: FilterConfig = load(scenario).filter
    horizon = horizon or config.horizon
    task = tasks.get(name)
    cost = quadratic(task)
    along = "user" if name == "slip" else "nominal"
    evaluate = Criterion(task, cost, horizon=horizon, dt=SAMPLE_TIME, adjoint_along=along)
    x, good, bad = np.array(state), -np.array(push), np.array(push)
    if evaluate(x, good) > 0.0:
        good, bad = bad, good
    filter_ = MigFilter(
        task, FilterConfig(horizon=horizon, adjoint_along=along, controller_iterations=config.controller_iterations)
    )
    filter_.warm_up()
    controller = controllers.make(
        "ilqr", task, cost, horizon=horizon, iterations=config.controller_iterations
    )  # fmt: skip

    with tempfile.TemporaryDirectory() as folder:
        criterion_c = compile_c(Path(__file__).parent / "c" / f"{name}.c", Path(folder))
        # Kept in a name: the library gets addresses, which must outlive the calls.
        arrays = [np.array(part) for part in (task.parameters, cost.state_weights, cost.target, x, good)]
        steps = round(horizon / SAMPLE_TIME)
        given = [array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in arrays]
        given += [ctypes.c_double(SAMPLE_TIME), steps]
        c_value, numba_value = criterion_c(*given), evaluate(x, good)
        if abs(c_value - numba_value) > 1e-9 * abs(c_value):
            raise SystemExit(f"the two versions disagree: {c_value!r} in C, {numba_value!r} with numba")

        def replace() -> None:
            controller.solve(x)
            controller.advance()

        measured: dict[str, tuple[Callable[[], object], list[float]]] = {
            "criterion, C -O3 (called from Python)": (lambda: criterion_c(*given), []),
            "criterion, numba (called from Python)": (lambda: evaluate(x, good), []),
            "filter decision, accepted": (lambda: filter_.decide(x, good), []),
            "filter decision, replaced (iLQR, warm)": (lambda: filter_.decide(x, bad), []),
            "controller iLQR alone, warm": (replace, []),
        }
        for _ in range(runs):
            for call, times in measured.values():
                times.append(seconds(call, calls))

    base = statistics.median(next(iter(measured.values()))[1])
    load_average = os.getloadavg()[0]
    print(f"{name}, horizon {horizon} s = {steps} steps; {runs} runs of {calls}; load {load_average:.1f}")
    print(f"{'':42}{'p50 us':>10}{'least us':>10}{'x C':>8}")
    for title, (_, times) in measured.items():
        middle = statistics.median(times)
        print(f"{title:42}{1e6 * middle:10.1f}{1e6 * min(times):10.1f}{middle / base:8.2f}")


def main() -> int:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("tasks", nargs="*", metavar="TASK", help=f"{' or '.join(CASES)}; both if left out")
    arguments.add_argument("--horizon", type=float, help="[s]; the scenario's if left out")
    arguments.add_argument("--runs", type=int, default=60)
    arguments.add_argument("--calls", type=int, default=200)
    options = arguments.parse_args()
    unknown = [name for name in options.tasks if name not in CASES]
    if unknown:
        arguments.error(f"there is no case for {unknown[0]}; there are {', '.join(CASES)}")
    for name in options.tasks or CASES:
        measure(name, options.horizon, options.runs, options.calls)
    return 0


if __name__ == "__main__":
    sys.exit(main())
