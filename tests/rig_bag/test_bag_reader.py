"""Reading: arrays equal what was sent and what an independent reader decodes; damage is an error."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Quaternion, WrenchStamped
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String

from mig_interfaces.msg import TaskState
from rig_bag import BagError, BagWriter, info, messages, read
from rig_bag.cdr import parse
from rig_bag.definitions import full_definition


def _write(path: Path, **topics: list[Any]) -> Path:
    with BagWriter(path) as writer:
        for name, sent in topics.items():
            kind = type(sent[0])
            channel = writer.add_topic(f"/{name}", f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}")
            for number, message in enumerate(sent):
                writer.write(channel, serialize_message(message), number, number + 1)
    return path


def test_arrays_equal_what_was_sent(tmp_path: Path, task_state: Callable[[int], TaskState]) -> None:
    wrenches = [WrenchStamped() for _ in range(20)]
    for number, wrench in enumerate(wrenches):
        wrench.header.frame_id = "force_sensor"
        wrench.wrench.force.y = float(number)
        wrench.wrench.torque.z = -1.0
    turns = [Quaternion(x=1.0, y=2.0, z=3.0, w=4.0)]
    bag = _write(tmp_path / "bag", state=[task_state(k) for k in range(30)], wrench=wrenches, turn=turns)
    arrays = read(bag)
    state = arrays["/state"]
    assert state.dtype.names[:5] == ("log_time", "publish_time", "stamp", "frame_id", "tick")
    assert state["state"].shape == (30, 4)
    np.testing.assert_array_equal(state["tick"], np.arange(30))
    np.testing.assert_array_equal(state["state"][:, 0], np.arange(30) + 0.5)
    np.testing.assert_array_equal(state["stamp"], 1_000_000_000_000 + 10_000_000 * np.arange(30))
    np.testing.assert_array_equal(state["publish_time"], state["log_time"] + 1)
    assert set(state["frame_id"]) == {"task"}
    np.testing.assert_array_equal(arrays["/wrench"]["wrench.force"], [[0.0, k, 0.0] for k in range(20)])
    np.testing.assert_array_equal(arrays["/wrench"]["wrench.torque"][:, 2], -1.0)
    assert list(read(bag, ["/wrench"])) == ["/wrench"]
    assert arrays["/turn"].dtype.names == ("log_time", "publish_time", "x", "y", "z", "w")


def test_messages_without_a_common_layout_are_a_list(tmp_path: Path) -> None:
    status = DiagnosticStatus(name="n", message="é", values=[KeyValue(key="a", value="b")])
    joints = [JointState(name=["a"], position=[1.0]), JointState(name=["a", "bb"], position=[1.0, 2.0])]
    texts = [String(data="a"), String(data="bc"), String()]
    bag = _write(tmp_path / "bag", d=[DiagnosticArray(status=[status, status])], j=joints, t=texts, e=[Empty()])
    rows = read(bag)
    assert rows["/d"][0].status[1].values[0].value == "b"
    assert rows["/d"][0].status[0].message == "é"
    assert [list(row.position) for row in rows["/j"]] == [[1.0], [1.0, 2.0]]
    assert rows["/j"][1].name == ["a", "bb"]
    assert [(row.data, row.log_time) for row in rows["/t"]] == [("a", 0), ("bc", 1), ("", 2)]
    assert len(rows["/e"]) == 1


def test_a_topic_without_messages_is_an_empty_array(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/decision", "mig_interfaces/msg/FilterDecision")
    decision = read(tmp_path / "bag")["/decision"]
    assert decision.shape == (0,)
    assert decision["stamp"].dtype == np.int64


DECISION = "mig_interfaces/msg/FilterDecision"


@cache
def _store() -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    types = get_types_from_msg(full_definition(DECISION), DECISION)
    store.register({key: value for key, value in types.items() if key not in store.fielddefs})
    return store


def _decision(store: Any, frame: str, controls: list[float], criterion: float, tick: int, verdict: int) -> bytes:
    """A decision as an independent encoder writes it."""
    kinds = store.types
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](7, 8), frame)
    vector = kinds["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    user = np.array(controls)
    message = kinds[DECISION](
        header=header,
        tick=tick,
        mode=1,
        verdict=verdict,
        reason=2,
        criterion=criterion,
        threshold=-1.0,
        user_control=user,
        nominal_control=np.array([]),
        applied_control=user[:1],
        user_force=vector,
        admitted_force=vector,
        added_force=vector,
        delay=0.75,
        state_age=0.5,
        wrench_age=0.25,
        compute_time=0.125,
    )
    return bytes(store.serialize_cdr(message, DECISION))


_number = st.floats(allow_nan=False, width=64)
_text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=9)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.builds(
            lambda frame, controls, criterion, tick, verdict: (frame, controls, criterion, tick, verdict),
            _text,
            st.lists(_number, max_size=3),
            _number,
            st.integers(0, 2**64 - 1),
            st.integers(0, 255),
        ),
        min_size=1,
        max_size=4,
    ),
    st.booleans(),
)
def test_both_ways_of_reading_equal_an_independent_decoder(
    rows: list[tuple[str, list[float], float, int, int]], alike: bool
) -> None:
    if alike:
        rows = [(rows[0][0], rows[0][1], *row[2:]) for row in rows]
    store = _store()
    schema = parse(DECISION, full_definition(DECISION))
    data = [_decision(store, *row) for row in rows]
    expected = [store.deserialize_cdr(item, DECISION) for item in data]
    array = schema.array(data)
    assert array is not None or not alike
    for number, (want, item) in enumerate(zip(expected, data, strict=True)):
        got = schema.decode(item)
        for field in ("tick", "verdict", "criterion", "threshold", "delay", "state_age", "compute_time"):
            assert getattr(got, field) == getattr(want, field)
            assert array is None or array[number][field] == getattr(want, field)
        for field in ("user_control", "nominal_control", "applied_control"):
            np.testing.assert_array_equal(getattr(got, field), getattr(want, field))
            if array is not None:
                np.testing.assert_array_equal(array[number][field], getattr(want, field))
        assert got.header.frame_id == want.header.frame_id
        assert array is None or array[number]["frame_id"] == want.header.frame_id


def test_messages_come_in_the_order_of_log_times(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        a, b = writer.add_topic("/a", "std_msgs/msg/Empty"), writer.add_topic("/b", "std_msgs/msg/Empty")
        for channel, log_time in ((a, 5), (b, 3), (b, 5), (a, 1)):
            writer.write(channel, b"\0\1\0\0\0", log_time, 0)
    assert [(m.topic, m.log_time) for m in messages(tmp_path / "bag")] == [("/a", 1), ("/b", 3), ("/a", 5), ("/b", 5)]
    assert [m.topic for m in messages(tmp_path / "bag", ["/b"])] == ["/b", "/b"]


# -- what is no bag, or no longer ------------------------------------------------------------------------------------


@pytest.fixture
def bag(tmp_path: Path, task_state: Callable[[int], TaskState]) -> Path:
    return _write(tmp_path / "bag", state=[task_state(k) for k in range(50)])


def test_a_cut_file_is_an_error_at_every_length(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    whole = file.read_bytes()
    for size in [*range(40), *range(40, len(whole), 97), len(whole) - 1]:
        file.write_bytes(whole[:size])
        with pytest.raises(BagError, match=r"bag_0\.mcap"):
            read(bag)


def test_a_changed_byte_under_a_checksum_is_an_error(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    whole = bytearray(file.read_bytes())
    start = whole.index(b"\x28\xb5\x2f\xfd")
    for offset in range(start, start + 400, 7):
        whole[offset] ^= 0x10
        file.write_bytes(whole)
        with pytest.raises(BagError, match="damaged"):
            read(bag)
        whole[offset] ^= 0x10


@pytest.mark.parametrize(
    ("content", "says"), [(b"#ROSBAG V2.0\n", "ROS 1"), (b"SQLite format 3\0", "sqlite3"), (b"", "no MCAP")]
)
def test_foreign_files_are_named(bag: Path, content: bytes, says: str) -> None:
    (bag / "bag_0.mcap").write_bytes(content)
    with pytest.raises(BagError, match=says):
        read(bag)


def test_what_is_missing_is_named(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="there is no bag"):
        info(tmp_path / "none")
    with pytest.raises(BagError, match="has no topic /other; it has /state"):
        read(bag, ["/other"])
    (bag / "bag_0.mcap").unlink()
    with pytest.raises(BagError, match=r"bag_0\.mcap"):
        read(bag)
    metadata = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(metadata.replace("- bag_0.mcap", "- bag_0.mcap: 1"))
    with pytest.raises(BagError, match=r"not the metadata of a rosbag2 bag .*is no text"):
        info(bag)
    (bag / "metadata.yaml").write_text("a: 1")
    with pytest.raises(BagError, match="not the metadata"):
        info(bag)
    (bag / "metadata.yaml").write_text("{")
    with pytest.raises(BagError, match="cannot be read"):
        info(bag)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"has no metadata\.yaml"):
        info(bag)


def test_definitions_that_lack_a_part_are_refused() -> None:
    with pytest.raises(BagError, match="mentions b_msgs/B"):
        parse("a_msgs/msg/A", "b_msgs/B value\n")
    with pytest.raises(BagError, match="does not fit"):
        parse("a_msgs/msg/A", "float64 value\n").decode(b"\0\1\0\0\0")
