"""The task's picture as markers and its state as joints, for RViz and Foxglove. What to draw is the task's to say."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from rig_runtime import topics
from rig_runtime.ticks import to_stamp
from shared_control.scene import evaluate
from shared_control.tasks.task import Array, Task

#: Of what has no end in the picture [m]: ground, levels.
_LONG = 100.0

#: [s] After this much silence a picture disappears, so that no viewer shows a trial that is over as a live one.
_LIFETIME = Duration(sec=2)

_COLOURS = {
    "success": ColorRGBA(r=0.0, g=0.62, b=0.45, a=0.8),
    "target": ColorRGBA(r=0.90, g=0.62, b=0.0, a=1.0),
    "body": ColorRGBA(r=0.34, g=0.42, b=0.50, a=1.0),
    "bob": ColorRGBA(r=0.0, g=0.45, b=0.70, a=1.0),
    "danger": ColorRGBA(r=0.84, g=0.37, b=0.0, a=1.0),
}

Place = tuple[float, float]


class View:
    """Publishes the picture of a state. x right, z up, as the robot's axes are."""

    def __init__(self, node: Node, task: Task) -> None:
        self._scene = task.scene(task.target)
        self._markers = node.create_publisher(topics.MARKERS.type, topics.MARKERS.name, topics.MARKERS.qos)
        self._joints = node.create_publisher(
            topics.JOINT_STATES.type, topics.JOINT_STATES.name, topics.JOINT_STATES.qos
        )
        names = task.state_names
        self._positions = [i for i, name in enumerate(names) if not name.endswith("_dot")]
        self._names = [names[i] for i in self._positions]
        self._velocities = [names.index(f"{name}_dot") if f"{name}_dot" in names else -1 for name in self._names]

    def publish(self, x: Array, stamp: int) -> None:
        """Both messages for a state (n,) at a stamp [ns]."""
        state = x.tolist()
        joints = JointState(name=self._names)
        joints.header.stamp, joints.header.frame_id = to_stamp(stamp), topics.TASK_FRAME
        joints.position = [state[i] for i in self._positions]
        joints.velocity = [state[i] if i >= 0 else math.nan for i in self._velocities]
        self._joints.publish(joints)
        if self._markers.get_subscription_count():
            self._markers.publish(self._picture(state, stamp))

    def _picture(self, state: list[float], stamp: int) -> MarkerArray:
        scene = self._scene
        places = {name: (evaluate(x, state), evaluate(z, state)) for name, (x, z) in scene.get("points", {}).items()}
        markers = [_SHAPES[shape["shape"]](shape, places) for shape in scene.get("shapes", ())]
        for number, marker in enumerate(markers):
            marker.header.stamp, marker.header.frame_id = to_stamp(stamp), topics.TASK_FRAME
            marker.ns, marker.id, marker.lifetime = "task", number, _LIFETIME
            marker.pose.orientation.w = 1.0
        return MarkerArray(markers=markers)


def _line(colour: str, width: float, *places: Place) -> Marker:
    marker = Marker(type=Marker.LINE_STRIP, color=_COLOURS[colour])
    marker.scale.x = width
    marker.points = [Point(x=x, z=z) for x, z in places]
    return marker


def _solid(kind: int, colour: str, at: Place, *size: float) -> Marker:
    marker = Marker(type=kind, color=_COLOURS[colour])
    marker.pose.position.x, marker.pose.position.z = at
    marker.scale.x, marker.scale.y, marker.scale.z = size
    return marker


def _cart(shape: dict[str, Any], at: dict[str, Place]) -> Marker:
    width, height = shape["width"], shape["height"]
    return _solid(Marker.CUBE, "body", at[shape["at"]], width, height, height)


def _disc(shape: dict[str, Any], at: dict[str, Place]) -> Marker:
    return _solid(Marker.SPHERE, "bob", at[shape["at"]], *3 * (2.0 * shape["radius"],))


def _mark(shape: dict[str, Any], _: dict[str, Place]) -> Marker:
    return _solid(Marker.SPHERE, "target", (shape["x"], shape["height"]), 0.1, 0.1, 0.1)


def _stop(shape: dict[str, Any], _: dict[str, Place]) -> Marker:
    x, z = shape["x"], shape["height"]
    return _line("danger", 0.05, (x, z), (x, z + 0.3))


def _rod(shape: dict[str, Any], at: dict[str, Place]) -> Marker:
    return _line("body", shape["width"], at[shape["from"]], at[shape["to"]])


def _spring(shape: dict[str, Any], at: dict[str, Place]) -> Marker:
    """From the one end towards the other, never longer than at rest."""
    (x, z), (to_x, to_z) = at[shape["from"]], at[shape["to"]]
    far = math.hypot(to_x - x, to_z - z)
    share = min(shape["rest"] / far, 1.0) if far > 0.0 else 0.0
    return _line("body", 0.5 * shape["width"], (x, z), (x + share * (to_x - x), z + share * (to_z - z)))


def _horizontal(colour: str, key: str) -> Callable[[dict[str, Any], dict[str, Place]], Marker]:
    return lambda shape, _: _line(colour, 0.02, (-_LONG, shape[key]), (_LONG, shape[key]))


def _sector(shape: dict[str, Any], at: dict[str, Place]) -> Marker:
    """The outline; angles count from the vertical, towards x."""
    x, z = at[shape["at"]]
    radius, middle, half = shape["radius"], shape["middle"], shape["half"]
    angles = [middle + half * (k / 8.0 - 1.0) for k in range(17)]
    arc = [(x + radius * math.sin(angle), z + radius * math.cos(angle)) for angle in angles]
    return _line("success", 0.02, (x, z), *arc, (x, z))


_SHAPES: dict[str, Callable[[dict[str, Any], dict[str, Place]], Marker]] = {
    "ground": _horizontal("body", "height"),
    "level": _horizontal("target", "height"),
    "band": _horizontal("success", "bottom"),
    "sector": _sector,
    "mark": _mark,
    "stop": _stop,
    "cart": _cart,
    "disc": _disc,
    "rod": _rod,
    "spring": _spring,
}
