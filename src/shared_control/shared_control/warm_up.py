"""Compile every kernel of the paper's tasks into the cache: ``python -m shared_control.warm_up``."""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from shared_control import controllers, cost, kernels_cache, tasks
from shared_control.integrate import Stepper
from shared_control.mig import Criterion
from shared_control.tasks.task import SAMPLE_TIME


def kernels(name: str) -> Iterator[tuple[str, Callable[[], object]]]:
    """What there is to compile for a task: a title, and a call that compiles it."""
    task = tasks.get(name)
    objective = cost.quadratic(task)
    stepper = Stepper(task, SAMPLE_TIME)
    x, u = task.initial_state, np.ones(task.m)
    yield "integration step", lambda: stepper.advance(x.copy(), u)
    yield "criterion", lambda: Criterion(task, objective, horizon=10 * SAMPLE_TIME, dt=SAMPLE_TIME)(x, u)
    for controller in controllers.names():
        solver = controllers.make(controller, task, objective)
        yield f"controller {controller}", functools.partial(solver.solve, x)


def compile_task(name: str) -> None:
    """Compile the kernels of one task, and print each as it is done."""
    for title, compile_ in kernels(name):
        begin = time.perf_counter()
        compile_()
        print(f"  {name}: {title} {time.perf_counter() - begin:.1f} s", flush=True)


def main() -> None:
    """Compile the tasks side by side, as far as there are cores."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(f"kernels go to {kernels_cache.directory()}", flush=True)
    # The tutorial's task is compiled by who follows it.
    names = ("cart_pendulum", "slip")
    # Fresh processes: a forked copy would share what numba holds locked.
    with ProcessPoolExecutor(min(len(names), os.cpu_count() or 1), multiprocessing.get_context("spawn")) as pool:
        list(pool.map(compile_task, names))


if __name__ == "__main__":
    main()
