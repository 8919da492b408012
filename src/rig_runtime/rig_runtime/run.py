"""`run`: spin nodes until they are done or told to end, and leave cleanly.

SIGINT and SIGTERM raise nothing: a thread reads of them from a pipe and hands them to the executor as a task. Ending is
thereby an event between two callbacks and never cuts one in half: bags are closed, the trial's state is published, and
then the middleware goes down.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from rig_runtime.clocks import wall_ahead_of_steady
from rig_runtime.node import RigNode
from rig_runtime.realtime import Realtime, RealtimeError, Settings
from shared_control.parameters import ParameterError

RCLError: type[RuntimeError] = rclpy_implementation.RCLError

#: Where in its sources the middleware has found something wrong.
_PLACES = re.compile(r"[.,]* at /[^\s,]+:\d+")

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

#: [s] A finite "for ever": this build of the events executor hangs on an infinite deadline, which overflows in it.
FOREVER = 1e6

#: [s] A timer's period that no process lives for.
_NEVER = 1e5

#: [ns] How much less than before the wall clock must be ahead of the steady one to have been stepped back.
_STEP = 1_000_000

NodeFactory = Callable[..., RigNode]


def make_executor(context: rclpy.Context, kind: str = "events") -> Executor:
    """An executor that is known to serve: `events`, the fast one, or `single`, the reference.

    The events executor is experimental; if it does not serve a task within a second, the reference is used and it is
    said so. The multi-threaded executor is no choice: it lost messages at 1 kHz and ticks at 100 Hz.
    """
    if kind == "single":
        return SingleThreadedExecutor(context=context)
    if kind != "events":
        raise ValueError(f"executor {kind!r} is not known; it must be one of events, single")
    executor = EventsExecutor(context=context)
    served: Future[None] = Future(executor=executor)
    executor.create_task(lambda: served.set_result(None))
    executor.spin_until_future_complete(served, timeout_sec=1.0)
    if served.done():
        return executor
    print("rig_runtime: the events executor does not serve here; using the single-threaded one", file=sys.stderr)
    executor.shutdown()
    return SingleThreadedExecutor(context=context)


def spin(executor: Executor, nodes: Sequence[RigNode]) -> None:
    """Serve the nodes until one of them calls `stop`, or the context is shut down from outside."""
    done: Future[None] = Future(executor=executor)

    def end() -> None:
        if not done.done():
            done.set_result(None)

    for node in nodes:
        node.on_stop(end)
    with contextlib.suppress(ExternalShutdownException):
        executor.spin_until_future_complete(done, timeout_sec=FOREVER)


class _SignalTaker:
    """Turns SIGINT and SIGTERM into a call, from a thread of its own; a third signal ends the process at once.

    The interpreter's C handler writes to the pipe in whatever thread the signal meets. Blocking the signals instead
    would not do: threads that libraries have started at their import have a mask of their own.
    """

    def __init__(self) -> None:
        self._action: Callable[[], None] | None = None
        self._count = 0
        self._pipe, end = os.pipe()
        os.set_blocking(end, False)
        signal.set_wakeup_fd(end, warn_on_full_buffer=False)
        for number in _SIGNALS:
            signal.signal(number, lambda *_: None)
        threading.Thread(target=self._take, name="signals", daemon=True).start()

    @property
    def taken(self) -> bool:
        return self._count > 0

    def call(self, action: Callable[[], None]) -> None:
        self._action = action
        if self.taken:
            action()

    def _take(self) -> None:
        while True:
            if os.read(self._pipe, 1)[0] not in _SIGNALS:
                continue
            self._count += 1
            if self._count >= 3:
                os._exit(130)
            if self._action is not None:
                self._action()


def run(
    *factories: NodeFactory, args: Sequence[str] | None = None, executor: str | None = None, alone: bool = False
) -> int:
    """Make the nodes, spin them on one executor and return the exit code.

    `args` are the process's own, ROS arguments included (default: `sys.argv`). A parameter that is not allowed, or a
    middleware that refuses (no keys for its security), is reported in one sentence, exit code 2. `RIG_EXECUTOR` chooses
    the executor where the call does not; what `rig_runtime.realtime` reads from the environment is applied, with
    `alone` where RIG_CPUS says nothing.
    """
    signals = _SignalTaker()
    nodes: list[RigNode] = []
    try:
        realtime = Realtime(Settings.from_environment(alone=alone))
        realtime.before_middleware()
        try:
            rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
            for factory in factories:
                nodes.append(factory())
        except RCLError as error:
            print(f"error: {refusal_of_middleware(error)}", file=sys.stderr)
            return 2
        for node in nodes:
            node.prepare()
        return _serve(nodes, signals, realtime, executor or os.environ.get("RIG_EXECUTOR", "events"))
    except (ParameterError, RealtimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def refusal_of_middleware(error: RuntimeError) -> str:
    """In one sentence, without the places in sources that nobody here has."""
    words = " ".join(str(error).split())
    return f"the middleware does not start: {_PLACES.sub('', words)}"


def _serve(nodes: Sequence[RigNode], signals: _SignalTaker, realtime: Realtime, kind: str) -> int:
    executor = make_executor(rclpy.get_default_context(), kind)
    for node in nodes:
        executor.add_node(node)

    def stop_all() -> None:
        for node in nodes:
            node.stop()

    # It never fires; to reset it has the executor look at all of its timers anew.
    never = nodes[0].create_timer(_NEVER, lambda: None, clock=nodes[0].steady)

    def stepped_back(seconds: float) -> None:
        never.reset()
        nodes[0].get_logger().warning(
            f"the wall clock was stepped back by {seconds:.2f} s: the middleware may bring messages late from now on; "
            "after this trial, start the graph anew"
        )

    signals.call(lambda: executor.create_task(stop_all))
    realtime.before_ticks(below=[thread for node in nodes for thread in node.threads_below])
    # A thread that is started now is scheduled as this one is.
    look = min(node.longest_standstill for node in nodes)
    watch_clock(lambda seconds: executor.create_task(stepped_back, seconds), look)
    for node in nodes:
        node.scheduling = realtime.describe()
    spin(executor, nodes)
    for node in nodes:
        node.finish()
    for node in nodes:
        executor.remove_node(node)
    executor.shutdown()
    return max(node.exit_code for node in nodes)


def watch_clock(on_step_back: Callable[[float], object], period: float) -> None:
    """Call from a thread of its own, for as long as the process lives, whenever the wall clock has been stepped back,
    with the step [s]; it is looked at once in a period [s].

    Middleware that was built for an old C library waits for a time of the wall clock even where it means a steady one.
    Stepped back by an hour, such a wait takes an hour longer, and with it every timer: pacemaker and watchdogs.
    """

    def watch() -> None:
        ahead = wall_ahead_of_steady()
        while True:
            time.sleep(period)
            before, ahead = ahead, wall_ahead_of_steady()
            if ahead < before - _STEP:
                on_step_back(1e-9 * (before - ahead))

    threading.Thread(target=watch, name="clock", daemon=True).start()


def wait_until(condition: Callable[[], bool], executor: Executor, limit: float) -> bool:
    """Serve `executor` until `condition` holds; False if it does not within `limit` seconds of wall time."""
    end = time.monotonic() + limit
    while not condition():
        if time.monotonic() > end:
            return False
        executor.spin_once(timeout_sec=0.02)
    return True
