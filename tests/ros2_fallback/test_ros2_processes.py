"""The command as a process: what runs on until it is stopped, and how it stops."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

pytestmark = pytest.mark.usefixtures("rig")

Start = Callable[..., Any]


def test_topic_hz(ros2_process: Start) -> None:
    process = ros2_process("topic", "hz", "/rig/wrench")
    lines = process.line() + process.line()
    process.send(signal.SIGINT)
    code, _, err = process.finish()
    assert re.fullmatch(
        r"average rate: \d+\.\d{3}\n"
        r"\tmin: \d+\.\d{3}s max: \d+\.\d{3}s std dev: \d+\.\d{5}s window: \d+\n",
        lines,
    )
    assert (code, err) == (signal.SIGINT, "")


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_echo_ends_cleanly(signum: signal.Signals, ros2_process: Start) -> None:
    process = ros2_process("topic", "echo", "--no-lost-messages", "/rig/wrench")
    assert process.line() == "header:\n"
    process.send(signum)
    code, _, err = process.finish()
    assert (code, err) == (signum, "")


def test_echo_gets_what_a_publisher_that_comes_last_has_kept(rig: Any, ros2_process: Start) -> None:
    # Somebody listens already, so the topic's type is known before anybody is seen to publish.
    listener = rig.node.create_subscription(String, "late", lambda _message: None, 10)
    process = ros2_process("topic", "echo", "--once", "/rig/late")
    assert rig.node.wait_for_node(f"/_ros2cli_{process.pid}", timeout=60.0)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = rig.node.create_publisher(String, "late", latched)
    publisher.publish(String(data="kept"))
    assert process.finish() == (0, "data: kept\n---\n", "")
    rig.node.destroy_publisher(publisher)
    rig.node.destroy_subscription(listener)


def test_waiting_ends_cleanly(ros2_process: Start) -> None:
    process = ros2_process("topic", "bw", "/nothing", "--spin-time", "0.1")
    assert process.line() == "WARNING: topic [/nothing] does not appear to be published yet\n"
    process.send(signal.SIGINT)
    assert process.finish() == (signal.SIGINT, "", "")


def test_reader_that_goes_away_ends_it_quietly(ros2_process: Start) -> None:
    process = ros2_process("topic", "echo", "--no-lost-messages", "/rig/wrench")
    process.line()
    process.stop_reading()
    assert process.finish() == (0, "", "")
