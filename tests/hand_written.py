"""A bag of a trial that was written by hand: what a report says can be told from what stands here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message

import rig_bag
from mig_interfaces.msg import EndEffectorState, FilterDecision, TaskState, TrialState

SAMPLE = 10_000_000


def write(path: Path, ticks: int, pacing: int = TrialState.PACING_REALTIME, **state: Any) -> Path:
    """A trial of the cart-pendulum that stands upright from tick 100 on; every fourth action is rejected."""
    trial = TrialState(phase=TrialState.PHASE_FINISHED, message="ran to its end", task="cart_pendulum", pacing=pacing)
    trial.state_names = ["theta", "theta_dot", "x_c", "x_c_dot"]
    trial.state_units = ["rad", "rad/s", "m", "m/s"]
    trial.control_names, trial.control_units = ["u"], ["m/s^2"]
    trial.sample_time.nanosec = SAMPLE
    trial.ticks_planned = trial.ticks_published = ticks
    trial.scenario = "by <hand>"
    for name, value in state.items():
        setattr(trial, name, value)
    with rig_bag.BagWriter(path) as bag:
        channels = {
            name: bag.add_topic(f"/rig/{name}", f"mig_interfaces/msg/{kind}")
            for name, kind in (
                ("task/state", "TaskState"),
                ("mig_filter/decision", "FilterDecision"),
                ("admittance/end_effector", "EndEffectorState"),
                ("trial/state", "TrialState"),
            )
        }
        for tick in range(ticks):
            theta = 3.0 if tick < 100 else 0.1
            state = TaskState(tick=tick, time=0.01 * tick, state=[theta, 0.0, 0.5, 0.0], control=[1.0])
            state.in_success_region = tick >= 100
            rejected = tick % 4 == 0
            decision = FilterDecision(tick=tick, mode=FilterDecision.MODE_TRAINING, compute_time=1e-5, state_age=2e-5)
            decision.verdict = FilterDecision.VERDICT_REJECTED if rejected else FilterDecision.VERDICT_ACCEPTED
            decision.criterion = 1.0 if rejected else -1.0
            decision.user_control, decision.applied_control = [2.0], [0.0 if rejected else 2.0]
            decision.nominal_control = [0.0]
            decision.user_force.x = 4.0
            motion = EndEffectorState(tick=tick)
            if pacing == TrialState.PACING_REALTIME:
                # [s] after t_k: the state is out at 30e-6, judged from 70e-6 on, the motion 200e-6 and back at 300e-6.
                state.delay, state.compute_time, state.motion_age = 2e-5, 1e-5, 9.72e-3
                decision.delay, decision.wrench_age = 7e-5, 0.0
                motion.delay, motion.compute_time = 1.5e-4, 5e-5
            messages = {"task/state": state, "mig_filter/decision": decision, "admittance/end_effector": motion}
            for name, message in messages.items():
                bag.write(channels[name], serialize_message(message), tick * SAMPLE, tick * SAMPLE)
        bag.write(channels["trial/state"], serialize_message(trial), ticks * SAMPLE, ticks * SAMPLE)
    return path
