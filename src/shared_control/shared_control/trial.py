"""Trials without ROS: one, or many on as many cores as there are, with the same results for any number of workers."""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from shared_control import loop, measures
from shared_control.filter import Reason, Verdict
from shared_control.parameters import ParameterError
from shared_control.scenario import Scenario, load
from shared_control.tasks.slip import STANCE
from shared_control.tasks.task import Array
from shared_control.users import presets

__all__ = ["TrialResult", "judged", "measured", "run_trial", "run_trials", "wanted_speed"]

Source = str | os.PathLike[str] | Mapping[str, Any] | Scenario


@dataclasses.dataclass(frozen=True)
class TrialResult:
    """All of one trial: N ticks, N+1 states."""

    scenario: str
    seed: int
    sample_time: float  # [s]
    time: Array  # (N,) [s] t_k
    states: Array  # (N+1, n)
    task_modes: np.ndarray  # (N+1,) of a hybrid task, otherwise 0
    user_force: Array  # (N, 3) [N]
    admitted_force: Array  # (N, 3) [N]
    user_control: Array  # (N, m)
    applied_control: Array  # (N, m)
    verdict: np.ndarray  # (N,) Verdict
    reason: np.ndarray  # (N,) Reason
    criterion: Array  # (N,) NaN where it was not evaluated
    outcome: int  # loop.OPEN, SUCCESS or FAILURE at the end
    measures: Any  # the task's, see shared_control.measures


class _Loop:
    """The agents of a scenario, warm, for one trial after another."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.user = loop.make_user(scenario, 0)
        self.filter = loop.make_filter(scenario)
        self.robot = loop.make_robot(scenario)
        self.plant = loop.make_plant(scenario, 0)
        for agent in (self.user, self.filter, self.robot, self.plant):
            agent.warm_up()

    def run(self, seed: int) -> TrialResult:
        user, filter_, robot, plant = self.user, self.filter, self.robot, self.plant
        user.reset(seed)
        filter_.reset(seed)
        robot.reset()
        plant.reset(seed)
        settings = self.scenario.loop
        ticks, n, m = settings.ticks, plant.task.n, plant.task.m
        time = np.arange(ticks, dtype=float) * settings.sample_time
        states, task_modes = np.empty((ticks + 1, n)), np.empty(ticks + 1, np.uint8)
        user_force, admitted_force = np.empty((ticks, 3)), np.empty((ticks, 3))
        user_control, applied_control = np.empty((ticks, m)), np.empty((ticks, m))
        verdict, reason = np.empty(ticks, np.uint8), np.empty(ticks, np.uint8)
        criterion = np.empty(ticks)
        x = plant.state
        states[0], task_modes[0] = x, plant.task_mode
        for k in range(ticks):
            force = user.act(k, k * settings.sample_time, x, plant.task_mode)
            decision, admitted, _ = filter_.decide(x, force, plant.task_mode)
            x = plant.step(robot.step(admitted), admitted)
            states[k + 1], task_modes[k + 1] = x, plant.task_mode
            user_force[k], admitted_force[k] = force, admitted
            user_control[k], applied_control[k] = decision.user_control, decision.applied_control
            verdict[k], reason[k], criterion[k] = decision.verdict, decision.reason, decision.criterion
        return TrialResult(
            scenario=self.scenario.name,
            seed=seed,
            sample_time=settings.sample_time,
            time=time,
            states=states,
            task_modes=task_modes,
            user_force=user_force,
            admitted_force=admitted_force,
            user_control=user_control,
            applied_control=applied_control,
            verdict=verdict,
            reason=reason,
            criterion=criterion,
            outcome=plant.outcome,
            measures=measured(self.scenario, states, user_control, verdict, reason, task_modes),
        )


def wanted_speed(scenario: Scenario, nodes: int) -> list[float] | None:
    """What a user with a purpose wants a runner's speed [m/s] to be at each node; None for any other."""
    if scenario.loop.task != "slip" or scenario.user.user not in ("mpc", "graded", "human"):
        return None
    preset = presets.get("slip", scenario.user.preset)
    return [float(preset.aim(k * scenario.loop.sample_time)[1]) for k in range(nodes)]


def measured(
    scenario: Scenario,
    states: Array,
    user_control: Array,
    verdict: np.ndarray,
    reason: np.ndarray,
    task_modes: np.ndarray,
) -> Any:
    """The measures of the scenario's task, None if it has none; shapes as in :class:`TrialResult`."""
    action = (reason != Reason.NULL_ACTION) & np.any(user_control != 0.0, axis=1)
    sample, intervened = scenario.loop.sample_time, verdict != Verdict.ACCEPTED
    if scenario.loop.task == "cart_pendulum":
        return measures.cart_pendulum(states, sample, action=action, intervened=intervened)
    if scenario.loop.task == "slip":
        speed = wanted_speed(scenario, len(states))
        fall_height = scenario.loop.make_task().parameters.fall_height
        return measures.slip(
            states, sample, action=action, intervened=intervened, wanted_speed=speed, stance=task_modes == STANCE,
            fall_height=fall_height,
        )  # fmt: skip
    return None


def run_trial(scenario: Source, seed: int | None = None) -> TrialResult:
    """One trial, without waiting for the wall clock; ``seed`` is the scenario's own if left out.

    Raises
    ------
    ScenarioError: see :func:`shared_control.scenario.load`.
    """
    loaded = load(scenario)
    return _Loop(loaded).run(loaded.loop.seed if seed is None else seed)


def judged(result: TrialResult, scenario: Source) -> Any:
    """Measures of a trial as if a scenario's filter had judged its actions and touched none of them.

    What the paper reports of the sets in which the filter is not engaged: the rejected share of what a user does alone.

    Raises
    ------
    ScenarioError: see :func:`shared_control.scenario.load`.
    """
    loaded = load(scenario)
    agent = loop.make_filter(loaded)
    agent.reset(result.seed)
    verdict, reason = np.empty_like(result.verdict), np.empty_like(result.reason)
    ticks = zip(result.states[:-1], result.user_force, result.task_modes[:-1], strict=True)
    for k, (x, force, task_mode) in enumerate(ticks):
        decision = agent.decide(x, force, int(task_mode)).decision
        verdict[k], reason[k] = decision.verdict, decision.reason
    return measured(loaded, result.states, result.user_control, verdict, reason, result.task_modes)


_worker: _Loop | None = None


def _start(scenario: Scenario) -> None:
    global _worker  # noqa: PLW0603 one for each process of the pool
    _worker = _Loop(scenario)


def _run(seed: int) -> TrialResult:
    assert _worker is not None
    return _worker.run(seed)


def run_trials(
    scenario: Source, seeds: Iterable[int], workers: int | None = None, *, progress: bool | None = None
) -> list[TrialResult]:
    """One trial for each seed, in their order, on ``workers`` processes (all that this process may use, if left out).

    The results do not depend on the number of workers. A progress bar is shown where standard error is a terminal.

    Raises
    ------
    ScenarioError: see :func:`shared_control.scenario.load`.
    ParameterError: ``workers`` below 1.
    """
    loaded, wanted = load(scenario), list(seeds)
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers < 1:
        raise ParameterError(f"workers: {workers} is not allowed; it must be at least 1")
    shown = sys.stderr.isatty() if progress is None else progress
    workers = min(workers, max(1, len(wanted)))
    if workers == 1:
        single = _Loop(loaded)
        return list(_with_progress(map(single.run, wanted), len(wanted), loaded.name, shown))
    # Imported here: nodes use this package without ever starting a pool.
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # Compile once, here, and let the workers load the result. Forked workers begin with it at once, and, unlike spawned
    # ones, do not run the caller's main module again.
    _Loop(loaded)
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
    with ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context(method), initializer=_start, initargs=(loaded,)
    ) as pool:
        return list(_with_progress(pool.map(_run, wanted), len(wanted), loaded.name, shown))


def _with_progress(results: Iterator[TrialResult], total: int, name: str, shown: bool) -> Iterator[TrialResult]:
    for done, result in enumerate(results, 1):
        if shown:
            filled = 30 * done // total
            end = "\n" if done == total else ""
            print(
                f"\r{name} [{'#' * filled}{'.' * (30 - filled)}] {done}/{total}", end=end, file=sys.stderr, flush=True
            )
        yield result
