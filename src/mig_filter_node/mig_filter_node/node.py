"""The shell around the filter: a state and a wrench in, an admitted force, a verdict and its reason out."""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from mig_interfaces.msg import TrialState
from rig_runtime import topics
from rig_runtime.faults import FaultLatch, Lateness, Silence
from rig_runtime.node import RigNode
from rig_runtime.stages import delay_of
from rig_runtime.ticks import Matched, TickMatcher, to_nanoseconds
from rig_runtime.wire import stamp_of
from shared_control.filter import Reason, Verdict
from shared_control.loop import INPUT_FAULTS, FilterOutcome, make_filter
from shared_control.parameters import declarations
from shared_control.scenario import FilterConfig, LoopConfig, Scenario

#: Reasons that tell of something wrong, not of the user's action.
_FAULTS = INPUT_FAULTS | {Reason.NOT_CONVERGED, Reason.NON_FINITE_CRITERION}

_NO_STATE = "no state"

CONFIGURATIONS = (LoopConfig, FilterConfig)


class MigFilterNode(RigNode):
    """`task/state`, `force_sensor/wrench` in; `mig_filter/command`, the verdict's topic, `mig_filter/decision` out.

    Every tick that has a state gets exactly one decision. A wrench that is late by `command_timeout`, in another frame
    or beyond `max_force`, a state that is late by `state_timeout`, and what is not finite gets no force and the reason,
    never a silent pass. With `recovery: explicit` that stays so until `mig_filter/clear_fault` is called or a trial
    begins.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("mig_filter", *CONFIGURATIONS, **kwargs)
        loop = self.parameters.get(LoopConfig)
        self._realtime = loop.pacing == "realtime"
        self._timeout = to_nanoseconds(loop.command_timeout)
        self._state_limit = to_nanoseconds(loop.state_limit) if self._realtime else 0
        self._agent = make_filter(Scenario(loop=loop, filter=self.parameters.get(FilterConfig)))
        self.parameters.on_change(self._reconfigure)
        self._matcher: TickMatcher[bytes, bytes] = TickMatcher()
        self._lateness = Lateness(self._state_limit)
        self._newest_state = -1
        self._ahead = 0
        self._wrench_silence, self._state_silence = Silence(loop.command_timeout), Silence(loop.command_timeout)
        self._latch: FaultLatch[Reason] = FaultLatch(loop.recovery == "explicit")
        self._verdicts = dict.fromkeys(Verdict, 0)
        self._reasons = dict.fromkeys(Reason, 0)
        self._slowest = 0.0
        n, m = self._agent.task.n, self._agent.task.m
        self._state = topics.TASK_STATE.wire(state=n, control=m)
        self._wrench = topics.WRENCH.wire()
        self._command = topics.COMMAND.wire()
        self._decision = topics.DECISION.wire(user_control=m, nominal_control=m, applied_control=m)
        self._send_by_verdict = {
            Verdict.ACCEPTED: self.loop_sender(topics.ACCEPTED),
            Verdict.REJECTED: self.loop_sender(topics.REJECTED),
            Verdict.REPLACED: self.loop_sender(topics.REPLACED),
        }
        self._send_command = self.loop_sender(topics.COMMAND)
        self._send_decision = self.loop_sender(topics.DECISION)
        self.loop_subscription(topics.TASK_STATE, self._on_state, raw=True)
        self.loop_subscription(topics.WRENCH, self._on_wrench, raw=True)
        if self._realtime:
            self.create_timer(self._wrench_silence.period, self._watchdog, clock=self.steady)
        self.serve_clearing(topics.CLEAR_FILTER_SERVICE, self._latch)

    def prepare(self) -> None:
        self._agent.warm_up()

    def arm(self, trial: TrialState) -> None:
        self._agent.reset()
        self._matcher.reset()
        self._lateness.reset()
        self._newest_state, self._ahead = -1, 0
        self._wrench_silence.heard()
        self._state_silence.heard()
        self._latch.clear()
        self._verdicts = dict.fromkeys(Verdict, 0)
        self._reasons = dict.fromkeys(Reason, 0)
        self._slowest = 0.0

    def diagnose(self) -> tuple[bytes, str, dict[str, object]]:
        matcher = self._matcher
        faults = {reason: n for reason, n in self._reasons.items() if reason in _FAULTS and n}
        level = DiagnosticStatus.OK
        if faults or matcher.late or matcher.overflows or matcher.duplicates or self._ahead:
            level = DiagnosticStatus.WARN
        values: dict[str, object] = {"mode": self._agent.mode.name.lower(), "ticks": self.ticks_done}
        values |= {verdict.name.lower(): n for verdict, n in self._verdicts.items()}
        values |= {f"reason {reason.name.lower()}": n for reason, n in faults.items()}
        values |= {"late": matcher.late, "duplicates": matcher.duplicates, "overflows": matcher.overflows}
        values["ahead of time"] = self._ahead
        values["slowest decision [ms]"] = round(1e3 * self._slowest, 3)
        return self.with_loss(level, "judging", values, kept=self._latch.kept, service=topics.CLEAR_FILTER_SERVICE)

    def follow_trial(self, trial: TrialState) -> None:
        super().follow_trial(trial)
        if trial.phase != TrialState.PHASE_RUNNING:
            self._note_loss(None)

    def _reconfigure(self) -> None:
        config = self.parameters.get(FilterConfig)
        self._agent.configure(**{d.name: getattr(config, d.name) for d in declarations(FilterConfig) if d.live})

    def _on_state(self, data: bytes) -> None:
        now, stamp = time.monotonic_ns(), stamp_of(data)
        self._state.check(data)
        self._state_silence.heard()
        self._newest_state = max(self._newest_state, stamp)
        for tick in self._matcher.put_left(stamp, data, now):
            self._decide(tick)
        if self._realtime and self._wrench_silence.silent:
            # Nobody pushes: it would only be later that nothing is admitted.
            self._give_up(now + 1)

    def _on_wrench(self, data: bytes) -> None:
        stamp = stamp_of(data)
        self._wrench.check(data)
        self._wrench_silence.heard()
        if self._realtime and stamp - self._newest_state > self._timeout and self._newest_state >= 0:
            # It may overtake its state on the other topic, but nobody answers a state that is so far from being there.
            self._ahead += 1
            return
        for tick in self._matcher.put_right(stamp, data, time.monotonic_ns()):
            self._decide(tick)

    def _watchdog(self) -> None:
        if not self.ticks_done and not self._matcher.waiting:
            return  # before the first tick nobody is asked to push
        now = time.monotonic_ns()
        self._give_up(now if self._wrench_silence.look() else now - self._timeout)
        if self._state_silence.look() and self.ticks_done and self.trial.phase == TrialState.PHASE_RUNNING:
            # Without a state there is no decision, and no command.
            self._note_loss(_NO_STATE)

    def _give_up(self, received_before: int) -> None:
        for tick in self._matcher.expire(received_before):
            self._decide(tick)

    def _decide(self, tick: Matched[bytes, bytes]) -> None:
        begin = time.monotonic_ns()
        delay = delay_of(tick.stamp) if self._realtime else 0.0
        state, wrench = self._state, self._wrench
        state.load(tick.left)
        kept = self._latch.kept
        fault = self._latch.hold(self._fault(tick))
        force = wrench["wrench.force"]
        if fault is None:
            outcome = self._agent.decide(state["state"], force, state["mode"])
            if outcome.decision.reason in INPUT_FAULTS:
                self._latch.hold(outcome.decision.reason)
        else:
            outcome = self._agent.fallback(fault, force)
        if self._realtime:
            self._note_times(tick, begin, delay)
        self._publish_command(outcome, tick.stamp)
        self._publish_decision(outcome, tick)
        self._verdicts[outcome.decision.verdict] += 1
        self._reasons[outcome.decision.reason] += 1
        self.ticks_done += 1
        lost = outcome.decision.verdict is Verdict.REJECTED and outcome.decision.reason is not Reason.CRITERION
        self._note_loss(outcome.decision.reason if lost else None)
        if self._latch.kept is not kept:
            self.get_logger().error(self.diagnose()[1])

    def _note_loss(self, what: Reason | str | None) -> None:
        kept = self._latch.kept
        if kept is None and self.trial.phase >= TrialState.PHASE_FINISHED:
            what = None  # there is nothing to lose any more
        self.note_loss(what if kept is None else kept)

    def _fault(self, tick: Matched[bytes, bytes]) -> Reason | None:
        """What is wrong with a tick's state or wrench before one looks at their numbers; loads the wrench."""
        late = self._state_limit and self._lateness.late(tick.stamp, tick.left_received)
        if tick.right is None:
            self._wrench["wrench.force"] = 0.0
            return Reason.STALE_STATE if late else Reason.STALE_WRENCH
        if not self._wrench.load(tick.right):
            return Reason.UNKNOWN_FRAME
        if late:
            return Reason.STALE_STATE
        # A wrench that waited for its tick, stamped ahead of time, is no more what the hand does now.
        waited = self._realtime and tick.left_received - tick.right_received > self._timeout
        return Reason.STALE_WRENCH if waited else None

    def _publish_command(self, outcome: FilterOutcome, stamp: int) -> None:
        # The command goes first: it is what the loop waits for.
        command = self._command
        command.stamp = stamp
        command["wrench.force"] = outcome.admitted_force
        self._send_command(command.data)
        command["wrench.force"] = self._wrench["wrench.force"]
        self._send_by_verdict[outcome.decision.verdict](command.data)

    def _publish_decision(self, outcome: FilterOutcome, tick: Matched[bytes, bytes]) -> None:
        decision, message = outcome.decision, self._decision
        message.take_stamp(self._command)
        message["tick"] = self._state["tick"]
        message["mode"] = decision.mode
        message["verdict"] = decision.verdict
        message["reason"] = decision.reason
        message["criterion"] = decision.criterion
        message["threshold"] = decision.threshold
        message["user_control"] = decision.user_control
        message["nominal_control"] = decision.nominal_control
        message["applied_control"] = decision.applied_control
        message["user_force"] = self._wrench["wrench.force"]
        message["admitted_force"] = outcome.admitted_force
        message["added_force"] = outcome.added_force
        self._send_decision(message.data)

    def _note_times(self, tick: Matched[bytes, bytes], begin: int, delay: float) -> None:
        # Wall time differs from run to run, so it stays out of the messages of a lockstep run.
        message, compute_time = self._decision, 1e-9 * (time.monotonic_ns() - begin)
        message["delay"] = delay
        message["compute_time"] = compute_time
        message["state_age"] = 1e-9 * (begin - tick.left_received)
        message["wrench_age"] = 1e-9 * (begin - tick.right_received)
        self._slowest = max(self._slowest, compute_time)
        self.stage.add(delay, compute_time)
