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
from std_msgs.msg import String

from rig_bag.errors import BagError
from rig_bag.intake import Intake, Taken
from rig_bag.selection import Selection

TOPICS = ("/a", "/b", "/c")
QOS = QoSProfile(depth=500)


class Taker:
    """An intake of three topics, its node, and somebody who publishes on them."""

    def __init__(self, graph: Any) -> None:
        self.node = Node("taker", context=graph.context)
        self.publishers = [graph.node.create_publisher(String, topic, QOS) for topic in TOPICS]
        self.ahead = 0
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
        self.sent = [sent for *_, sent in found]
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


def test_each_comes_with_the_time_at_which_it_was_sent(taker: Taker, single_graph: Any) -> None:
    told: list[int] = []

    def note(_: String, about: Any) -> None:
        told.append(about["source_timestamp"])

    single_graph.node.create_subscription(String, "/b", note, QOS)
    single_graph.until(lambda: taker.publishers[1].get_subscription_count() == 2)
    for number in range(5):
        taker.publishers[1].publish(String(data=f"{number}"))
    taker.take(5)
    single_graph.until(lambda: len(told) == 5)
    assert taker.sent == told
    assert told[0] > 1_600_000_000_000_000_000


@pytest.mark.parametrize("hours", [-5, 5])
def test_a_clock_that_is_set_moves_no_message_beyond_two_takes(taker: Taker, hours: int) -> None:
    taker.take(0)
    begin = time.monotonic_ns()
    taker.send(range(30))
    taker.ahead = hours * 3_600_000_000_000
    found = taker.take(30)
    assert all(begin - 1_000_000_000 < when <= time.monotonic_ns() for when, _, _ in found)
    for topic in TOPICS:
        numbers = [number for _, name, number in found if name == topic]
        assert numbers == sorted(numbers)
    times = [when for when, _, _ in found]
    assert times == sorted(times)


def test_a_middleware_without_times_gives_that_of_the_take(taker: Taker, monkeypatch: pytest.MonkeyPatch) -> None:
    class Timeless:
        def __init__(self, handle: Any) -> None:
            self._handle = handle

        def __enter__(self) -> None:
            self._handle.__enter__()

        def __exit__(self, *given: object) -> None:
            self._handle.__exit__(*given)

        def take_message(self, kind: Any, raw: bool) -> Any:
            got = self._handle.take_message(kind, raw)
            return got and (got[0], {**got[1], "received_timestamp": 0})

    for tap in taker.intake._taps.values():
        monkeypatch.setattr(tap, "subscription", type("", (), {"handle": Timeless(tap.subscription.handle)})())
    taker.send(range(30))
    before = time.monotonic_ns()
    found = taker.take(30)
    assert {topic for _, topic, _ in found} == {"/a", "/b"}
    assert all(before <= when <= time.monotonic_ns() for when, _, _ in found)


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
