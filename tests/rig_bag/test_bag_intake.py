"""Messages that are taken many at a time come in the order and with the times of their reception."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from recorded_loop import retime
from std_msgs.msg import String

from rig_bag.errors import BagError
from rig_bag.intake import TAKE_PERIOD_LOCKSTEP, TAKE_PERIOD_REALTIME, Intake, Taken, take_period
from rig_bag.selection import Selection

TOPICS = ("/a", "/b", "/c")
QOS = QoSProfile(depth=500)


class Taker:
    """An intake of three topics, its node, and somebody who publishes on them."""

    def __init__(self, graph: Any) -> None:
        self.node = Node("taker", context=graph.context)
        self.publishers = [graph.node.create_publisher(String, topic, QOS) for topic in TOPICS]
        self.ahead = 0
        #: [ns] steady times at which the messages of the last take were sent.
        self.sent: list[int] = []
        self.declared: list[str] = []
        self.intake = Intake(
            self.node,
            TOPICS[:2],
            Selection(regex="^/c$"),
            {},
            declare=self._declare,
            lost=lambda topic, count: pytest.fail(f"{topic} lost {count}"),
            wall=lambda: time.time_ns() + self.ahead,
        )
        graph.until(lambda: self.intake.look() and all(p.get_subscription_count() for p in self.publishers))
        assert self.intake.matched() == dict.fromkeys(TOPICS, 1)

    def _declare(self, topic: str, _: Any) -> None:
        self.declared.append(topic)

    def send(self, numbers: range) -> None:
        for number in numbers:
            self.publishers[number * number % 3].publish(String(data=f"{number}"))

    def take(self, count: int) -> list[tuple[int, str, int]]:
        """So many messages, all of which have been received by now."""
        limit = time.monotonic() + 10.0
        found: list[Taken] = []
        while len(found) < count and time.monotonic() < limit:
            found += self.intake.take()
        assert len(found) == count
        self.sent = [when - under_way for when, *_, under_way in found]
        return [(when, topic, int(deserialize_message(data, String).data)) for when, topic, data, _ in found]


@pytest.fixture
def taker(single_graph: Any) -> Iterator[Taker]:
    made = Taker(single_graph)
    yield made
    made.node.destroy_node()


def test_they_come_in_the_order_of_reception_whatever_their_topic(taker: Taker) -> None:
    assert sorted(taker.declared) == list(TOPICS)
    begin = time.monotonic_ns()
    taker.send(range(100))
    assert all(publisher.wait_for_all_acked(Duration(seconds=10)) for publisher in taker.publishers)
    end = time.monotonic_ns()
    found = taker.take(100)
    assert [number for _, _, number in found] == list(range(100))
    assert [topic for _, topic, _ in found] == [TOPICS[number * number % 3] for number in range(100)]
    times = [when for when, _, _ in found]
    assert times == sorted(times)
    # Of their reception, which is not when they were taken; two clocks are read one after the other.
    assert begin - 1_000_000 < times[0]
    assert times[-1] < end + 1_000_000
    assert len(set(times)) > 50
    # And each with the time at which it was sent.
    assert taker.sent == sorted(taker.sent)
    assert begin - 1_000_000 < taker.sent[0]
    assert all(sent <= when for sent, when in zip(taker.sent, times, strict=True))


def test_ten_thousand_messages_a_second_on_one_topic_wait_for_the_next_take(taker: Taker) -> None:
    numbers = range(round(10_000 * TAKE_PERIOD_REALTIME))
    for number in numbers:
        taker.publishers[0].publish(String(data=f"{number}"))
    assert taker.publishers[0].wait_for_all_acked(Duration(seconds=10))
    assert [number for _, _, number in taker.take(len(numbers))] == list(numbers)


@pytest.mark.parametrize("hours", [-5, 5])
def test_a_clock_that_is_set_moves_no_message_beyond_two_takes(
    taker: Taker, hours: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    taker.take(0)
    begin = time.monotonic_ns()
    step = hours * 3_600_000_000_000
    taker.send(range(30))
    assert all(publisher.wait_for_all_acked(Duration(seconds=10)) for publisher in taker.publishers)
    # What was sent before the step is told in the old time, and the rest in the new one.
    stepped = time.time_ns()
    retime(monkeypatch, TOPICS, lambda told: told + step * (told > stepped))
    taker.ahead = step
    taker.send(range(30, 60))
    found = taker.take(60)
    times = [when for when, _, _ in found]
    assert times == sorted(times)
    assert all(begin - 1_000_000_000 < when <= time.monotonic_ns() for when in [*times, *taker.sent])
    for topic in TOPICS:
        numbers = [number for _, name, number in found if name == topic]
        assert numbers == sorted(numbers)


def test_a_middleware_without_times_gives_that_of_the_take(taker: Taker, monkeypatch: pytest.MonkeyPatch) -> None:
    retime(monkeypatch, TOPICS, lambda _: 0)
    taker.send(range(30))
    before = time.monotonic_ns()
    found = taker.take(30)
    assert {topic for _, topic, _ in found} == {"/a", "/b"}
    assert all(before <= when <= time.monotonic_ns() for when, _, _ in found)
    assert taker.sent == [when for when, _, _ in found]


def test_what_cannot_be_declared_is_left_out(single_graph: Any, capfd: pytest.CaptureFixture[str]) -> None:
    def refuse(topic: str, _: Any) -> None:
        raise BagError("there is no room")

    node = Node("taker", context=single_graph.context)
    single_graph.node.create_publisher(String, "/a", QOS)
    intake = Intake(node, ["/a"], Selection(), {}, declare=refuse, lost=lambda *_: None)
    single_graph.until(intake.look)
    assert intake.matched() == {"/a": 0}
    assert "/a is not recorded: there is no room" in capfd.readouterr().err
    node.destroy_node()


def test_what_is_taken_at_once_is_little_of_a_tick() -> None:
    assert take_period(0.01) == TAKE_PERIOD_REALTIME
    # At 1 kHz three ticks at once; and whatever a trial says of its ticks, the recorder does not turn without a pause.
    assert take_period(0.001) == pytest.approx(0.003, abs=0.0005)
    assert take_period(0.0) == take_period(-1.0e-9) == take_period(1e-9) == take_period(1e-4) == TAKE_PERIOD_LOCKSTEP
