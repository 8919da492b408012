"""Bags that are no plain MCAP: ROS 1, sqlite3, and compressed by rosbag2, read through `rosbags`.

What it reads takes the form of :class:`rig_bag.contents.Contents`, messages as CDR and definitions as text, so that
all that is done with a bag can be done with these; only a check from the bytes and a repair cannot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig_bag import definitions
from rig_bag.contents import Contents, Messages
from rig_bag.errors import BagError
from rig_bag.metadata import EMPTY_START, BagMetadata, FileEntry, TopicEntry

__all__ = ["contents_of", "is_ros1", "metadata_of_ros1"]

_ROS1_MAGIC = b"#ROSBAG V"


def is_ros1(path: Path) -> bool:
    """Whether this is a bag of ROS 1: one file that says so at its begin."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(len(_ROS1_MAGIC)) == _ROS1_MAGIC


def metadata_of_ros1(path: Path) -> BagMetadata:
    """What ``metadata.yaml`` would say of it.

    Raises
    ------
    BagError: it cannot be read.
    """
    with _opened(path) as reader:
        topics: dict[tuple[str, str], int] = {}
        for connection in reader.connections:
            key = connection.topic, connection.msgtype
            topics[key] = topics.get(key, 0) + connection.msgcount
        count = reader.message_count
        start, end = (reader.start_time, reader.end_time - 1) if count else (EMPTY_START, EMPTY_START)
        entry = FileEntry(path.name, start, end - start, count)
        return BagMetadata(
            files=(path.name,),
            parts=(entry,),
            start=start,
            duration=end - start,
            topics=tuple(TopicEntry(name, kind, n, serialization_format="ros1") for (name, kind), n in topics.items()),
            ros_distro="ROS 1",
            storage="rosbag1",
        )


def contents_of(path: Path) -> Contents:
    """Read all of a bag (a directory, or a file of ROS 1).

    Raises
    ------
    BagError: it is damaged, or of a form that neither `rosbags` nor this package knows; or the definition of a type
        is neither in it nor installed.
    """
    with _opened(path) as reader:
        ros1 = is_ros1(path)
        store = _types(reader.connections, ros1=ros1)
        result = Contents(profile="ros1" if ros1 else "ros2", library="rosbags")
        channels: dict[tuple[str, str], Messages] = {}
        of_type: dict[str, int] = {}
        for connection in reader.connections:
            kind = connection.msgtype
            form = "cdr" if ros1 else connection.ext.serialization_format
            if form != "cdr":
                raise BagError(f"{path}: {connection.topic} is serialised as {form}; only cdr is read here")
            if kind not in of_type:
                of_type[kind] = len(of_type) + 1
                text = store.generate_msgdef(kind, ros_version=2)[0]
                result.schemas[of_type[kind]] = (kind, "ros2msg", text.encode())
            channel = Messages(connection.topic, of_type[kind], "cdr", {})
            result.channels[len(channels) + 1] = channels.setdefault((connection.topic, kind), channel)
        for connection, time, raw in reader.messages():
            channel = channels[connection.topic, connection.msgtype]
            data = bytes(store.ros1_to_cdr(raw, connection.msgtype) if ros1 else raw)
            channel.append(time, time, result.count, data)
            result.count += 1
        return result


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader of `rosbags`; whatever goes wrong inside is a BagError."""
    try:
        # Imported here: the rig's own bags do without.
        from rosbags import rosbag1, rosbag2
    except ImportError:
        raise BagError(f"{path} is no plain MCAP bag; to read it, install rosbags (pip install rosbags)") from None
    try:
        with rosbag1.Reader(path) if is_ros1(path) else rosbag2.Reader(path) as reader:
            yield reader
    except BagError:
        raise
    except Exception as error:  # of many kinds, where a file is damaged
        raise BagError(f"{path} cannot be read: {error} ({type(error).__name__})") from error


def _types(connections: Sequence[Any], *, ros1: bool) -> Any:
    """The types of a bag: as it defines them, or as they are installed."""
    from rosbags.interfaces import MessageDefinitionFormat as Format
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    known = get_typestore(Stores.LATEST)
    types: dict[str, Any] = {}
    for connection in connections:
        form, text = connection.msgdef
        if form == Format.MSG:
            types |= get_types_from_msg(text, connection.msgtype)
        elif form == Format.IDL:
            for part in text.split("=" * 80 + "\n"):
                body = part.partition("\n")[2] if part.startswith("IDL: ") else part
                if body.strip():
                    types |= get_types_from_idl(body)
    if ros1:
        # What ROS 2 has as well is read as that; the number in a ROS 1 header is left out.
        types["std_msgs/msg/Header"] = known.fielddefs["std_msgs/msg/Header"]
        types["builtin_interfaces/msg/Time"] = known.fielddefs["builtin_interfaces/msg/Time"]
    for connection in connections:
        if connection.msgtype not in types:
            # Bags from before Iron carry no definitions.
            types |= get_types_from_msg(definitions.full_definition(connection.msgtype), connection.msgtype)
    store.register(types)
    return store
