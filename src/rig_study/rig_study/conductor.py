"""The conductor: a node that leads a subject through a session on the live graph, trial by trial.

It sets the filter's mode, starts each trial with its subject, set, number and seed, and goes on when the recorder has
closed the trial's bag. ``conductor/pause``, ``conductor/resume`` and ``conductor/repeat`` (the last trial again) are
services; a trial is aborted by ``trial/abort``, as ever, and then done again. ``conductor/state`` says how far it is;
what happened is in the session's log.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from mig_interfaces.msg import RecorderState, SessionState, TrialState
from mig_interfaces.srv import StartTrial
from rig_runtime import topics
from rig_runtime.parameters import refuse_unknown_types
from rig_study.protocol import PlannedTrial
from rig_study.reception import Reception
from rig_study.session import Session
from rig_study.studies import Choice, Studies

__all__ = ["ConductorNode"]

_PERIOD = 0.05  # [s] between two looks at what is due
_NO_BAG = 5.0  # [s] after which an aborted trial has none: its recorder could not open it
_NEWS = ("trials_done", "set", "trial", "attempt", "waiting", "over", "instructions")
#: Times that one trial may be aborted in a row before the conductor waits for a person.
_PATIENCE = 3


class ConductorNode(Node):
    """Leads a session.

    Parameters
    ----------
    session: open; the conductor writes into it, and leaves closing to its owner.
    wait_for_person: before each trial wait for ``conductor/resume``, as after a pause.
    skill: of the simulated user in each trial, where a virtual subject is led through the session.
    studies: what may be chosen in the place of this session, between two trials and after the last.
    kwargs: of ``rclpy.node.Node``.
    """

    def __init__(
        self,
        session: Session,
        *,
        wait_for_person: bool = False,
        skill: Callable[[PlannedTrial], float] | None = None,
        studies: Studies | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__("conductor", **kwargs)
        self.session = session
        self.trial: PlannedTrial | None = None
        #: What the conductor does, for a person to read.
        self.doing = "waiting for the graph"
        self.over = False
        self._waits = wait_for_person
        self._skill = skill
        self._paused = False
        self._aborts = 0
        self._state = TrialState()
        self._recorder = RecorderState()
        self._uid = 0  # of the trial that was started
        self._began = 0.0
        self._before = ""  # the recorder's bag before this trial's
        self._ended = 0.0
        self._step: Callable[[], None] = self._next
        self._due = 0.0
        for topic, take in ((topics.TRIAL_STATE, self._on_trial), (topics.RECORDER_STATE, self._on_recorder)):
            self.create_subscription(topic.type, topic.name, take, topic.qos)
        self._start = self.create_client(StartTrial, topics.START_SERVICE)
        self._set = self.create_client(SetParameters, "mig_filter/set_parameters")
        self._set_user = self.create_client(SetParameters, "user_sim/set_parameters") if skill else None
        for name, serve in (
            (topics.PAUSE_SERVICE, self._pause),
            (topics.RESUME_SERVICE, self._resume),
            (topics.REPEAT_SERVICE, self._repeat),
        ):
            self.create_service(Trigger, name, serve)
        state = topics.SESSION_STATE
        self._told = SessionState()
        self._teller = self.create_publisher(state.type, state.name, state.qos)
        self._reception = None if studies is None else Reception(self, studies, self._engaged)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_PERIOD, self._go_on, clock=steady)
        self.create_timer(1.0, lambda: self._tell(force=True), clock=steady)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **kwargs: Any) -> Any:
        """As rclpy's; but its own parameter services refuse what has a type that there is not."""
        if srv_type in (SetParameters, SetParametersAtomically):
            callback = refuse_unknown_types(callback)
        return super().create_service(srv_type, srv_name, callback, **kwargs)

    @property
    def choice(self) -> Choice | None:
        """Another session that an operator has chosen; this one then starts no more trials."""
        return None if self._reception is None else self._reception.choice

    def progress(self) -> str:
        """One line for a person."""
        progress, trial = self.session.progress, self.trial
        where = "" if trial is None else f"{trial.set} {trial.trial}, attempt {trial.attempt}, {trial.mode}: "
        left = f"{len(progress.done)} of {len(progress.plan)} trials, {progress.remaining / 60.0:.1f} min left"
        return f"{progress.subject}  {left}  {where}{self._words()}"

    def state(self) -> SessionState:
        """How far the session is."""
        progress, trial = self.session.progress, self.trial
        study = progress.protocol
        message = SessionState(
            protocol=study.name,
            subject=progress.subject,
            trials_done=len(progress.done),
            trials_planned=len(progress.plan),
            waiting=self._step == self._ready and self._paused,
            over=self.over,
            doing=self._words(),
        )
        message.remaining.sec = round(progress.remaining)
        if trial is not None:
            message.set, message.trial = trial.set, trial.trial
            message.attempt, message.mode = trial.attempt, trial.mode
            if self._step in (self._breaking, self._ready):
                message.instructions = study.instructions(trial)
        return message

    def _go_on(self) -> None:
        if self.choice is None:
            self._step()
        self._tell()

    def _engaged(self) -> str:
        between = self.over or self._step in (self._next, self._breaking, self._ready)
        if between and self._state.phase not in (TrialState.PHASE_ARMING, TrialState.PHASE_RUNNING):
            return ""
        return f"a trial is going on or being started; wait for its end, or call {topics.ABORT_SERVICE}"

    def _tell(self, force: bool = False) -> None:
        message = self.state()
        # Words count down; what else has changed is news.
        news = [field for field in _NEWS if getattr(message, field) != getattr(self._told, field)]
        if news or force:
            self._told = self.state()
            message.stamp = self.get_clock().now().to_msg()
            self._teller.publish(message)

    def _words(self) -> str:
        if self._step == self._breaking:
            return f"break, {max(0.0, self._due - time.monotonic()):.0f} s"
        if self._step == self._watch and self._state.phase == TrialState.PHASE_RUNNING:
            return f"running, {time.monotonic() - self._began:.0f} s"
        return self.doing

    # -- steps: each is called again until it puts another in its place ----------------------------------------------

    def _next(self) -> None:
        clients = [client for client in (self._start, self._set, self._set_user) if client is not None]
        if not (all(client.service_is_ready() for client in clients) and self._recorder.uri):
            return
        self.trial = trial = self.session.progress.next()
        if trial is None:
            self.doing, self.over, self._step = "done", True, self._idle
            return
        # A break is not had twice: neither before a repeated trial, nor by who comes back after a crash.
        self._due = time.monotonic() + (trial.break_before if trial.attempt == 1 else 0.0)
        self._step = self._breaking
        self._paused = self._paused or self._waits

    def _breaking(self) -> None:
        if time.monotonic() >= self._due:
            self._step = self._ready

    def _ready(self) -> None:
        if self._paused:
            self.doing = f"waiting for {topics.RESUME_SERVICE}"
            return
        assert self.trial is not None
        self.doing, self._step = "setting the filter's mode", self._idle
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=self.trial.mode)
        request = SetParameters.Request(parameters=[Parameter(name="mode", value=value)])
        self._set.call_async(request).add_done_callback(self._on_mode)

    def _on_mode(self, future: Any) -> None:
        result, trial = future.result().results[0], self.trial
        assert trial is not None
        if not result.successful:
            self._failed(f"the filter refuses mode {trial.mode}: {result.reason}")
            return
        if self._set_user is None or self._skill is None:
            self._begin(trial)
            return
        skill = self._skill(trial)
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=skill)
        request = SetParameters.Request(parameters=[Parameter(name="skill", value=value)])
        self._set_user.call_async(request).add_done_callback(lambda future: self._on_skill(future, trial, skill))

    def _on_skill(self, future: Any, trial: PlannedTrial, skill: float) -> None:
        result = future.result().results[0]
        if not result.successful:
            self._failed(f"the simulated user refuses skill {skill:g}: {result.reason}")
            return
        self._begin(trial, skill=skill)

    def _begin(self, trial: PlannedTrial, **noted: Any) -> None:
        self.doing, self._before, self._ended = "starting", self._recorder.uri, 0.0
        self.session.start(trial, **noted)
        request = StartTrial.Request(
            subject=trial.subject,
            group=trial.group,
            set=trial.set,
            trial=trial.trial,
            attempt=trial.attempt,
            seed=trial.seed,
            duration=self.session.progress.protocol.study.duration,
        )
        self._start.call_async(request).add_done_callback(self._on_started)

    def _on_started(self, future: Any) -> None:
        response = future.result()
        if not response.success:
            self._failed(f"it could not be started: {response.message}")
            return
        self._uid, self._step = response.uid, self._watch

    def _watch(self) -> None:
        state = self._state
        if state.uid > self._uid:
            # Of the conductor's own nothing more will be said.
            self._failed("another trial was started in its place")
            return
        if state.uid != self._uid:
            return
        if state.phase == TrialState.PHASE_ARMING:
            self.doing = state.message
        if state.phase < TrialState.PHASE_FINISHED:
            return
        self.doing = "waiting for the bag to be closed"
        self._ended = self._ended or time.monotonic()
        aborted, silent = state.phase == TrialState.PHASE_ABORTED, time.monotonic() - self._ended > _NO_BAG
        if self._recorder.recording or not (self._bag() or (aborted and silent)):
            return
        if aborted:
            self._failed(state.message)
            return
        assert self.trial is not None
        self.session.finish(self.trial, self._bag())
        self._aborts, self._step = 0, self._next

    def _bag(self) -> str:
        """Of the trial that was started; empty before the recorder has named it. Each trial has one of its own."""
        return self._recorder.uri if self._recorder.uri != self._before else ""

    def _failed(self, reason: str) -> None:
        assert self.trial is not None
        self.get_logger().warning(f"{self.trial.name}: {reason}")
        self.session.abort(self.trial, reason, self._bag())
        self._aborts += 1
        self._step = self._next
        if self._aborts >= _PATIENCE:
            self._paused, self._aborts = True, 0
            self.session.note("paused")

    def _idle(self) -> None:
        """Until an answer comes."""

    # -- what comes in -----------------------------------------------------------------------------------------------

    def _on_trial(self, state: TrialState) -> None:
        if state.phase == TrialState.PHASE_RUNNING != self._state.phase:
            self._began = time.monotonic()
        self._state = state

    def _on_recorder(self, state: RecorderState) -> None:
        self._recorder = state

    def _pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._paused = True
        self.session.note("paused")
        response.success, response.message = True, f"the next trial waits for {topics.RESUME_SERVICE}"
        return response

    def _resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._paused
        response.message = "going on" if self._paused else "nothing was waiting"
        if self._paused:
            self._paused = False
            self.session.note("resumed")
        return response

    def _repeat(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._step not in (self._breaking, self._ready):
            response.message = (
                f"a trial is going on or being started; call {topics.ABORT_SERVICE}, and it is done again"
            )
            return response
        trial = self.session.repeat()
        response.success = trial is not None
        response.message = f"{trial.set} {trial.trial} will be done again" if trial else "no trial has ended yet"
        if trial is not None:
            self._step = self._next
        return response
