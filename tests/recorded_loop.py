"""A recorder in a test's graph, and the loop that it records: the topics and the trial, without the loop's nodes."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from mig_interfaces.msg import EndEffectorState, FilterDecision, RecorderState, TaskState, TrialState
from rig_bag.recorder import RecorderNode

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EPOCH = 1_000_000_000_000
STEP = 10_000_000
LOOP = {
    "task/state": TaskState,
    "force_sensor/wrench": WrenchStamped,
    "mig_filter/command": WrenchStamped,
    "mig_filter/decision": FilterDecision,
    "admittance/end_effector": EndEffectorState,
    "mig_filter/accepted": WrenchStamped,
}


def overrides(**values: Any) -> list[Parameter]:
    """Parameters of a node that is made in the test."""
    return [Parameter(name, value=value) for name, value in values.items()]


def make_recorder(graph: Any, **values: Any) -> Any:
    """A recorder with these parameters, served with the graph."""
    return graph.add(RecorderNode(namespace="/rig", context=graph.context, parameter_overrides=overrides(**values)))


def matched(recorder: RecorderNode, *publishers: Any) -> Callable[[], bool]:
    """Whether both sides have found each other: a message sent before that may be lost."""
    return lambda: all(
        publisher.get_subscription_count() and recorder.matched().get(publisher.topic_name) for publisher in publishers
    )


def written(recorder: Any) -> int:
    """How many messages are in the bag that is open."""
    return 0 if recorder.recording is None else recorder.recording.writer.messages


def retime(monkeypatch: pytest.MonkeyPatch, topics: Collection[str], change: Callable[[int], int]) -> None:
    """Change the times, by the system's clock, that the middleware tells of each message of these topics."""
    handle_of = Subscription.handle.fget

    def handle(subscription: Subscription) -> Any:
        real = handle_of(subscription)
        return _Retimed(real, change) if subscription.topic in topics else real

    monkeypatch.setattr(Subscription, "handle", property(handle))


class _Retimed:
    """A subscription's handle."""

    def __init__(self, handle: Any, change: Callable[[int], int]) -> None:
        self._handle, self._change = handle, change

    def __enter__(self) -> None:
        self._handle.__enter__()

    def __exit__(self, *given: object) -> None:
        self._handle.__exit__(*given)

    def take_message(self, kind: Any, raw: bool) -> Any:
        got = self._handle.take_message(kind, raw)
        times = ("source_timestamp", "received_timestamp")
        return got and (got[0], {**got[1], **{name: self._change(got[1][name]) for name in times}})


class Loop:
    """The rig's per-tick topics, a trial's state, and a listener of the recorder's."""

    def __init__(self, graph: Any, trial_state: Callable[..., TrialState]) -> None:
        self._trial_state = trial_state
        self.publishers = {
            name: graph.node.create_publisher(kind, name, QoSProfile(depth=200)) for name, kind in LOOP.items()
        }
        self.trial = graph.node.create_publisher(TrialState, "trial/state", LATCHED)
        self.states: list[RecorderState] = []
        every = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        graph.node.create_subscription(RecorderState, "recorder/state", self.states.append, every)

    def announce(self, phase: int, ticks: int = 0, uid: int = 1) -> None:
        """Publish the state of a trial."""
        self.trial.publish(self._trial_state(phase, ticks, uid))

    def tick(self, tick: int, *left_out: str) -> None:
        """Publish one message of this tick on each topic but these."""
        for name, publisher in self.publishers.items():
            if name not in left_out:
                message = LOOP[name]()
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(EPOCH + tick * STEP, 1_000_000_000)
                publisher.publish(message)
