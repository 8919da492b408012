"""Messages over their bytes against rclpy's own objects and serialisation."""

from __future__ import annotations

import contextlib
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from rig_runtime import topics
from rig_runtime import wire as wire_module
from rig_runtime.wire import LAST_SECOND, MalformedError, decode, stamp_of

LENGTHS: dict[Any, dict[str, int]] = {
    topics.TASK_STATE: {"state": 5, "control": 2},
    topics.WRENCH: {},
    topics.DECISION: {"user_control": 1, "nominal_control": 1, "applied_control": 1},
    topics.END_EFFECTOR: {},
}
INTEGERS = {"uint8": 2**8 - 1, "uint64": 2**64 - 1, "uint32": 10**9 - 1}


def filled(topic: Any, draw: Any) -> Any:
    """A message of this topic with random numbers."""
    message = topic.type()
    _fill(message, draw, LENGTHS[topic])
    message.header.frame_id = topic.frame
    return message


def _fill(message: Any, draw: Any, lengths: dict[str, int]) -> None:
    for name, kind in message.get_fields_and_field_types().items():
        if kind == "double":
            setattr(message, name, draw(st.floats()))
        elif kind == "boolean":
            setattr(message, name, draw(st.booleans()))
        elif kind == "int32":
            setattr(message, name, draw(st.integers(0, LAST_SECOND)))
        elif kind in INTEGERS:
            setattr(message, name, draw(st.integers(0, INTEGERS[kind])))
        elif kind == "sequence<double>":
            setattr(message, name, [draw(st.floats()) for _ in range(lengths[name])])
        elif kind != "string":
            _fill(getattr(message, name), draw, {})


def same(wire: Any, message: Any, prefix: str = "") -> None:
    """Each number of the object is where the wire has it."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            same(wire, value, f"{prefix}{name}.")
        elif kind != "string":
            np.testing.assert_array_equal(wire[prefix + name], value)


@pytest.mark.parametrize("topic", LENGTHS, ids=lambda topic: topic.name)
@settings(max_examples=30)
@given(data=st.data())
def test_as_rclpy_reads_and_writes(topic: Any, data: Any) -> None:
    message = filled(topic, data.draw)
    wire = topic.wire(**LENGTHS[topic])
    stored = serialize_message(message)
    assert wire.load(stored)
    same(wire, message)
    assert wire.stamp == stamp_of(stored) == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    # What is between the numbers, to align them, has no defined value: compared is what rclpy reads of it.
    again = topic.wire(**LENGTHS[topic])
    again.stamp = wire.stamp
    for name in message.get_fields_and_field_types():
        if name != "header":
            for path in [key for key in wire.paths if key == name or key.startswith(f"{name}.")]:
                again[path] = wire[path]
    read = deserialize_message(again.data, topic.type)
    same(wire, read)
    assert read.header.frame_id == topic.frame
    assert len(again.data) == len(stored)


def test_vectors_are_arrays_over_the_bytes() -> None:
    wire = topics.WRENCH.wire()
    wire["wrench.force"] = [1.0, 2.0, 3.0]
    wire["wrench.torque.y"] = 5.0
    message = deserialize_message(wire.data, topics.WRENCH.type)
    assert (message.wrench.force.x, message.wrench.force.y, message.wrench.force.z) == (1.0, 2.0, 3.0)
    assert message.wrench.torque.y == 5.0
    assert message.header.frame_id == topics.SENSOR_FRAME
    force = wire["wrench.force"]
    wire.clear()
    assert not force.any()
    assert deserialize_message(wire.data, topics.WRENCH.type).header.frame_id == topics.SENSOR_FRAME


@pytest.mark.parametrize("frame", ["", "another", topics.SENSOR_FRAME[::-1]])
def test_another_frame_is_told_and_the_numbers_are_there(frame: str) -> None:
    message = topics.WRENCH.type()
    message.header.frame_id = frame
    message.header.stamp.sec = 7
    message.wrench.force.z = 4.0
    wire = topics.WRENCH.wire()
    assert not wire.load(serialize_message(message))
    assert wire["wrench.force"].tolist() == [0.0, 0.0, 4.0]
    assert wire.stamp == 7 * 10**9
    assert wire.load(topics.WRENCH.wire().data)


def test_a_state_of_another_length_is_no_number() -> None:
    wire = topics.TASK_STATE.wire(state=4, control=1)
    for length in (0, 3, 5):
        message = topics.TASK_STATE.type(state=[1.0] * length, control=[2.0], tick=9)
        message.header.frame_id = topics.TASK_FRAME
        assert wire.load(serialize_message(message))
        assert np.isnan(wire["state"]).all()
        assert (wire["control"].tolist(), wire["tick"]) == ([2.0], 9)


def test_the_other_byte_order() -> None:
    text = topics.SENSOR_FRAME.encode() + b"\0"
    body = struct.pack(f">iII{len(text)}s", 3, 4, len(text), text)
    body += bytes(-len(body) % 8) + struct.pack(">6d", *range(6))
    data = bytes(4) + body
    wire = topics.WRENCH.wire()
    assert stamp_of(data) == 3 * 10**9 + 4
    assert wire.load(data)
    assert wire["wrench.torque"].tolist() == [3.0, 4.0, 5.0]
    assert wire.stamp == stamp_of(data)


def test_between_the_numbers_is_zero_whatever_the_memory_held(monkeypatch: pytest.MonkeyPatch) -> None:
    text = topics.SENSOR_FRAME.encode() + b"\0"
    head = struct.pack(f"<4BiII{len(text)}s", 0, 1, 0, 0, 0, 0, len(text), text)
    gap = -(len(head) - 4) % 8
    assert gap

    def serialize(message: Any) -> bytes:
        data = bytes(serialize_message(message))
        return data[: len(head)] + b"\xff" * gap + data[len(head) + gap :]

    monkeypatch.setattr(wire_module, "serialize_message", serialize)
    wire = topics.WRENCH.wire()
    assert wire.data == head + bytes(gap + 48)
    assert wire.load(serialize(topics.WRENCH.type(header=deserialize_message(wire.data, topics.WRENCH.type).header)))
    wire.clear()
    assert wire.data == head + bytes(gap + 48)


def test_a_kind_of_field_that_is_not_provided_for() -> None:
    with pytest.raises((KeyError, TypeError, AttributeError)):
        topics.TRIAL_STATE.wire()


def test_a_stamp_is_taken_over() -> None:
    first, second = topics.TASK_STATE.wire(state=4, control=1), topics.WRENCH.wire()
    first.stamp = 1_732_500_000_123_456_789
    second.take_stamp(first)
    assert second.stamp == first.stamp
    stamp = deserialize_message(second.data, topics.WRENCH.type).header.stamp
    assert (stamp.sec, stamp.nanosec) == (1_732_500_000, 123_456_789)


@given(st.binary(max_size=200))
def test_bytes_of_any_length_are_a_message_or_malformed(data: bytes) -> None:
    wire = topics.WRENCH.wire()
    for take in (wire.load, wire.check, stamp_of, lambda data: decode(data, topics.WRENCH.type)):
        with contextlib.suppress(MalformedError):
            take(data)


@given(sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
def test_a_stamp_is_a_time_or_malformed(sec: int, nanosec: int) -> None:
    data = b"\0\1\0\0" + struct.pack("<iI", sec, nanosec)
    if 0 <= sec <= LAST_SECOND and nanosec < 10**9:
        assert stamp_of(data) == sec * 10**9 + nanosec
    else:
        with pytest.raises(MalformedError, match="no stamp"):
            stamp_of(data)


def test_a_cut_message_is_malformed_and_leaves_what_was_loaded() -> None:
    wire = topics.TASK_STATE.wire(state=4, control=1)
    wire["tick"] = 7
    whole = wire.data
    for length in range(len(whole)):
        with pytest.raises(MalformedError):
            wire.check(whole[:length])
        with pytest.raises(MalformedError):
            wire.load(whole[:length])
        assert wire["tick"] == 7
    wire.check(whole)
