"""Messages to YAML and back: identity for all messages that the rig uses, and clear words for what does not fit."""

from __future__ import annotations

import functools
import math
from typing import Any

import pytest
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point32,
    Polygon,
    PolygonStamped,
    PoseWithCovarianceStamped,
    Vector3,
    Wrench,
    WrenchStamped,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosidl_parser.definition import AbstractNestedType, AbstractString, Array, BoundedSequence, NamespacedType
from sensor_msgs.msg import JointState, RegionOfInterest
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import Bool, Byte, ByteMultiArray, Char, Float32, Float64MultiArray, Header, Int8, String, UInt64

from ros2_fallback import index
from ros2_fallback.command import CommandError
from ros2_fallback.message_text import FillError, fill, fill_from_yaml, to_csv, to_yaml
from ros2_fallback.message_types import message_class, service_class

MESSAGES = [
    *(Bool, Byte, ByteMultiArray, Char, Float32, Float64MultiArray, Header, Int8, String, UInt64),
    *(PolygonStamped, PoseWithCovarianceStamped, WrenchStamped, DiagnosticArray, JointState, SolidPrimitive),
    *(message_class(f"mig_interfaces/{name}") for name in index.interfaces("mig_interfaces", ("msg",))),
]


def values_of(slot: Any) -> st.SearchStrategy[Any]:
    """Values that a field of this rosidl type can have."""
    if isinstance(slot, NamespacedType):
        return messages_of(message_class("/".join(slot.namespaced_name())))
    if isinstance(slot, Array):
        return st.lists(values_of(slot.value_type), min_size=slot.size, max_size=slot.size)
    if isinstance(slot, AbstractNestedType):
        most = min(3, slot.maximum_size) if isinstance(slot, BoundedSequence) else 3
        return st.lists(values_of(slot.value_type), max_size=most)
    if isinstance(slot, AbstractString):
        return st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
    if slot.typename == "boolean":
        return st.booleans()
    if slot.typename == "octet":
        return st.binary(min_size=1, max_size=1)
    if slot.typename in ("float", "double"):
        return st.floats(allow_nan=False, width=32 if slot.typename == "float" else 64)
    bits = int(slot.typename.lstrip("uint"))
    low = 0 if slot.typename.startswith("u") else -(2 ** (bits - 1))
    return st.integers(low, low + 2**bits - 1)


@functools.cache
def messages_of(cls: Any) -> st.SearchStrategy[Any]:
    """Messages of a class, with any values in all of its fields."""
    names = list(cls.get_fields_and_field_types())
    return st.fixed_dictionaries({name: values_of(slot) for name, slot in zip(names, cls.SLOT_TYPES, strict=True)}).map(
        lambda fields: cls(**fields)
    )


@pytest.mark.parametrize("cls", MESSAGES, ids=lambda cls: cls.__name__)
@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), flow_style=st.booleans())
def test_yaml_round_trip_is_the_identity(cls: Any, flow_style: bool, data: st.DataObject) -> None:
    message = data.draw(messages_of(cls))
    copy = cls()
    fill_from_yaml(copy, to_yaml(message, flow_style=flow_style))
    assert copy == message


def test_yaml_form() -> None:
    message = DiagnosticArray(
        status=[
            DiagnosticStatus(level=b"\x01", name="a: b", values=[KeyValue(key="é", value="")]),
            DiagnosticStatus(),
        ]
    )
    assert to_yaml(message) == (
        "header:\n"
        "  stamp:\n"
        "    sec: 0\n"
        "    nanosec: 0\n"
        "  frame_id: ''\n"
        "status:\n"
        '- level: "\\x01"\n'
        "  name: 'a: b'\n"
        "  message: ''\n"
        "  hardware_id: ''\n"
        "  values:\n"
        "  - key: é\n"
        "    value: ''\n"
        '- level: "\\0"\n'
        "  name: ''\n"
        "  message: ''\n"
        "  hardware_id: ''\n"
        "  values: []\n"
    )
    joints = JointState(name=["x", "y"], position=[1.0, math.nan], velocity=[1e-05, -math.inf])
    assert to_yaml(joints).splitlines()[5:] == [
        *("name:", "- x", "- y", "position:", "- 1.0", "- .nan", "velocity:", "- 1.0e-05", "- -.inf", "effort: []"),
    ]
    assert to_yaml(Vector3(x=1.0), flow_style=True) == "x: 1.0\ny: 0.0\nz: 0.0\n"
    assert to_yaml(Polygon(points=[Point32(x=1.0)]), flow_style=True) == "points: [{x: 1.0, y: 0.0, z: 0.0}]\n"


def test_yaml_shortened() -> None:
    joints = JointState(name=["abcdef", "y", "z"], position=[1.0, 2.0, 3.0])
    joints.header.frame_id = "a long name"
    shown = yaml.safe_load(to_yaml(joints, truncate_length=2))
    assert shown["header"]["frame_id"] == "a ..."
    assert shown["name"] == ["ab...", "y", "..."]
    assert shown["position"] == [1.0, 2.0, "..."]
    shown = yaml.safe_load(to_yaml(joints, no_arr=True, no_str=True))
    assert shown["header"]["frame_id"] == "<string length: <11>>"
    assert shown["position"] == "<sequence type: double, length: 3>"
    pose = yaml.safe_load(to_yaml(PoseWithCovarianceStamped(), no_arr=True))
    assert pose["pose"]["covariance"] == "<array type: double[36]>"
    solid = yaml.safe_load(to_yaml(SolidPrimitive(dimensions=[1.0]), no_arr=True))
    assert solid["dimensions"] == "<sequence type: double[3], length: 1>"
    assert yaml.safe_load(to_yaml(DiagnosticArray(), no_arr=True))["status"] == (
        "<sequence type: diagnostic_msgs/msg/DiagnosticStatus, length: 0>"
    )


def test_csv() -> None:
    joints = JointState(name=["a", "b"], position=[1.0, 2.0])
    joints.header.frame_id = "f"
    assert to_csv(joints) == "0,0,f,a,b,1.0,2.0,,"
    assert to_csv(joints, truncate_length=1) == "0,0,f,a,...,1.0,...,,"
    assert to_csv(joints, no_str=True).startswith("0,0,<string length: <1>>")
    assert "<sequence type: double, length: 2>" in to_csv(joints, no_arr=True)


def test_partial_messages_leave_the_rest() -> None:
    message = WrenchStamped()
    message.wrench.torque.z = 4.0
    fill_from_yaml(message, "{header: {frame_id: base}, wrench: {force: {x: 1}, torque: {x: 1e-3}}}")
    assert message.header.frame_id == "base"
    assert (message.wrench.force.x, message.wrench.torque.x, message.wrench.torque.z) == (1.0, 1e-3, 4.0)
    request = service_class("std_srvs/SetBool").Request()
    fill_from_yaml(request, "data: true")
    assert request.data is True


def test_stamps() -> None:
    message = WrenchStamped()
    setters = fill(message, {"header": "auto"}, stamps=True)
    header = Header()
    setters += fill(header, {"stamp": "now", "frame_id": "x"}, stamps=True)
    for setter in setters:
        setter(Time(sec=5))
    assert message.header.stamp.sec == header.stamp.sec == 5
    with pytest.raises(FillError, match="header"):
        fill(message, {"header": "auto"})


@pytest.mark.parametrize(
    ("message", "text", "words"),
    [
        (Wrench(), "force: {x: 1, w: 2}", "'force.w': geometry_msgs/msg/Vector3 has no field 'w' .*x, y, z"),
        (Wrench(), "forces: {}", "'forces': geometry_msgs/msg/Wrench has no field 'forces'"),
        (Wrench(), "force: 3", "force .*needs a mapping"),
        (Wrench(), "force:", "force .*needs a mapping"),
        (Wrench(), "3", "needs to be a dictionary"),
        (Wrench(), "[", "not YAML"),
        (Vector3(), "x: north", "'x' needs a double, not 'north'"),
        (Vector3(), "x: [1]", "'x' needs a double"),
        (Vector3(), "x:", "'x' needs a double"),
        (Int8(), "data: 128", r"'data' needs a int8 in \[-128, 127\]"),
        (Int8(), "data: 1.5", "'data' needs a int8, not 1.5"),
        (UInt64(), "data: -1", "'data' needs a uint64"),
        (Float32(), "data: 1.0e+39", "float32"),
        (Bool(), "data: perhaps", "'data' needs a boolean"),
        (Byte(), "data: 256", "'data' needs a octet"),
        (String(), "data: [a]", "'data' needs a string"),
        (JointState(), "position: 1.0", "'position' needs a list of double"),
        (JointState(), "position: [1.0, x]", r"'position\[1\]' needs a double"),
        (PoseWithCovarianceStamped(), "pose: {covariance: [1.0]}", "'pose.covariance' needs 36 elements, not 1"),
        (SolidPrimitive(), "dimensions: [1, 2, 3, 4]", "'dimensions' takes at most 3 elements, not 4"),
        (DiagnosticArray(), "status: [{nam: x}]", r"'status\[0\].nam': diagnostic_msgs/msg/DiagnosticStatus has no"),
        (RegionOfInterest(), "do_rectify: 2", "'do_rectify' needs a boolean"),
    ],
)
def test_what_does_not_fit_is_named(message: Any, text: str, words: str) -> None:
    with pytest.raises(CommandError, match=words):
        fill_from_yaml(message, text)


def test_unknown_types_are_said() -> None:
    for name in ("String", "std_msgs/msg/Nothing", "nowhere/msg/String", "std_msgs/srv/String", "a.b/msg/C", ""):
        with pytest.raises(CommandError, match="interface"):
            message_class(name)
