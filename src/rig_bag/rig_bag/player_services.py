"""What surrounds a player: services that pause, resume and step it, and the account of its timing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from rig_bag.player import Player

__all__ = ["offer", "serve", "timing"]


def offer(node: Node, player: Player) -> None:
    """Make the services ``~/pause``, ``~/resume``, ``~/toggle_paused`` and ``~/play_next`` (std_srvs/Trigger)."""

    def service(name: str, act: Callable[[], bool | None], refusal: str = "") -> None:
        def answer(_: Any, response: Any) -> Any:
            response.success = act() is not False
            response.message = ("paused" if player.paused else "playing") if response.success else refusal
            return response

        node.create_service(Trigger, f"~/{name}", answer)

    service("pause", player.pause)
    service("resume", player.resume)
    service("toggle_paused", lambda: player.resume() if player.paused else player.pause())
    service("play_next", player.step, "it steps only while it is paused")


@contextmanager
def serve(node: Node, player: Player) -> Iterator[None]:
    """Answer the services from a thread of their own while the player plays in this one."""
    offer(node, player)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin, name="player-services", daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()


def timing(lateness: Sequence[float]) -> str:
    """How late messages went out, in a sentence."""
    if not lateness:
        return "nothing was played"
    median, high = np.percentile(lateness, (50, 99)) * 1e3
    return f"{len(lateness)} messages played; late by {median:.3f} ms (p50), {high:.3f} ms (p99)"
