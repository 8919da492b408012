"""What the middleware makes of a killed process: how long a subscriber hears nobody after one of its publishers was
killed (-9) in the middle of its work. Bare publishers and subscribers, none of the rig's nodes.

    ./rig run python bench/killed.py --kills 60
    ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET FASTRTPS_DEFAULT_PROFILES_FILE=$PWD/config/fastdds_loopback.xml \\
        ./rig run python bench/killed.py --kills 60
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from live import in_own_domain
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import Int64

_QOS = QoSProfile(depth=200)

#: [s] Between two messages of one that lives on; what is longer than ten of them is a gap.
_PERIOD, _GAP = 0.01, 0.1

#: [s] Who has heard nothing for so long is deaf for good.
_DEAF = 60.0

#: [s] A publisher is killed at a random moment of this much of its life.
_LIFE = (0.1, 0.3)


def main() -> int:
    """Print how often there was a gap and how long they were; 1 if somebody stayed deaf."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=60, metavar="N")
    parser.add_argument("--others", type=int, default=4, metavar="N", help="publishers that live on (%(default)s)")
    parser.add_argument("--rate", type=float, default=2000.0, metavar="HZ", help="of the killed ones; 0: no pause")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--publish", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.publish:
        return _publish(options.publish[0], float(options.publish[1]))
    os.environ.update(in_own_domain())
    rclpy.init()
    node = rclpy.create_node("listener")
    moments = random.Random(options.seed)
    gaps: list[float] = []
    others = [_subscribe(node, f"other_{k}") for k in range(options.others)]
    with _publishers([(f"other_{k}", _PERIOD) for k in range(options.others)]):
        if missing := _unheard(others, _DEAF):
            print(f"error: {missing} of {len(others)} were not heard at all", file=sys.stderr)
            return 1
        brief = _subscribe(node, "brief")
        for k in range(options.kills):
            with _publishers([("brief", 1.0 / options.rate if options.rate else 0.0)]) as (publisher,):
                if _unheard([brief], _DEAF):
                    print(f"the next one was not heard within {_DEAF:.0f} s after kill {k}")
                    break
                end = time.monotonic() + moments.uniform(*_LIFE)
                while time.monotonic() < end:
                    _take(brief)
                    time.sleep(1e-3)
                publisher.kill()
                publisher.wait()
            for other in others:
                _take(other)
            begin = time.monotonic()
            soon = _unheard(others, _GAP)
            missing = _unheard(others, _DEAF) if soon else 0
            gaps.append(time.monotonic() - begin)
            if soon:
                until = f"{missing} of them never again" if missing else f"all after {gaps[-1]:.2f} s"
                print(f"kill {k + 1}: {soon} of {len(others)} were not heard, {until}", flush=True)
            if missing:
                break
    rclpy.shutdown()
    some = sum(gap > _GAP for gap in gaps)
    print(f"{len(gaps)} kills, {some} followed by a gap of more than {_GAP} s; longest {max(gaps, default=0.0):.2f} s")
    return 1 if len(gaps) < options.kills or max(gaps, default=0.0) >= _DEAF else 0


def _subscribe(node: Node, topic: str) -> Subscription:
    return node.create_subscription(Int64, topic, lambda _: None, _QOS)


def _take(subscription: Subscription) -> int:
    """Take what waits, without an executor; how many there were."""
    count = 0
    with subscription.handle:
        while subscription.handle.take_message(Int64, False) is not None:
            count += 1
    return count


def _unheard(subscriptions: list[Subscription], limit: float) -> int:
    """How many of them have heard nothing, after `limit` seconds or as soon as it is none."""
    left, end = list(subscriptions), time.monotonic() + limit
    while left and time.monotonic() < end:
        left = [each for each in left if not _take(each)]
        time.sleep(2e-3)
    return len(left)


@contextmanager
def _publishers(which: list[tuple[str, float]]) -> Iterator[list[subprocess.Popen[bytes]]]:
    """A process for each topic that publishes with a period [s]."""
    command = [sys.executable, __file__, "--publish"]
    processes = [subprocess.Popen([*command, topic, str(period)]) for topic, period in which]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _publish(topic: str, period: float) -> int:
    """Publish until killed."""
    rclpy.init()
    publisher = rclpy.create_node(topic).create_publisher(Int64, topic, _QOS)
    message = Int64()
    while True:
        publisher.publish(message)
        if period:
            time.sleep(period)


if __name__ == "__main__":
    sys.exit(main())
