"""The shell around the task, and the pacemaker of the loop: motion in, state out, one tick after the other."""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from mig_interfaces.msg import TaskState, TrialState
from mig_interfaces.srv import AbortTrial, StartTrial
from rig_runtime import topics
from rig_runtime.claim import Claim, ClaimError
from rig_runtime.node import RigNode
from rig_runtime.pacing import Advance, Pacemaker
from rig_runtime.stages import delay_of
from rig_runtime.surroundings import surroundings
from rig_runtime.ticks import LOCKSTEP_EPOCH, NANOSECONDS, TickClock, from_stamp, to_nanoseconds, to_stamp
from rig_runtime.wire import WireMessage
from shared_control.loop import Motion, make_plant
from shared_control.parameters import ParameterError
from shared_control.scenario import LoopConfig, Scenario, TaskConfig
from task_sim_node.parameters import PacemakerConfig
from task_sim_node.readiness import RECORDER, Readiness
from task_sim_node.view import View

CONFIGURATIONS = (LoopConfig, TaskConfig, PacemakerConfig)

#: [ticks] Most that are published in one go after a stall of the machine: what is beyond waits for the next period, so
#: that readers keep up with a writer that keeps a bounded history.
_BURST = topics.DEPTH // 10

#: A constant of a message class is a property, which is looked up each time.
_RUNNING = TrialState.PHASE_RUNNING


class TaskSimNode(RigNode):
    """`admittance/end_effector` in, `task/state` out; owns `trial/state` and serves `trial/start`, `abort`, `reset`."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("task_sim", *CONFIGURATIONS, follows_trial=False, **kwargs)
        try:
            self._claim = Claim(self.context.get_domain_id(), self.get_namespace())
        except ClaimError as error:
            super().destroy_node()
            raise ParameterError(f"task_sim: {error}") from None
        self._loop = self.parameters.get(LoopConfig)
        self._config = self.parameters.get(PacemakerConfig)
        self._agent = make_plant(Scenario(loop=self._loop, task=self.parameters.get(TaskConfig)), self._loop.seed)
        self._records = RECORDER in self._config.required_nodes
        self._sample = to_nanoseconds(self._loop.sample_time)
        self._pacemaker = Pacemaker(
            realtime=self._loop.pacing == "realtime",
            sample=self._sample,
            command_timeout=to_nanoseconds(self._loop.command_timeout),
            recorder_window=topics.RECORDER_WINDOW if self._records else 0,
        )
        self._planned = 0
        self._progress = 0.0
        self._started = self._ended = 0.0
        #: The motion that the task goes on with, and where the next one is received.
        self._motion, self._heard = topics.END_EFFECTOR.wire(), topics.END_EFFECTOR.wire()
        self._motion_received = 0
        task = self._agent.task
        self._message = topics.TASK_STATE.wire(state=task.n, control=task.m)
        self._timer: Timer | None = None
        rate = self._config.view_rate
        # In lockstep nobody can look that fast, and what is drawn would slow it down.
        self._view = View(self, task) if rate > 0.0 and self._pacemaker.realtime else None
        self._view_ticks = max(round(1.0 / (rate * self._loop.sample_time)), 1) if rate > 0.0 else 1
        self._send = self.loop_sender(topics.TASK_STATE)
        self._trial_publisher = self.create_publisher(
            topics.TRIAL_STATE.type, topics.TRIAL_STATE.name, topics.TRIAL_STATE.qos
        )
        self.loop_subscription(topics.END_EFFECTOR, self._on_motion, raw=True)
        self._readiness = Readiness(self, self._config.required_nodes, self._on_ready_change)
        self.create_subscription(
            topics.RECORDER_STATE.type, topics.RECORDER_STATE.name, self._on_recorder, topics.RECORDER_STATE.qos
        )
        self.create_service(StartTrial, topics.START_SERVICE, self._serve_start)
        self.create_service(AbortTrial, topics.ABORT_SERVICE, self._serve_abort)
        self.create_service(Trigger, topics.RESET_SERVICE, self._serve_reset)
        self.create_timer(0.2, self._watch, clock=self.steady)

    # -- life ----------------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        self._agent.warm_up()
        task = self._agent.task
        realtime = self._pacemaker.realtime
        self.trial = TrialState(
            # One that is started again in the middle of a trial must not repeat the numbers that others still hold,
            # whatever has become of the wall clock meanwhile.
            uid=time.monotonic_ns() // 1000 if realtime else 0,
            scenario=self._config.scenario,
            configuration_hash=self._config.configuration_hash,
            pacing=TrialState.PACING_REALTIME if realtime else TrialState.PACING_LOCKSTEP,
            task=task.name,
            state_names=list(task.state_names),
            state_units=list(task.state_units),
            control_names=list(task.control_names),
            control_units=list(task.control_units),
        )
        self.trial.sample_time.sec, self.trial.sample_time.nanosec = divmod(self._sample, NANOSECONDS)
        config = self._config
        if config.autostart:
            self._begin(
                StartTrial.Request(subject=config.subject, group=config.group, set=config.set, trial=config.trial)
            )
        else:
            self._publish_trial(TrialState.PHASE_IDLE, "trial/start begins a trial")

    def destroy_node(self) -> None:
        self._claim.close()
        super().destroy_node()

    def finish(self) -> None:
        if self._in_trial:
            self._end(TrialState.PHASE_ABORTED, "the pacemaker was told to end")
            # The recorder must learn of it before this process is gone.
            self._trial_publisher.wait_for_all_acked(Duration(seconds=1.0))

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        pacemaker, trial = self._pacemaker, self.trial
        level = DiagnosticStatus.WARN if pacemaker.missed else DiagnosticStatus.OK
        values: dict[str, object] = {
            "phase": trial.phase,
            "uid": trial.uid,
            "trial time [s]": round(pacemaker.tick * self._loop.sample_time, 3),
            "ticks": self.ticks_done,
            "ticks planned": self._planned,
            "missed deadlines": pacemaker.missed,
            "late motions": pacemaker.late,
            "outcome": self._agent.outcome,
            "wall time [s]": round((self._ended or time.monotonic()) - self._started, 4),
        }
        return self.with_loss(level, trial.message or "pacing", values, consequence="coasting under no force")

    @property
    def _in_trial(self) -> bool:
        return self.trial.phase in (TrialState.PHASE_ARMING, TrialState.PHASE_RUNNING)

    # -- trials --------------------------------------------------------------------------------------------------

    def _begin(self, asked: StartTrial.Request) -> None:
        trial = self.trial
        trial.uid += 1
        trial.subject, trial.group, trial.set = asked.subject, asked.group, asked.set
        trial.trial, trial.attempt = asked.trial, asked.attempt
        trial.seed = asked.seed or self._loop.seed
        self._planned = round((asked.duration or self._loop.duration) / self._loop.sample_time)
        trial.ticks_planned = self._planned
        trial.ticks_published = trial.missed_deadlines = 0
        trial.outcome = TaskState.OUTCOME_OPEN
        trial.epoch = to_stamp(0 if self._pacemaker.realtime else LOCKSTEP_EPOCH)
        self._progress = time.monotonic()
        self._publish_trial(TrialState.PHASE_ARMING, "waiting for every endpoint to be matched")
        self.take_trial(trial)
        self._readiness.begin(trial.uid)

    def arm(self, trial: TrialState) -> None:
        self._agent.reset(trial.seed)
        self._pacemaker.start(0)
        self._motion.clear()

    def _on_ready_change(self) -> None:
        if self.trial.phase == TrialState.PHASE_ARMING and not self._readiness.missing(self.trial.uid):
            self._start()

    def _start(self) -> None:
        realtime = self._pacemaker.realtime
        # One moment on both clocks: that of the stamps, and the steady one that paces.
        begin = time.monotonic_ns()
        self.clock = TickClock(time.time_ns() if realtime else LOCKSTEP_EPOCH, self._sample)
        self._pacemaker.start(begin)
        if realtime:
            # Made after the start, so that it never fires just before a tick is due and loses a whole period.
            self._timer = self.create_timer(self._loop.sample_time, self._tick, clock=self.steady)
        self._started, self._ended = 1e-9 * begin, 0.0
        self.trial.epoch = to_stamp(self.clock.epoch)
        self._publish_trial(TrialState.PHASE_RUNNING, "")
        self._publish_state(Advance.MOTION, begin)

    def _end(self, phase: int, message: str) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        self._ended = time.monotonic()
        self.trial.missed_deadlines = self._pacemaker.missed
        self.trial.ticks_published = self.ticks_done
        self.trial.outcome = self._agent.outcome
        # Before the recorder closes: the last word on how the trial went belongs into the bag.
        if not self.note_loss(None):
            self.publish_diagnostics()
        self._publish_trial(phase, message)

    def _publish_trial(self, phase: int, message: str) -> None:
        trial = self.trial
        trial.phase, trial.message = phase, message
        trial.surroundings = [f"{key}={value}" for key, value in surroundings().items()]
        if self.clock is not None and phase > TrialState.PHASE_ARMING:
            trial.header.stamp = to_stamp(self.clock.stamp(max(self.ticks_done - 1, 0)))
        else:
            trial.header.stamp = trial.epoch
        self._trial_publisher.publish(trial)

    # -- ticks ---------------------------------------------------------------------------------------------------

    def _on_motion(self, data: bytes) -> None:
        received, heard = time.monotonic_ns(), self._heard
        heard.load(data)
        tick = heard["tick"]
        if self.trial.phase != _RUNNING or self.tick_of(heard.stamp) != tick:
            self._pacemaker.late += 1
        elif self._pacemaker.take(tick):
            self._motion, self._heard = heard, self._motion
            self._motion_received = received
            if not self._pacemaker.realtime:
                self._tick()

    def _on_recorder(self, state: Any) -> None:
        if self.clock is None or self.trial.phase != TrialState.PHASE_RUNNING:
            return
        stamp = from_stamp(state.header.stamp)
        if stamp >= self.clock.epoch:
            self._pacemaker.recorded((stamp - self.clock.epoch) // self.clock.sample)
            if not self._pacemaker.realtime:
                self._tick()

    def _tick(self) -> None:
        for _ in range(_BURST):
            if self.trial.phase != _RUNNING:
                return
            begin = time.monotonic_ns()
            advance = self._pacemaker.advance(begin)
            if advance is None:
                return
            if advance is Advance.COAST:
                self._agent.coast()
            else:
                self._agent.step(_motion(self._motion), self._motion["force"])
            if self._pacemaker.tick >= self._planned:
                self._end(TrialState.PHASE_FINISHED, "ran to its end")
            else:
                self._publish_state(advance, begin)
                self.note_loss("no motion" if advance is Advance.COAST else None)

    def _publish_state(self, advance: Advance, begin: int) -> None:
        assert self.clock is not None
        agent, tick, message = self._agent, self._pacemaker.tick, self._message
        message.stamp = self.clock.stamp(tick)
        message["tick"] = tick
        message["time"] = tick * self._loop.sample_time
        message["mode"] = agent.task_mode
        message["state"] = agent.state
        message["control"] = agent.control
        message["in_success_region"] = agent.in_success_region
        message["outcome"] = agent.outcome
        message["held"] = advance is not Advance.MOTION
        message["missed_deadlines"] = self._pacemaker.missed
        if self._pacemaker.realtime:
            # Wall time differs from run to run, so it stays out of the messages of a lockstep run.
            compute_time = 1e-9 * (time.monotonic_ns() - begin)
            delay = delay_of(message.stamp) - compute_time
            on_motion = tick > 0 and advance is Advance.MOTION
            message["delay"], message["compute_time"] = delay, compute_time
            message["motion_age"] = 1e-9 * (begin - self._motion_received) if on_motion else 0.0
            self.stage.add(delay, compute_time)
        self._progress = 1e-9 * begin
        self.ticks_done = tick + 1
        self._send(message.data)
        if self._view is not None and tick % self._view_ticks == 0:
            self._view.publish(agent.state, message.stamp)

    # -- watching ------------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        standing = time.monotonic() - self._progress
        if self.trial.phase == TrialState.PHASE_ARMING:
            self._on_ready_change()
            if self.trial.phase == TrialState.PHASE_ARMING:
                self._say_what_is_missing(standing)
        elif self.trial.phase != TrialState.PHASE_RUNNING or self._pacemaker.realtime:
            return
        elif standing > self._config.lockstep_timeout:
            where = f"at tick {self._pacemaker.tick}: {self._culprit()}"
            self._abort(f"lockstep stood still for {standing:.0f} s {where}")

    def _say_what_is_missing(self, standing: float) -> None:
        missing = "; ".join(self._readiness.missing(self.trial.uid))
        if self._config.ready_timeout and standing > self._config.ready_timeout:
            self._abort(f"not ready after {standing:.0f} s: {missing}")
        elif missing != self.trial.message and standing > 2.0:
            self._publish_trial(TrialState.PHASE_ARMING, missing)
            self.get_logger().info(f"waiting: {missing}")

    def _culprit(self) -> str:
        if self._pacemaker.waits_for() == "recorder":
            return f"{self._readiness.full_name(RECORDER)} is more than {topics.RECORDER_WINDOW} ticks behind"
        return self._readiness.slowest(self._pacemaker.tick)

    def _abort(self, reason: str) -> None:
        self.get_logger().error(reason)
        self._end(TrialState.PHASE_ABORTED, reason)

    # -- services ------------------------------------------------------------------------------------------------

    def _serve_start(self, request: StartTrial.Request, response: StartTrial.Response) -> StartTrial.Response:
        if self._in_trial:
            response.message = f"trial {self.trial.uid} is still going on; call {topics.ABORT_SERVICE} first"
        elif not 0.0 <= request.duration <= 86400.0:
            response.message = f"duration = {request.duration} is not allowed; it must be from 0 to 86400 [s]"
        else:
            self._begin(request)
            response.success, response.uid = True, self.trial.uid
            response.message = f"trial {self.trial.uid} is being armed"
        return response

    def _serve_abort(self, request: AbortTrial.Request, response: AbortTrial.Response) -> AbortTrial.Response:
        response.success = self._in_trial
        if self._in_trial:
            self._end(TrialState.PHASE_ABORTED, request.reason or "aborted on request")
            response.message = f"trial {self.trial.uid} was aborted at tick {self._pacemaker.tick}"
        else:
            response.message = "no trial is going on"
        return response

    def _serve_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._in_trial:
            self._end(TrialState.PHASE_ABORTED, "reset on request")
        self._agent.reset(self._loop.seed)
        self._publish_trial(TrialState.PHASE_IDLE, "reset; trial/start begins a trial")
        response.success, response.message = True, "idle, in the initial state"
        return response


def _motion(message: WireMessage) -> Motion:
    return Motion(message["position"], message["velocity"], message["acceleration"], message["reference_velocity"])
