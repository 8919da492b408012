"""How late a bag's messages go out at rate 1: `./rig run python bench/play.py BAG`.

The lateness of each against its time in the bag, and for comparison that of a bare `clock_nanosleep` in C at 100 Hz in
the same minute (`bench/c`): what the machine allows.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import rclpy
from jitter import nanosleep
from native import program
from rows import percentile

from rig_bag.player import Player


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("--seconds", type=float, default=30.0, help="play this much of it (%(default)s)")
    arguments = parser.parse_args()
    rclpy.init(args=[])
    node = rclpy.create_node("play_bench")
    player = Player(node, arguments.bag, duration=arguments.seconds)
    before = os.getloadavg()[0]
    count = player.play()
    with program("wake") as wake:
        bare = nanosleep(wake, 0.01, 500)
    node.destroy_node()
    rclpy.try_shutdown()
    print(f"{arguments.bag}: {count} messages in {arguments.seconds:.0f} s at rate 1")
    print(f"{'':24} {'p50':>9} {'p99':>9} {'most':>9}   ms")
    for name, late in (("messages", player.lateness), ("clock_nanosleep in C", bare)):
        print(f"{name:24} " + " ".join(f"{1e3 * percentile(late, share):9.3f}" for share in (0.5, 0.99, 1.0)))
    print(f"load {before:.2f} before, {os.getloadavg()[0]:.2f} after")


if __name__ == "__main__":
    main()
