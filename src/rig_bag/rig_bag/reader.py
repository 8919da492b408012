"""Reading bags: what a bag holds, its messages as bytes, and its topics as arrays.

Everything is decoded with the definitions that the bag carries; neither ROS nor the messages need be installed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rig_bag import cdr, foreign
from rig_bag.contents import Contents, Messages
from rig_bag.errors import BagError
from rig_bag.mcap_scan import scan
from rig_bag.metadata import BagMetadata

__all__ = ["Bag", "Message", "info", "messages", "ordered", "read"]


class Message(NamedTuple):
    """One stored message; times in nanoseconds since the epoch."""

    topic: str
    type: str
    log_time: int
    publish_time: int
    data: bytes


@dataclass(frozen=True)
class Bag:
    """A bag on the disk: where it is, what ``metadata.yaml`` says, and how large it is [B].

    A bag of ROS 1 is a file, which says the same itself.
    """

    path: Path
    metadata: BagMetadata
    size: int

    def files(self) -> list[Path]:
        if self.path.is_file():
            return [self.path]
        return [self.path / name for name in self.metadata.files]

    def contents(self) -> list[Contents]:
        """The contents of its files, read in full.

        Raises
        ------
        BagError: as :func:`rig_bag.mcap_scan.scan`, and, of what is no plain MCAP, :func:`rig_bag.foreign.contents_of`.
        """
        if self.metadata.storage != "mcap" or self.metadata.compression_mode not in ("", "none", "NONE"):
            return [foreign.contents_of(self.path)]
        return [scan(path) for path in self.files()]


def info(bag: str | os.PathLike[str]) -> Bag:
    """Describe a bag from its ``metadata.yaml`` (what ``ros2 bag info`` reads), or a file of ROS 1 from itself.

    Raises
    ------
    BagError: there is no such bag, or its metadata cannot be read.
    """
    path = Path(bag)
    if foreign.is_ros1(path):
        return Bag(path, foreign.metadata_of_ros1(path), path.stat().st_size)
    if path.is_file() and path.suffix in (".mcap", ".db3"):
        path = path.parent
    if not path.is_dir():
        raise BagError(f"there is no bag {path}")
    metadata = BagMetadata.load(path)
    return Bag(path, metadata, sum(file.stat().st_size for file in path.rglob("*") if file.is_file()))


def messages(bag: str | os.PathLike[str], topics: Sequence[str] | None = None) -> Iterator[Message]:
    """Yield the stored messages in the order of their log times (in the order of the file where they are equal).

    Raises
    ------
    BagError: as :func:`info`; or a file is damaged.
    """
    yield from ordered(info(bag).contents(), topics)


def ordered(files: Sequence[Contents], topics: Sequence[str] | None = None) -> Iterator[Message]:
    """The messages of a bag's files, one file after the other, each in the order that :func:`messages` has."""
    for contents in files:
        found: list[tuple[int, int, Message]] = []
        for channel in contents.channels.values():
            if topics is None or channel.topic in topics:
                name = contents.schemas.get(channel.schema, ("", "", b""))[0]
                found.extend(
                    (log_time, order, Message(channel.topic, name, log_time, publish_time, data))
                    for log_time, publish_time, data, order in zip(
                        channel.log_times, channel.publish_times, channel.data, channel.order, strict=True
                    )
                )
        found.sort(key=itemgetter(0, 1))
        for _, _, message in found:
            yield message


def read(bag: str | os.PathLike[str], topics: Sequence[str] | None = None) -> dict[str, Any]:
    """Read topics into arrays: {topic: structured array of shape (messages,), or list}.

    Columns: ``log_time`` and ``publish_time`` [ns], then the message's fields in the order of its definition, as
    :meth:`rig_bag.cdr.Schema.array` lays them out (Vector3: last axis x, y, z). A topic whose messages have no common
    layout (strings or sequences of changing length, sequences of messages) is a list of namespaces with ``log_time``
    and ``publish_time`` added to the message's own fields.

    Raises
    ------
    BagError: as :func:`messages`; or a topic asked for is not in the bag; or bytes do not fit their definition.
    """
    found: dict[str, _Topic] = {}
    for contents in info(bag).contents():
        for channel in contents.channels.values():
            schema = contents.schemas[channel.schema]
            topic = found.setdefault(channel.topic, _Topic(schema, channel.encoding))
            if (topic.schema, topic.encoding) != (schema, channel.encoding):
                raise BagError(f"the files of {bag} do not agree on the type of {channel.topic}")
            topic.parts.append(channel)
    missing = [topic for topic in topics or () if topic not in found]
    if missing:
        raise BagError(f"{bag} has no topic {', '.join(missing)}; it has {', '.join(found) or 'none'}")
    return {name: topic.values(name) for name, topic in found.items() if topics is None or name in topics}


@dataclass
class _Topic:
    """All messages of a topic, from whichever file."""

    schema: tuple[str, str, bytes]
    encoding: str
    parts: list[Messages] = field(default_factory=list)

    def values(self, topic: str) -> Any:
        name, encoding, text = self.schema
        if encoding != "ros2msg" or self.encoding != "cdr":
            raise BagError(f"{topic} is stored as {encoding}/{self.encoding}; only ros2msg/cdr is read here")
        schema = cdr.parse(name, text.decode("utf-8"))
        table = self._table(schema, topic)
        if table is not None:
            return table
        rows = []
        for part in self.parts:
            for log_time, publish_time, data in zip(part.log_times, part.publish_times, part.data, strict=True):
                message = schema.decode(data)
                message.log_time, message.publish_time = log_time, publish_time
                rows.append(message)
        return rows

    def _table(self, schema: cdr.Schema, topic: str) -> npt.NDArray[Any] | None:
        """All messages as one array; None if they have no common layout."""
        filled = [part for part in self.parts if len(part)] or self.parts[:1]
        found = [part.rows() for part in filled]
        rows = [part for part in found if part is not None]
        if len(rows) < len(found) or len({part.shape[1] for part in rows}) > 1:
            return None
        try:
            times = [part.times() for part in filled]
        except ValueError as error:
            raise BagError(f"{topic}: {error}") from error
        log_time, publish_time = (np.concatenate(each) for each in zip(*times, strict=True))
        return schema.table(np.concatenate(rows), log_time=log_time, publish_time=publish_time)
