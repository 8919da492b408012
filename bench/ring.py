"""The least that a graph of four nodes costs: a bare rclpy ring, one WrenchStamped a hop, nothing recorded.

`./rig run python bench/ring.py` prints it; `bench/lockstep.py` measures it beside each row, because a machine's own
speed moves from minute to minute, and only the ratio says something of the rig.
"""

from __future__ import annotations

import statistics
import time

from geometry_msgs.msg import WrenchStamped
from live import STEADY, Live
from rclpy.clock import Clock
from rclpy.serialization import serialize_message

from rig_runtime import topics

_HOPS = 4

NAME = f"bare rclpy ring of {_HOPS} hops"


def rounds(count: int = 1000, *, raw: bool = False, period: float = 0.0) -> list[float]:
    """Wall time of each round of the ring [s] on the executor that the rig uses.

    ``raw``: bytes instead of objects. ``period`` [s]: a round begins when its time has come; 0: when the last has
    ended.
    """
    with Live(paced=period > 0.0) as live:
        nodes = [live.node(f"hop{k}") for k in range(_HOPS)]
        publishers = [
            node.create_publisher(WrenchStamped, f"ring/hop{k}", topics.DATA_QOS) for k, node in enumerate(nodes)
        ]
        done = live.future()
        times: list[float] = []
        begun = 0.0

        def begin(message: WrenchStamped | bytes) -> None:
            nonlocal begun
            begun = time.perf_counter()
            publishers[0].publish(message)

        def first(message: WrenchStamped | bytes) -> None:
            times.append(time.perf_counter() - begun)
            if len(times) < count:
                if not period:
                    begin(message)
            elif not done.done():
                done.set_result(None)

        for k, node in enumerate(nodes):
            hop = first if k == 0 else publishers[k].publish
            node.create_subscription(WrenchStamped, f"ring/hop{(k - 1) % _HOPS}", hop, topics.DATA_QOS, raw=raw)
        live.settle(lambda: all(publisher.get_subscription_count() for publisher in publishers))
        message = serialize_message(WrenchStamped()) if raw else WrenchStamped()
        if period:
            nodes[0].create_timer(period, lambda: begin(message), clock=Clock(clock_type=STEADY))
        else:
            begin(message)
        live.serve(done)
    return times


def seconds_per_round(count: int = 1000, *, raw: bool = False) -> float:
    """Mean wall time of a round [s], one after the other."""
    return statistics.fmean(rounds(count, raw=raw))


if __name__ == "__main__":
    for _ in range(3):
        for title, raw in (("objects", False), ("bytes", True)):
            cost = seconds_per_round(raw=raw)
            factor = 0.01 / cost
            print(
                f"bare ring of {_HOPS} hops, {title}: {1e6 * cost:.0f} us a round, {factor:.1f} x real time at 100 Hz"
            )
