"""The hand of the fault injection: a user who answers each state as told, and sees what becomes of it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.subscription import Subscription

from mig_interfaces.msg import RecorderState, TrialState
from rig_bringup.faults.account import Account, Pushed
from rig_runtime import topics
from rig_runtime.clocks import wall_ahead_of_steady
from rig_runtime.node import RigNode
from rig_runtime.ticks import from_stamp, to_stamp
from shared_control.decision import Mode

#: [N] What a good hand pushes at least.
PUSH = 5.0

#: [s] The longest between two takes of motions.
_OFTEN = 0.1

#: [N] What a wrench holds that must never be admitted.
POISON = 77.0


def good_force(tick: int) -> float:
    """[N] What a good hand pushes in a tick: another force in each of 2048, forth and back to keep the cart still."""
    force = PUSH + tick // 2 % 1024 / 1024
    return force if tick % 2 else -force


class Heard(NamedTuple):
    """A motion: when the robot sent it [s, steady clock], its tick, the force that was admitted for it [N], its stamp.

    The time is the middleware's, of the sender's wall clock: no use where that was stepped.
    """

    at: float
    tick: int
    force: float
    stamp: int


class Hand(RigNode):
    """Takes the place of `user_sim`, by its name.

    `answer(stamp, tick)` is called for each state, with the stamp [ns]; the default is :meth:`push`.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("user_sim", **kwargs)
        self.answer: Callable[[int, int], None] = self.push
        self.newest = -1
        self._motions: list[Heard] = []
        self.states: list[Any] = []
        #: How often each tick was decided, in the present trial.
        self.decided: Counter[int] = Counter()
        self.account = Account()
        #: [s] The longest that a decision took.
        self.slowest = 0.0
        #: Stamps [ns] of all decisions since the present bag was begun.
        self.heard: set[int] = set()
        self.diagnostics: dict[str, tuple[bytes, dict[str, str]]] = {}
        #: What each node last said of itself there.
        self.said: dict[str, str] = {}
        #: By bag, what its recorder last said.
        self.recorders: dict[str, RecorderState] = {}
        self.last_good = 0.0
        self.wrenches = self.loop_publisher(topics.WRENCH)
        self.loop_subscription(topics.TASK_STATE, self._on_state)
        for topic, callback in (
            (topics.COMMAND, self._on_command),
            (topics.DECISION, self._on_decision),
            (topics.RECORDER_STATE, self._on_recorder),
        ):
            self.create_subscription(topic.type, topic.name, callback, topic.qos)
        # No executor serves it: the time of a motion's coming here is late by whatever this process was doing, and the
        # events executor of this rclpy cannot hand over that of its sending.
        topic = topics.END_EFFECTOR
        self._moved = self.create_subscription(topic.type, topic.name, _leave, topic.qos)
        self.create_timer(_OFTEN, self._take_motions, clock=self.steady)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def arm(self, trial: TrialState) -> None:
        self.forget()

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that an executor serves."""
        own = getattr(self, "_moved", None)
        return (each for each in super().subscriptions if each is not own)

    def forget(self) -> None:
        """Look at what comes from now on."""
        self.motions.clear()
        self.states.clear()
        self.decided.clear()
        self.slowest = 0.0

    # -- what it does --------------------------------------------------------------------------------------------

    def push(self, stamp: int, tick: int) -> None:
        """As a good hand does."""
        self.last_good = time.monotonic()
        self.account.pushed[stamp] = Pushed(good_force(tick), self.last_good)
        self.say(stamp, good_force(tick))

    def watch(self, stamp: int, tick: int) -> None:
        """Somebody else pushes."""

    def overhear(self, good: Callable[[float], bool]) -> None:
        """Enter into the account what somebody else pushes: each force [N] that is good."""

        def note(wrench: WrenchStamped) -> None:
            stamp, force = from_stamp(wrench.header.stamp), wrench.wrench.force.x
            if good(force):
                self.last_good = time.monotonic()
                self.account.pushed.setdefault(stamp, Pushed(force, self.last_good))

        self.create_subscription(topics.WRENCH.type, topics.WRENCH.name, note, topics.WRENCH.qos)

    def say(self, stamp: int, force: float, frame: str = topics.SENSOR_FRAME) -> None:
        """One wrench, along x [N]."""
        message = WrenchStamped()
        message.header.stamp, message.header.frame_id = to_stamp(stamp), frame
        message.wrench.force.x = force
        self.wrenches.publish(message)

    # -- what it sees --------------------------------------------------------------------------------------------

    @property
    def motions(self) -> list[Heard]:
        """What the robot has sent up to now, since this was last cleared."""
        self._take_motions()
        return self._motions

    def _take_motions(self) -> None:
        with self._moved.handle:
            take, ahead = self._moved.handle.take_message, wall_ahead_of_steady()
            while (got := take(topics.END_EFFECTOR.type, False)) is not None:
                motion, about = got
                sent = 1e-9 * (about["source_timestamp"] - ahead)
                stamp, force = from_stamp(motion.header.stamp), motion.force.x
                self._motions.append(Heard(min(sent, time.monotonic()), motion.tick, force, stamp))
                self.account.admit(stamp, force)

    @property
    def flowing(self) -> bool:
        """Whether the robot moves under what is pushed or the controller puts in its place, and nothing else."""
        last = self.motions[-10:]
        right = self.account.is_right
        return len(last) == 10 and all(heard.force and right(heard.stamp, heard.force) for heard in last)

    @property
    def still(self) -> bool:
        """Whether the robot moves under no force, and has for a while."""
        last = self.motions[-10:]
        return len(last) == 10 and not any(heard.force for heard in last)

    @property
    def zeroed(self) -> Heard:
        """The first motion without force after which there was none with a force."""
        moved = self.motions
        last = max((k for k, heard in enumerate(moved[:-1]) if heard.force), default=-1)
        return moved[last + 1]

    @property
    def first_still(self) -> float:
        """When that was [s, steady clock]."""
        return self.zeroed.at

    def coasting(self, since: float) -> float | None:
        """When the task published the first state that it had come to under no force, for want of a motion.

        Of those that it published after a time; None if there is none [s, steady clock].
        """
        for state in self.states:
            if state.held and not any(state.control):
                due = 1e-9 * (from_stamp(state.header.stamp) - wall_ahead_of_steady())
                at = due + float(state.delay + state.compute_time)
                if at > since:
                    return at
        return None

    def judged(self, mode: str, threshold: float) -> bool:
        """Whether the newest decision was made in this mode and with this threshold."""
        decided = next(reversed(self.account.decided.values()), None)
        return decided is not None and decided.mode is Mode[mode.upper()] and decided.threshold == threshold

    def warned(self, node: str, key: str) -> int:
        """A count in a node's diagnostics."""
        return int(self.diagnostics.get(node, (b"", {}))[1].get(key, 0))

    def _on_state(self, state: Any) -> None:
        tick = state.tick
        self.newest = tick
        self.states.append(state)
        self.ticks_done += 1
        self.answer(from_stamp(state.header.stamp), tick)

    def _on_command(self, command: WrenchStamped) -> None:
        self.account.admit(from_stamp(command.header.stamp), command.wrench.force.x)

    def _on_decision(self, decision: Any) -> None:
        self.decided[decision.tick] += 1
        stamp = from_stamp(decision.header.stamp)
        self.heard.add(stamp)
        self.account.decide(stamp, decision)
        self.slowest = max(self.slowest, decision.compute_time)

    def _on_recorder(self, state: RecorderState) -> None:
        self.recorders[state.uri] = state

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            name = status.name.rpartition("/")[2]
            self.diagnostics[name] = (status.level, {pair.key: pair.value for pair in status.values})
            self.said[name] = status.message


def _leave(_: Any) -> None:
    """No executor calls this."""
