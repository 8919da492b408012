"""How long the graph is looked at: longer where the machine is busy and where something is known to be missing."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context

from ros2_fallback.graph import PAUSES, QUIET, QUIET_MOST, Graph

pytestmark = pytest.mark.usefixtures("rig")

Crowd = Callable[[float], None]


@pytest.fixture
def crowd(monkeypatch: pytest.MonkeyPatch) -> Crowd:
    """How many the machine is said to have for each processor."""

    def said(each: float) -> None:
        load = each * len(os.sched_getaffinity(0))
        monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0))

    return said


@pytest.fixture
def make(environment: dict[str, str]) -> Iterator[Callable[..., Any]]:
    """Makes nodes, each a participant of its own."""
    made: list[Any] = []

    def one(name: str, **options: Any) -> Any:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
        made.append(rclpy.create_node(name, namespace="rig", context=context, **options))
        return made[-1]

    yield one
    for node in made:
        node.destroy_node()
        node.context.try_shutdown()


def test_quiet_follows_from_what_is_seen(crowd: Crowd, make: Callable[..., Any]) -> None:
    with Graph(argparse.Namespace()) as graph:
        assert graph.discover(lambda: "/rig/demo" in graph.node_names())
        crowd(0.0)
        assert graph.spin_until(lambda: graph._quiet(QUIET, 0.1) == QUIET, 60.0)
        assert graph._quiet(QUIET, 0.6) == PAUSES * 0.6
        crowd(3.0)
        assert graph._quiet(QUIET, 0.1) == 3.0 * QUIET
        crowd(50.0)
        assert graph._quiet(QUIET, 0.1) == QUIET_MOST
        assert graph._quiet(0.0, 0.1) == 0.0
        # A node without anything of its own: what it has is still to come.
        bare = make("bare", enable_rosout=False, start_parameter_services=False)
        for publisher in list(bare.publishers):
            bare.destroy_publisher(publisher)
        crowd(0.0)
        assert graph.spin_until(lambda: "/rig/bare" in graph.node_names() and not graph._whole(), 60.0)
        assert graph._quiet(QUIET, 0.1) == QUIET_MOST


def test_on_a_busy_machine_those_who_answer_late_are_waited_for(crowd: Crowd) -> None:
    crowd(4.0)
    with Graph(argparse.Namespace()) as graph:
        begin = time.monotonic()
        assert graph.discover(lambda: "/rig/demo" in graph.node_names())
        assert time.monotonic() - begin >= 4.0 * QUIET
