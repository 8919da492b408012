"""A node's line in `/diagnostics`, in a message that is made once: it is published between two ticks."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile

__all__ = ["Diagnostics"]


class Diagnostics:
    """Publishes a node's level, one sentence and values, and touches only what has changed since the last time."""

    def __init__(self, node: Node) -> None:
        self._status = DiagnosticStatus(name=node.get_fully_qualified_name(), hardware_id="rig")
        self._array = DiagnosticArray(status=[self._status])
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._keys: tuple[str, ...] = ()

    def publish(self, stamp: Time, level: bytes, message: str, values: Mapping[str, object]) -> None:
        """Say how the node is."""
        keys = tuple(values)
        if keys != self._keys:
            self._keys = keys
            self._status.values = [KeyValue(key=key) for key in keys]
        for pair, value in zip(self._status.values, values.values(), strict=True):
            pair.value = str(value)
        self._status.level, self._status.message = level, message
        self._array.header.stamp = stamp
        self._publisher.publish(self._array)
