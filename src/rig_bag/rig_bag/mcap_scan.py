"""Reading an MCAP file by framing its records once, from the first byte to the last.

It needs neither the index nor the summary, so what it finds is what is there. Source: the MCAP specification, version
0.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import zstandard

try:
    import lz4.frame  # type: ignore[import-untyped]
except ImportError:
    lz4 = None

from rig_bag.errors import BagError
from rig_bag.mcap_file import MAGIC

__all__ = ["Contents", "Messages", "scan"]

_frame = struct.Struct("<BQ").unpack_from
_message = struct.Struct("<BQHIQQ").unpack_from
_MESSAGE_HEAD = 9 + 22
_MESSAGE, _CHUNK, _DATA_END = 5, 6, 15
#: A chunk that claims to be larger than this when unpacked is taken for damage.
_CHUNK_LIMIT = 1 << 30


@dataclass
class Messages:
    """The messages of one channel, in the order of the file."""

    topic: str
    schema: int
    encoding: str
    metadata: dict[str, str]
    log_times: list[int] = field(default_factory=list)
    publish_times: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)
    #: how many messages stand before each in the file, of all channels
    order: list[int] = field(default_factory=list)


@dataclass
class Contents:
    """What a file holds."""

    profile: str = ""
    #: messages in all
    count: int = 0
    library: str = ""
    #: identifier -> (name, encoding, data)
    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    channels: dict[int, Messages] = field(default_factory=dict)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    #: (name, media type, data)
    attachments: list[tuple[str, str, bytes]] = field(default_factory=list)


class _Cursor:
    """Takes values off the front of one record."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def take(self, size: int) -> bytes:
        start, self._position = self._position, self._position + size
        if self._position > len(self._data):
            raise ValueError("a record is shorter than its contents")
        return self._data[start : self._position]

    def text(self) -> str:
        return self.take(self.number(4)).decode("utf-8")

    def mapping(self) -> dict[str, str]:
        inner = _Cursor(self.take(self.number(4)))
        result = {}
        while inner._position < len(inner._data):
            key = inner.text()
            result[key] = inner.text()
        return result


def _records(data: bytes, start: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield (opcode, offset of the record, start and end of its content)."""
    position, size = start, len(data)
    while position < size:
        if position + 9 > size:
            raise ValueError(f"cut off at byte {size}")
        opcode, length = _frame(data, position)
        end = position + 9 + length
        if end > size:
            raise ValueError(f"the record at byte {position} is cut off, or its length is damaged")
        yield opcode, position, position + 9, end
        position = end


def scan(path: Path) -> Contents:
    """Read a whole file. Every chunk and attachment that carries a CRC is checked against it.

    Raises
    ------
    BagError: no MCAP file, damaged, or not closed by its writer.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror}") from error
    if not data.startswith(MAGIC):
        kind = (
            "a ROS 1 bag"
            if data.startswith(b"#ROSBAG")
            else "an sqlite3 bag"
            if data[:6] == b"SQLite"
            else "no MCAP file"
        )
        raise BagError(f"{path} is {kind}; only MCAP bags are read here")
    contents = Contents()
    try:
        if not _scan(data, contents):
            raise ValueError("its end is missing: the recorder did not close it")
        if not data.endswith(MAGIC):
            raise ValueError("its last bytes are missing")
    except (ValueError, KeyError, IndexError, UnicodeDecodeError, struct.error, zstandard.ZstdError) as error:
        raise BagError(f"{path} is damaged: {error}") from error
    return contents


def _scan(data: bytes, contents: Contents) -> bool:
    """Fill ``contents`` from the data section; whether that section is ended properly."""
    for opcode, offset, start, end in _records(data, len(MAGIC)):
        if opcode == _CHUNK:
            _take_chunk(_unpack_chunk(data[start:end], offset), contents)
        elif opcode == _MESSAGE:
            _take_chunk(data[offset:end], contents)
        elif opcode == _DATA_END:
            return True
        else:
            _take(opcode, data[start:end], contents, offset)
    return False


def _unpack_chunk(content: bytes, offset: int) -> bytes:
    cursor = _Cursor(content)
    cursor.take(16)
    size, crc, compression = cursor.number(8), cursor.number(4), cursor.text()
    packed = cursor.take(cursor.number(8))
    if size > _CHUNK_LIMIT:
        raise ValueError(f"the chunk at byte {offset} claims {size} bytes")
    if compression == "zstd":
        records = zstandard.ZstdDecompressor().decompress(packed, max_output_size=max(size, 1))
    elif compression == "lz4":
        records = _unpack_lz4(packed)
    elif compression == "":
        records = packed
    else:
        raise ValueError(f"the chunk at byte {offset} is compressed with {compression!r}, which is not known here")
    if len(records) != size or (crc and zlib.crc32(records) != crc):
        raise ValueError(f"the chunk at byte {offset} does not match its checksum")
    return records


def _unpack_lz4(packed: bytes) -> bytes:
    if lz4 is None:
        raise ValueError("its chunks are compressed with lz4, and the package lz4 is not installed")
    try:
        return bytes(lz4.frame.decompress(packed))
    except RuntimeError as error:
        raise ValueError(str(error)) from error


def _take_chunk(records: bytes, contents: Contents) -> None:
    position, size = 0, len(records)
    channels = contents.channels
    while position + 9 <= size:
        if records[position] == _MESSAGE and position + _MESSAGE_HEAD <= size:
            _, length, identifier, _, log_time, publish_time = _message(records, position)
            end = position + 9 + length
            if end > size or length < 22:
                raise ValueError("a message is longer than its chunk")
            channel = channels[identifier]
            channel.log_times.append(log_time)
            channel.publish_times.append(publish_time)
            channel.order.append(contents.count)
            contents.count += 1
            channel.data.append(records[position + _MESSAGE_HEAD : end])
        else:
            opcode, length = _frame(records, position)
            end = position + 9 + length
            if end > size:
                raise ValueError("a record is longer than its chunk")
            _take(opcode, records[position + 9 : end], contents, position)
        position = end
    if position != size:
        raise ValueError("a chunk ends inside a record")


def _take(opcode: int, content: bytes, contents: Contents, offset: int) -> None:
    cursor = _Cursor(content)
    if opcode == 1:
        contents.profile, contents.library = cursor.text(), cursor.text()
    elif opcode == 3:
        identifier = cursor.number(2)
        name, encoding = cursor.text(), cursor.text()
        contents.schemas[identifier] = (name, encoding, cursor.take(cursor.number(4)))
    elif opcode == 4:
        identifier, schema = cursor.number(2), cursor.number(2)
        topic, encoding = cursor.text(), cursor.text()
        contents.channels.setdefault(identifier, Messages(topic, schema, encoding, cursor.mapping()))
    elif opcode == 9:
        cursor.take(16)
        name, media_type = cursor.text(), cursor.text()
        data = cursor.take(cursor.number(8))
        crc = cursor.number(4)
        if crc and zlib.crc32(content[:-4]) != crc:
            raise ValueError(f"the attachment at byte {offset} does not match its checksum")
        contents.attachments.append((name, media_type, data))
    elif opcode == 12:
        contents.metadata.append((cursor.text(), cursor.mapping()))
