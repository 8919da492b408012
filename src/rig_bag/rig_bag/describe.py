"""The text of ``ros2 bag info`` for a bag. Source: the output format of ros2bag for Jazzy."""

from __future__ import annotations

import time

from rig_bag.metadata import EMPTY_START
from rig_bag.reader import Bag

__all__ = ["describe"]

_WIDTH = 19
_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")


def _size(size: int) -> str:
    value = float(size)
    unit = 0
    while value >= 1024.0 and unit < len(_UNITS) - 1:
        value /= 1024.0
        unit += 1
    return f"{value:.{1 if unit else 0}f} {_UNITS[unit]}"


def _seconds(nanoseconds: int) -> str:
    return "{}.{:09d}".format(*divmod(nanoseconds, 1_000_000_000))


def _moment(nanoseconds: int) -> str:
    seconds, fraction = divmod(nanoseconds, 1_000_000_000)
    local = time.localtime(seconds)
    return (
        f"{time.strftime('%b', local)} {local.tm_mday:2d} {local.tm_year} "
        f"{time.strftime('%H:%M:%S', local)}.{fraction:09d} ({_seconds(nanoseconds)})"
    )


def describe(bag: Bag) -> str:
    """The lines that ``ros2 bag info`` prints, beginning and ending as it does."""
    data = bag.metadata
    start = 0 if data.start == EMPTY_START else data.start
    pad = "\n" + " " * _WIDTH
    topics = [
        f"Topic: {entry.name} | Type: {entry.type} | Count: {entry.count} | "
        f"Serialization Format: {entry.serialization_format}"
        for entry in data.topics
    ]
    rows = (
        ("Files", pad.join(data.files)),
        ("Bag size", _size(bag.size)),
        ("Storage id", data.storage),
        ("ROS Distro", data.ros_distro or "unknown"),
        ("Duration", _seconds(data.duration) + "s"),
        ("Start", _moment(start)),
        ("End", _moment(start + data.duration)),
        ("Messages", str(data.messages)),
        ("Topic information", pad.join(topics)),
        ("Service", "0"),
    )
    lines = "".join(f"{name + ':':<{_WIDTH}}{value}\n" for name, value in rows)
    return f"\n{lines}Service information: "
