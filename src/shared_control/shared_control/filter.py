"""The MIG filter: Algorithm 1 of the paper.

A user's control u of the coming sample is judged by its criterion (:mod:`shared_control.mig`):

    accept  iff  criterion <= threshold - c J          (the paper: threshold = 0, c = 0)

with J the cost of doing nothing over the horizon: c > 0 is the contractive constraint, which asks of an action that it
lower the cost by a share of what there is, and refuses one that changes nothing. With ``continuation="controller"``
the criterion asks whether the user's action helps if the controller takes over after it (u_2 goes on with the schedule
that the controller finds where the action leads), so that it refuses only what the controller could not mend.

Several inputs are judged jointly, by one criterion, or separately, each by that of its own action with the others at
rest; then only what is refused is taken from the user. The decision shows the largest criterion, and its verdict is
ACCEPTED if nothing was refused.

Baselines judge by other values in the criterion's place, for comparison: ``judge="random"`` by rate - U with U uniform
on [0, 1) for each action (is it the criterion that does the work, or the replacement?), ``"agreement"`` by -u^T u_c
with the controller's u_c (does the user do what the controller would?), ``"predictive"`` by 1 where the task would fail
within the controller's horizon although the controller took over after the user's sample, -1 where it would not: a
predictive safety filter without a terminal set (Wabersich and Zeilinger, Automatica 129, 2021), which stops only what
could not be made good. Where nothing counts as failure, as on a track without an end, it accepts everything.

An accepted action passes as it is. A rejected one becomes nothing in training, and in assistance the controller's. An
action whose every component is at most ``dead_zone`` is no action: there is nothing to judge, and it passes. Whatever
cannot be judged never passes, and the reason is told. Where the state or the wrench is lost, not finite or not to be
believed (:data:`INPUT_FAULTS`) nothing takes its place, in every mode; where both are good and only the criterion is
not finite, assistance goes on with the controller's last valid schedule, then nothing.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from shared_control import controllers, cost
from shared_control.decision import INPUT_FAULTS, Decision, Mode, Reason, Verdict
from shared_control.parameters import ParameterError, build, parameter
from shared_control.streams import stream
from shared_control.tasks.task import SAMPLE_TIME, Array, Task

if TYPE_CHECKING:
    from collections.abc import Callable

    from shared_control.controllers import Controller, Solution
    from shared_control.cost import QuadraticCost

__all__ = ["INPUT_FAULTS", "Decision", "FilterConfig", "MigFilter", "Mode", "Reason", "Verdict", "costs"]


@dataclasses.dataclass(frozen=True)
class FilterConfig:
    """Parameters of the filter and of the controller that it engages. An empty array: the task's own default."""

    mode: str = parameter(
        "assistance",
        "What a rejected action becomes: off accepts everything, training gives nothing, assistance the controller's.",
        choices=("off", "training", "assistance"),
        live=True,
    )
    # The laboratory's 1.0 to 1.2 s inverts this pendulum too, but with its weight on the cart and no terminal cost it
    # then gives up balance now and again to bring the cart home; from 1.5 s it stays up.
    horizon: float = parameter(1.5, "T, over which an action is judged.", unit="s", ge=0.001, le=60.0)
    state_weights: tuple[float, ...] = parameter((), "Diagonal of Q, for each state; empty: the task's.", ge=0.0)
    control_weights: tuple[float, ...] = parameter((), "Diagonal of R, for each control; empty: the task's.", ge=0.0)
    terminal_weights: tuple[float, ...] = parameter((), "Diagonal of P, for each state; empty: the task's.", ge=0.0)
    target: tuple[float, ...] = parameter((), "x_d, the desired state; empty: the task's.")
    adjoint_along: str = parameter(
        "nominal",
        "Trajectory that state and adjoint are taken along: the nominal one (null action) or the user's.",
        choices=("nominal", "user"),
    )
    continuation: str = parameter(
        "null",
        "What u_2 is after the user's sample: nothing, or the controller's schedule from where that sample leads.",
        choices=("null", "controller"),
    )
    judge: str = parameter(
        "mig",
        "What judges an action: the criterion, or a baseline.",
        choices=("mig", "random", "agreement", "predictive"),
    )
    rejection_rate: float = parameter(0.5, "Share that judge: random rejects.", ge=0.0, le=1.0)
    threshold: float = parameter(0.0, "An action is accepted if its criterion is at most this.", unit="cost", live=True)
    contraction: float = parameter(
        0.0, "c: an action must lower the cost by this share of the cost of doing nothing.", ge=0.0, live=True
    )
    channels: str = parameter(
        "jointly", "How the inputs of a task with several are judged.", choices=("jointly", "separately")
    )
    dead_zone: float = parameter(
        0.0, "A control of at most this in every component is no action.", unit="of the control", ge=0.0, live=True
    )
    controller: str = parameter("ilqr", "Controller of assistance.", choices=controllers.names())
    controller_horizon: float = parameter(0.0, "Horizon of the controller; 0: the filter's.", unit="s", ge=0.0, le=60.0)
    controller_iterations: int = parameter(3, "Most iterations of the controller in a tick.", ge=1, le=1000)
    controller_tolerance: float = parameter(
        1e-3, "Relative gain or change of control at which the controller has converged.", ge=0.0, le=1.0
    )
    controller_state_weights: tuple[float, ...] = parameter((), "As state_weights; empty: the filter's.", ge=0.0)
    controller_control_weights: tuple[float, ...] = parameter((), "As control_weights; empty: the filter's.", ge=0.0)
    controller_terminal_weights: tuple[float, ...] = parameter((), "As terminal_weights; empty: the filter's.", ge=0.0)
    control_limits: tuple[float, ...] = parameter(
        (), "Largest magnitude of the controller's controls; empty: the task's.", unit="of the control", ge=0.0
    )
    # Above what any shipped user pushes (SLIP's toe through 40 N s/m: 1.6 kN), so that no result depends on it.
    max_force: float = parameter(
        10_000.0,
        "A user's force with a larger component is not believed and admits nothing. Set it to the sensor's range.",
        unit="N",
        ge=0.0,
        live=True,
    )


def costs(task: Task, config: FilterConfig) -> tuple[QuadraticCost, QuadraticCost]:
    """Objectives of the filter and of its controller.

    Raises
    ------
    ParameterError: a number of elements that the task does not have.
    """
    judged = cost.quadratic(task, config.state_weights, config.control_weights, config.terminal_weights, config.target)
    try:
        steered = cost.quadratic(
            task,
            config.controller_state_weights or judged.state_weights,
            config.controller_control_weights or judged.control_weights,
            config.controller_terminal_weights or judged.terminal_weights,
            judged.target,
        )
    except ParameterError as error:
        raise ParameterError(f"controller_{error}") from None
    return judged, steered


def _numbers(values: Array) -> list[float]:
    # To go through an array takes three times as long.
    found: list[float] = np.asarray(values).tolist()
    return found


def _finite(values: Array) -> bool:
    return all(map(math.isfinite, _numbers(values)))


class MigFilter:
    """Judges a user's controls one sample at a time. Call :meth:`decide` once a tick: the controller's schedule ages by
    it.
    """

    def __init__(self, task: Task, config: FilterConfig | None = None, *, sample_time: float = SAMPLE_TIME) -> None:
        # Imported here, so that a process that only reads a configuration does not load the compiler.
        from shared_control.integrate import Stepper
        from shared_control.mig import CostOfNothing, Criterion

        self.task = task
        self.config = FilterConfig() if config is None else config
        judged, steered = costs(task, self.config)
        self._criterion = Criterion(
            task, judged, horizon=self.config.horizon, dt=sample_time, adjoint_along=self.config.adjoint_along
        )
        self._cost_of_nothing = CostOfNothing(task, judged, horizon=self.config.horizon, dt=sample_time)
        self._controller = self._make_controller(steered, sample_time)
        #: The one that is asked what it would do after the user's sample; its schedules are not those that are applied.
        self._successor: Controller | None = None
        if self.config.continuation == "controller" or self.config.judge == "predictive":
            self._successor = self._make_controller(steered, sample_time)
        self._stepper = Stepper(task, sample_time)
        self._agreed: Solution | None = None
        judges: dict[str, Callable[[Array, Array, int | None], float]] = {
            "mig": self._criterion if self._successor is None else self._continued,
            "random": self._at_random,
            "agreement": self._agreement,
            "predictive": self._predictive,
        }
        self._judge = judges[self.config.judge]
        self._random = stream(0, "filter")
        self._null = np.zeros(task.m)
        self._null.setflags(write=False)
        self._separately = self.config.channels == "separately" and task.m > 1
        self._mode = Mode.of(self.config.mode)
        self._threshold, self._dead_zone = self.config.threshold, self.config.dead_zone
        #: [N] Largest component of a force that is believed; whoever turns forces into controls asks it.
        self.max_force = self.config.max_force
        self._contraction = self.config.contraction

    def _make_controller(self, steered: QuadraticCost, sample_time: float) -> Controller:
        return controllers.make(
            self.config.controller,
            self.task,
            steered,
            dt=sample_time,
            horizon=self.config.controller_horizon or self.config.horizon,
            limits=self.config.control_limits,
            iterations=self.config.controller_iterations,
            tolerance=self.config.controller_tolerance,
        )

    @property
    def mode(self) -> Mode:
        """Mode in force; settable by name or number, at any time between two ticks."""
        return self._mode

    @mode.setter
    def mode(self, mode: str | int) -> None:
        self._mode = Mode.of(mode)

    @property
    def threshold(self) -> float:
        """Threshold in force [unit of the cost]."""
        return self._threshold

    def configure(self, **values: object) -> None:
        """Change live parameters.

        Raises
        ------
        ParameterError: a parameter that is not live, or a value that its declaration refuses; nothing is changed then.
        """
        live = {field.name for field in dataclasses.fields(FilterConfig) if field.metadata["parameter"]["live"]}
        fixed = [key for key in values if key not in live]
        checked = build(FilterConfig, values)
        if fixed:
            raise ParameterError(
                f"{fixed[0]}: cannot change while the filter runs; these can: {', '.join(sorted(live))}"
            )
        if "mode" in values:
            self._mode = Mode.of(checked.mode)
        if "threshold" in values:
            self._threshold = checked.threshold
        if "contraction" in values:
            self._contraction = checked.contraction
        if "dead_zone" in values:
            self._dead_zone = checked.dead_zone
        if "max_force" in values:
            self.max_force = checked.max_force

    def decide(self, x: Array, u_user: Array, task_mode: int | None = None) -> Decision:
        """Judge the control (m,) of the coming sample at the state (n,).

        ``task_mode`` of a hybrid task; None: that of the state alone (:meth:`Task.mode`).
        """
        self._advance()
        mode = self._mode
        if not _finite(x):
            return self._nothing(Reason.NON_FINITE_STATE, u_user)
        if not _finite(u_user):
            return self._nothing(Reason.NON_FINITE_WRENCH, u_user)
        if mode is Mode.OFF:
            return self._decision(Verdict.ACCEPTED, Reason.FILTER_OFF, math.nan, u_user, u_user)
        if max(map(abs, _numbers(u_user))) <= self._dead_zone:
            return self._decision(Verdict.ACCEPTED, Reason.NULL_ACTION, math.nan, u_user, u_user)
        self._agreed = None
        values = self._one_by_one(x, u_user, task_mode) if self._separately else None
        criterion = self._judge(x, u_user, task_mode) if values is None else float(values.max())
        bound = self._threshold
        if self._contraction > 0.0:
            bound -= self._contraction * self._cost_of_nothing(x, task_mode)
        if not (math.isfinite(criterion) and math.isfinite(bound)):
            return self._unjudged(Reason.NON_FINITE_CRITERION, u_user)
        if criterion <= bound:
            return self._decision(Verdict.ACCEPTED, Reason.CRITERION, criterion, u_user, u_user, bound)
        verdict, reason, substitute = Verdict.REJECTED, Reason.CRITERION, self._null
        if mode is Mode.ASSISTANCE:
            solution = self._agreed or self._controller.solve(x, task_mode)
            reason = Reason.CRITERION if solution.usable else Reason.NOT_CONVERGED
            verdict, substitute = Verdict.REPLACED, solution.control
        applied = substitute if values is None else np.where(values > bound, substitute, u_user)
        return self._decision(verdict, reason, criterion, u_user, applied, bound)

    def fallback(self, reason: Reason | int, u_user: Array) -> Decision:
        """Nothing, in place of an action whose state or wrench is lost or not to be believed, whatever the mode.

        A person's hand may be on the robot: who does not know where it is or what it does must not move it. Counts as a
        tick, as :meth:`decide` does.
        """
        self._advance()
        return self._nothing(Reason(reason), u_user)

    def reset(self, seed: int = 0) -> None:
        """As new, for the trial with this seed, except for live parameters: they stay as they were set."""
        for controller in filter(None, (self._controller, self._successor)):
            controller.reset()
        self._random = stream(seed, "filter")

    def warm_up(self) -> None:
        """Compile, or load, every kernel; leaves the filter as :meth:`reset` does."""
        x = self.task.initial_state
        self._criterion(x, np.ones(self.task.m))
        self._cost_of_nothing(x)
        self._controller.solve(x)
        if self._successor is not None:
            self._judge(x, np.ones(self.task.m), None)
        self.reset()

    def _one_by_one(self, x: Array, u_user: Array, task_mode: int | None) -> Array:
        """Criterion of each input by itself, (m,); -infinity where there is nothing to judge."""
        values = np.full(len(u_user), -math.inf)
        for j in np.flatnonzero(np.abs(u_user) > self._dead_zone):
            alone = np.zeros(len(u_user))
            alone[j] = u_user[j]
            values[j] = self._judge(x, alone, task_mode)
        return values

    def _advance(self) -> None:
        self._controller.advance()
        if self._successor is not None:
            self._successor.advance()

    def _succeed(self, x: Array, u_user: Array, task_mode: int | None) -> tuple[Array, int, Array] | None:
        """Where the user's sample leads, state and mode, and the controller's schedule from there, if it has one."""
        assert self._successor is not None
        after = np.array(x, dtype=float)
        task_mode_after = self._stepper.advance(after, u_user, task_mode)
        if not self._successor.solve(after, task_mode_after).usable:
            return None
        return after, task_mode_after, self._successor.schedule

    def _continued(self, x: Array, u_user: Array, task_mode: int | None) -> float:
        succession = self._succeed(x, u_user, task_mode)
        return math.nan if succession is None else self._criterion(x, u_user, task_mode, succession[2])

    def _predictive(self, x: Array, u_user: Array, task_mode: int | None) -> float:
        succession = self._succeed(x, u_user, task_mode)
        if succession is None:
            return math.nan
        after, mode, schedule = succession
        for u in schedule:
            if self.task.failure(after):
                return 1.0
            mode = self._stepper.advance(after, u, mode)
        return 1.0 if self.task.failure(after) else -1.0

    def _at_random(self, x: Array, u_user: Array, task_mode: int | None) -> float:
        return self.config.rejection_rate - self._random.random()

    def _agreement(self, x: Array, u_user: Array, task_mode: int | None) -> float:
        self._agreed = self._agreed or self._controller.solve(x, task_mode)
        return -float(np.dot(u_user, self._agreed.control))

    def _nothing(self, reason: Reason, u_user: Array) -> Decision:
        return self._decision(Verdict.REJECTED, reason, math.nan, u_user, self._null)

    def _unjudged(self, reason: Reason, u_user: Array) -> Decision:
        # State and wrench are known here, so the controller may go on with its last schedule.
        if self._mode is Mode.ASSISTANCE:
            return self._decision(Verdict.REPLACED, reason, math.nan, u_user, self._controller.fallback())
        return self._nothing(reason, u_user)

    def _decision(
        self,
        verdict: Verdict,
        reason: Reason,
        criterion: float,
        u_user: Array,
        applied: Array,
        bound: float | None = None,
    ) -> Decision:
        threshold = self._threshold if bound is None else bound
        return Decision(verdict, reason, self._mode, criterion, threshold, u_user, self._null, applied)
