"""Running one node in a process of its own, with a clean end on every signal."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import TYPE_CHECKING

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from rig_bag.errors import BagError

if TYPE_CHECKING:
    from rig_bag.recorder import RecorderNode

__all__ = ["run", "spin"]


def spin(node: RecorderNode, until: Future) -> None:
    """Serve the node with the events executor until the future is done or the context is shut down."""
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    try:
        # Without a limit this executor waits in a busy loop and serves nothing.
        executor.spin_until_future_complete(until, timeout_sec=1e6)
    except ExternalShutdownException:
        pass
    finally:
        executor.remove_node(node)
        executor.shutdown()


def run(make: Callable[[], RecorderNode], args: list[str] | None, until_closed: bool) -> int:
    """Make a recorder, serve it until SIGINT, SIGTERM or (``until_closed``) the end of its trial; close its bag.

    Returns 0, or 1 after an error, which is printed.
    """
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    stop = Future()

    def on_signal(number: int, _frame: FrameType | None) -> None:
        if not stop.done():
            stop.set_result(signal.Signals(number).name)

    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    failed = False
    try:
        node = make()
        if until_closed:
            node.closed.add_done_callback(lambda _: None if stop.done() else stop.set_result("closed"))
        try:
            spin(node, stop)
            node.close(str(stop.result()) if stop.done() else "the context was shut down")
            failed = node.failed
        finally:
            node.destroy_node()
    except BagError as error:
        print(f"recorder: {error}", file=sys.stderr)
        failed = True
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        rclpy.try_shutdown()
    return 1 if failed else 0
