"""The least that a graph of four nodes costs: a bare rclpy ring, one WrenchStamped a hop, nothing recorded.

`./rig run python bench/ring.py` prints it; `bench/lockstep.py` measures it beside each row, because a machine's own
speed moves from minute to minute, and only the ratio says something of the rig.
"""

from __future__ import annotations

import time

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from rclpy.task import Future

from rig_runtime import topics
from rig_runtime.run import FOREVER, make_executor

_HOPS = 4


def seconds_per_round(rounds: int = 1000, *, raw: bool = False) -> float:
    """Wall time of one round of the ring [s] on the executor that the rig uses; ``raw``: bytes instead of objects."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=101)
    executor = make_executor(context)
    done: Future[None] = Future(executor=executor)
    nodes = [rclpy.create_node(f"hop{k}", context=context) for k in range(_HOPS)]
    publishers = [node.create_publisher(WrenchStamped, f"ring/hop{k}", topics.DATA_QOS) for k, node in enumerate(nodes)]
    left = rounds

    def first(message: WrenchStamped | bytes) -> None:
        nonlocal left
        left -= 1
        if left > 0:
            publishers[0].publish(message)
        elif not done.done():
            done.set_result(None)

    for k, node in enumerate(nodes):
        hop = first if k == 0 else publishers[k].publish
        node.create_subscription(WrenchStamped, f"ring/hop{(k - 1) % _HOPS}", hop, topics.DATA_QOS, raw=raw)
        executor.add_node(node)
    while any(publisher.get_subscription_count() == 0 for publisher in publishers):
        executor.spin_once(timeout_sec=0.01)
    begin = time.perf_counter()
    publishers[0].publish(serialize_message(WrenchStamped()) if raw else WrenchStamped())
    executor.spin_until_future_complete(done, timeout_sec=FOREVER)
    elapsed = time.perf_counter() - begin
    executor.shutdown()
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)
    return elapsed / rounds


if __name__ == "__main__":
    for _ in range(3):
        for title, raw in (("objects", False), ("bytes", True)):
            cost = seconds_per_round(raw=raw)
            factor = 0.01 / cost
            print(
                f"bare ring of {_HOPS} hops, {title}: {1e6 * cost:.0f} us a round, {factor:.1f} x real time at 100 Hz"
            )
