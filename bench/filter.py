"""One filter evaluation with numba beside hand-written versions of the same arithmetic, and one replacement.

Runs alternate, so that all see the same load; medians and their ratio are what counts. Usage:
``python bench/filter.py [TASK ...] [--horizon 1.5] [--runs 60] [--calls 200]``. Needs a C compiler (``$CC``, else cc
or gcc). The C versions are in ``bench/c``, the one in Python in ``bench/scalars.py``.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scalars
from native import library
from rows import BenchError, Row, alternate

from shared_control import controllers, tasks
from shared_control.controllers import ilqr_kernels
from shared_control.cost import quadratic
from shared_control.dispatch import bound
from shared_control.filter import FilterConfig, MigFilter, Verdict
from shared_control.integrate import store_size
from shared_control.mig import Criterion
from shared_control.scenario import load
from shared_control.tasks.task import SAMPLE_TIME

#: A scenario, a state, and a control that is pushed one way and the other.
CASES: dict[str, tuple[str, list[float], list[float]]] = {
    "cart_pendulum": ("cart_pendulum_noise_assistance", [1.0, 0.2, 0.3, 0.4], [3.0]),
    # Sinking towards the ground: a touchdown and a lift-off within the horizon.
    "slip": ("slip_noise_assistance", [0.0, 0.8, 1.1, -1.0, 0.1], [5.0, 2.0]),
}

_IN_C = "criterion, C -O3 (called from Python)"
_EVALUATED = "criterion, numba (called from Python)"
_REPLACED = "filter decision, replaced (iLQR, warm)"

Call = Callable[[], object]


def seconds(call: Call, calls: int) -> float:
    """Mean seconds of a call, of this thread's processor time: what else runs on the machine does not count."""
    begin = time.thread_time()
    for _ in range(calls):
        call()
    return (time.thread_time() - begin) / calls


def typical(call: Call, calls: int, times: int = 15) -> float:
    """Median seconds of a call, over so many times of so many calls: a stall of the machine does not count."""
    return statistics.median(seconds(call, calls) for _ in range(times))


def _address(array: Any) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _agree(first: float, second: float, where: str, tolerance: float = 1e-9) -> None:
    if abs(first - second) > tolerance * abs(first):
        raise BenchError(f"the two versions disagree: {first!r} {where}, {second!r} with numba")


class Case:
    """What is timed of a task."""

    def __init__(self, name: str, horizon: float | None = None) -> None:
        scenario, state, push = CASES[name]
        config: FilterConfig = load(scenario).filter
        iterations = config.controller_iterations
        self.name = name
        self.horizon = horizon or config.horizon
        self.steps = round(self.horizon / SAMPLE_TIME)
        self.task = tasks.get(name)
        self.cost = quadratic(self.task)
        along = "user" if name == "slip" else "nominal"
        self.evaluate = Criterion(self.task, self.cost, horizon=self.horizon, dt=SAMPLE_TIME, adjoint_along=along)
        self.x, self.good, self.bad = np.array(state), -np.array(push), np.array(push)
        if self.evaluate(self.x, self.good) > 0.0:
            self.good, self.bad = self.bad, self.good
        chosen = FilterConfig(horizon=self.horizon, adjoint_along=along, controller_iterations=iterations)
        self.filter = MigFilter(self.task, chosen)
        self.filter.warm_up()
        self.controller = controllers.make(
            "ilqr", self.task, self.cost, horizon=self.horizon, iterations=iterations
        )  # fmt: skip

    @contextmanager
    def calls(self) -> Iterator[dict[str, Call]]:
        """All that is timed, by title; the C version first."""
        with library(self.name) as compiled:
            compiled.criterion.restype = ctypes.c_double
            arrays, given = self._given(self.x, self.good)
            _agree(compiled.criterion(*given), self.evaluate(self.x, self.good), "in C")

            def replace() -> None:
                self.controller.solve(self.x)
                self.controller.advance()

            yield {
                _IN_C: lambda: compiled.criterion(*given),
                _EVALUATED: lambda: self.evaluate(self.x, self.good),
                "filter decision, accepted": lambda: self.filter.decide(self.x, self.good),
                _REPLACED: lambda: self.filter.decide(self.x, self.bad),
                "controller iLQR alone, warm": replace,
            }
            del arrays

    def _given(self, *inputs: Any) -> tuple[list[Any], list[Any]]:
        """Arrays, to be kept in a name (C gets addresses, which must outlive the calls), and C's arguments."""
        arrays = [np.array(part) for part in (self.task.parameters, self.cost.state_weights, self.cost.target, *inputs)]
        given = [_address(array) for array in arrays]
        return arrays, [*given, ctypes.c_double(SAMPLE_TIME), self.steps]

    def in_scalars(self) -> float:
        """The criterion in Python scalars."""
        start = tuple(map(float, self.x))
        return scalars.criterion(
            *(self.task.parameters, self.cost.state_weights, self.cost.target),
            *(start, float(self.good[0]), SAMPLE_TIME, self.steps),
        )


def evaluation(case: Case, runs: int) -> Row:
    """One evaluation beside the same in C."""
    with case.calls() as timed:
        c, numba = alternate(
            runs, *(lambda call=timed[title]: 1e6 * typical(call, 30) for title in (_IN_C, _EVALUATED))
        )
    in_c = f"the same in C -O3, {case.steps} steps"
    return Row(f"filter.{case.name}.evaluation", _EVALUATED, "us", numba, in_c, c, wanted="ratio <= 1.2")


def cart_pendulum(runs: int) -> list[Row]:
    """Evaluation beside C and Python scalars; decision and search beside C."""
    case = Case("cart_pendulum")
    _agree(case.in_scalars(), case.evaluate(case.x, case.good), "in Python scalars")
    numba, python = alternate(
        runs,
        lambda: 1e6 * typical(lambda: case.evaluate(case.x, case.good), 30),
        lambda: 1e6 * typical(case.in_scalars, 2),
    )
    scalar = Row("filter.cart_pendulum.scalars", _EVALUATED, "us", numba, "the same in Python scalars", python)
    with library("cart_pendulum") as compiled:
        return [evaluation(case, runs), *_replacement(case, compiled, runs), scalar]


def _replacement(case: Case, compiled: ctypes.CDLL, runs: int) -> list[Row]:
    """A decision that replaces, and iLQR alone from a schedule that is always the same, beside both in C."""
    task, n, m, steps = case.task, case.task.n, case.task.m, case.steps
    case.controller.solve(case.x)
    case.controller.advance()
    # The controller's own schedule of a tick ago, which each call improves anew.
    warm = case.controller.schedule
    iterations, tolerance = case.filter.config.controller_iterations, case.filter.config.controller_tolerance
    start, limits = np.append(case.x, 0.0), np.array(task.control_limits)
    ours, theirs, decided = warm.copy(), warm.copy(), np.zeros_like(warm)
    memory = [np.zeros(shape) for shape in ((steps + 1, n + 1), (steps, m), (steps + 1, n + 1))]
    memory += [*np.zeros((2, store_size(task, steps))), np.zeros((steps, m)), np.zeros((steps, m, n))]
    kernel = bound(ilqr_kernels.search)
    compiled.replacement.restype = compiled.decision.restype = ctypes.c_double
    arrays = [np.array(part) for part in (task.parameters, *(case.cost[k] for k in (0, 3, 2)))]
    physics, weights, terminal, target = map(_address, arrays)
    weight, limit = ctypes.c_double(case.cost.control_weights[0]), ctypes.c_double(limits[0])
    x, bad, out, schedule = map(_address, (case.x, case.bad, theirs, decided))
    rest = (ctypes.c_double(SAMPLE_TIME), steps, iterations, ctypes.c_double(tolerance))

    def search() -> float:
        ours[:] = warm
        found: tuple[float, int, bool] = kernel(
            *(task.parameters, case.cost, start, ours, limits, SAMPLE_TIME, iterations, tolerance, *memory)
        )
        return found[0]

    def search_in_c() -> float:
        theirs[:] = warm
        return float(compiled.replacement(physics, weights, terminal, target, weight, limit, x, out, *rest))

    def decide_in_c() -> float:
        return float(compiled.decision(physics, weights, terminal, target, weight, limit, x, bad, schedule, *rest))

    def decide() -> float:
        return float(case.filter.decide(case.x, case.bad).applied_control[0])

    _agree(search_in_c(), search(), "in C")
    if not np.allclose(ours, theirs, rtol=1e-6, atol=1e-9):
        raise BenchError("the two versions disagree on a schedule")
    case.filter.reset()
    for _ in range(20):
        _agree(decide_in_c(), decide(), "decided in C", 1e-6)
    calls = (decide, decide_in_c, search, search_in_c)
    ours_decided, c_decided, ours_sought, c_sought = alternate(
        runs, *(lambda call=call: 1e6 * typical(call, 30) for call in calls)
    )
    del arrays
    what = f"iLQR alone, {iterations} iterations at most from one schedule each time, {steps} steps, numba"
    return [
        Row(
            *("filter.cart_pendulum.replacement", f"{_REPLACED}: evaluation and search, of a tick after the other"),
            *("us", ours_decided, "the same in C -O3, both called from Python", c_decided),
        ),
        Row("filter.cart_pendulum.ilqr", what, "us", ours_sought, "the same in C -O3", c_sought),
    ]


def slip(runs: int) -> list[Row]:
    """Evaluation beside C; a decision that replaces beside an evaluation, because there is no search in C."""
    case = Case("slip")
    with case.calls() as timed:
        c, replaced = alternate(
            runs, *(lambda call=timed[title]: 1e6 * typical(call, 30) for title in (_IN_C, _REPLACED))
        )
    baseline = "one evaluation in C -O3 (its search has no version in C)"
    return [evaluation(case, runs), Row("filter.slip.replacement", _REPLACED, "us", replaced, baseline, c)]


def laboratory(runs: int) -> list[Row]:
    """Check and update at the laboratory's horizon, T = 1 s of 100 RK4 steps.

    Its figures are published ones, from another machine and g++ -O2; the better end of each range stands here.
    """
    task = tasks.get("cart_pendulum")
    chosen = FilterConfig(mode="assistance", horizon=1.0, controller="sac", controller_iterations=1)
    judge = MigFilter(task, chosen)
    judge.warm_up()
    x, push = np.array(CASES["cart_pendulum"][1]), np.array(CASES["cart_pendulum"][2])
    good, bad = (push, -push) if judge.decide(x, push).verdict is Verdict.ACCEPTED else (-push, push)
    check, update = alternate(
        runs,
        lambda: 1e6 * typical(lambda: judge.decide(x, good), 30),
        lambda: 1e6 * typical(lambda: judge.decide(x, bad), 30),
    )
    published = "the better end of the laboratory's C++, published"
    return [
        Row(
            *("filter.laboratory.check", "filter decision, accepted, T = 1 s, 100 steps", "us", check),
            *(f"{published}: 90 to 140 us", (90.0,) * runs),
            wanted="ratio <= 0.2",
        ),
        Row(
            *("filter.laboratory.update", "filter decision, replaced by one SAC update", "us", update),
            *(f"{published}: 320 to 360 us", (320.0,) * runs),
            wanted="ratio <= 0.5",
        ),
    ]


def batch(runs: int, count: int = 1000) -> list[Row]:
    """Many states in one call."""
    case = Case("cart_pendulum")
    states = np.random.default_rng(0).normal(case.x, 1.0, (count, case.task.n))
    values = np.zeros(count)
    with library("cart_pendulum") as compiled:
        _, given = kept = case._given(states, case.good)
        out = _address(values)
        found = case.evaluate.many(states, case.good)
        compiled.criteria(*given, count, out)
        if not np.allclose(values, found, rtol=1e-6, atol=1e-9):
            raise BenchError("the two versions disagree over a batch of states")
        numba, c = alternate(
            runs,
            lambda: 1e6 / count * typical(lambda: case.evaluate.many(states, case.good), 1),
            lambda: 1e6 / count * typical(lambda: compiled.criteria(*given, count, out), 1),
        )
        del kept
    what = f"evaluation of {count} states in one call, numba, each"
    return [Row("filter.batch", what, "us", numba, "the same in C -O3, one call, each", c)]


def measure(name: str, horizon: float | None, runs: int, calls: int) -> None:
    """Print the table of a task."""
    case = Case(name, horizon)
    with case.calls() as timed:
        found = alternate(runs, *(lambda call=call: seconds(call, calls) for call in timed.values()))
        titles = list(timed)
    base = statistics.median(found[0])
    load_average = os.getloadavg()[0]
    print(f"{name}, horizon {case.horizon} s = {case.steps} steps; {runs} runs of {calls}; load {load_average:.1f}")
    print(f"{'':42}{'p50 us':>10}{'least us':>10}{'x C':>8}")
    for title, times in zip(titles, found, strict=True):
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
    try:
        for name in options.tasks or CASES:
            measure(name, options.horizon, options.runs, options.calls)
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
