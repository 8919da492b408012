"""Reading an MCAP file by framing its records once, from the first byte to the last.

It needs neither the index nor the summary, so what it finds is what is there. Source: the MCAP specification, version
0.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from rig_bag.contents import Contents, Messages
from rig_bag.errors import BagError
from rig_bag.mcap_framing import frame
from rig_bag.mcap_records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DAMAGE,
    DATA_END,
    FRAME_SIZE,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_FIXED,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    Cursor,
    frames,
    parse_chunk,
)

__all__ = ["check_begin", "read_file", "scan", "scan_bytes", "take"]

_frame = struct.Struct("<BQ").unpack_from
_message = struct.Struct("<BQHIQQ").unpack_from
_MESSAGE_HEAD = FRAME_SIZE + MESSAGE_FIXED


def scan(path: Path) -> Contents:
    """Read a whole file. What carries a checksum is checked against it.

    Raises
    ------
    BagError: no MCAP file, damaged, or not closed by its writer.
    """
    return scan_bytes(read_file(path), str(path))


def read_file(path: Path) -> bytes:
    """The bytes of a file that begins as an MCAP file does.

    Raises
    ------
    BagError: it cannot be read, or is something else.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror}") from error
    check_begin(data, str(path))
    return data


def scan_bytes(data: bytes, name: str) -> Contents:
    """As :func:`scan`, of bytes in memory; ``name`` is what an error calls them."""
    check_begin(data, name)
    contents = Contents()
    try:
        section = _data_section(data)
        chunks = [parse_chunk(data[a:b]).unpack(offset) for opcode, offset, a, b in section if opcode == CHUNK]
        framing = frame(data, section, chunks)
        number = 0
        for opcode, offset, start, end in section:
            if opcode == CHUNK:
                if framing is None:
                    _take_chunk(chunks[number], contents)
                else:
                    for kind, content in framing.others[number]:
                        take(kind, content, contents, offset)
                number += 1
            elif opcode == MESSAGE:
                _take_chunk(data[offset:end], contents)
            elif opcode != MESSAGE_INDEX:
                take(opcode, data[start:end], contents, offset)
        if framing is not None:
            contents.count = framing.count
            for identifier, places in framing.places.items():
                contents.channels[identifier].adopt(places)
        if not data.endswith(MAGIC):
            raise ValueError("its last bytes are missing")
    except DAMAGE as error:
        raise BagError(f"{name} is damaged: {error}") from error
    return contents


def check_begin(data: bytes, name: str) -> None:
    """Raise BagError if this is another kind of file."""
    if not data.startswith(MAGIC):
        kind = (
            "a ROS 1 bag"
            if data.startswith(b"#ROSBAG")
            else "an sqlite3 bag"
            if data[:6] == b"SQLite"
            else "no MCAP file"
        )
        raise BagError(f"{name} is {kind}; only MCAP bags are read here")


def _data_section(data: bytes) -> list[tuple[int, int, int, int]]:
    """The frames up to the end of the data, whose checksum comes first: nothing of what it covers is then in doubt."""
    found = []
    for record in frames(data, len(MAGIC)):
        opcode, offset, start, end = record
        if opcode == DATA_END:
            crc = int.from_bytes(data[start:end], "little") if end - start == 4 else -1
            if crc and zlib.crc32(memoryview(data)[:offset]) != crc:
                raise ValueError("its data does not match its checksum")
            return found
        found.append(record)
    raise ValueError("its end is missing: the recorder did not close it")


def _take_chunk(records: bytes, contents: Contents) -> None:
    position, size = 0, len(records)
    channels = contents.channels
    while position + FRAME_SIZE <= size:
        if records[position] == MESSAGE and position + _MESSAGE_HEAD <= size:
            _, length, identifier, _, log_time, publish_time = _message(records, position)
            end = position + FRAME_SIZE + length
            if end > size or length < MESSAGE_FIXED:
                raise ValueError("a message is longer than its chunk")
            data = records[position + _MESSAGE_HEAD : end]
            channels[identifier].append(log_time, publish_time, contents.count, data)
            contents.count += 1
        else:
            opcode, length = _frame(records, position)
            end = position + FRAME_SIZE + length
            if end > size:
                raise ValueError("a record is longer than its chunk")
            take(opcode, records[position + FRAME_SIZE : end], contents, position)
        position = end
    if position != size:
        raise ValueError("a chunk ends inside a record")


def take(opcode: int, content: bytes, contents: Contents, offset: int) -> None:
    """Put a record that is no message where it belongs; ``offset`` is where it is, for an error."""
    cursor = Cursor(content)
    if opcode == HEADER:
        contents.profile, contents.library = cursor.text(), cursor.text()
    elif opcode == SCHEMA:
        identifier = cursor.number(2)
        name, encoding = cursor.text(), cursor.text()
        contents.schemas[identifier] = (name, encoding, cursor.take(cursor.number(4)))
    elif opcode == CHANNEL:
        identifier, schema = cursor.number(2), cursor.number(2)
        topic, encoding = cursor.text(), cursor.text()
        contents.channels.setdefault(identifier, Messages(topic, schema, encoding, cursor.mapping()))
    elif opcode == ATTACHMENT:
        cursor.take(16)
        name, media_type = cursor.text(), cursor.text()
        data = cursor.take(cursor.number(8))
        crc = cursor.number(4)
        if crc and zlib.crc32(content[:-4]) != crc:
            raise ValueError(f"the attachment at byte {offset} does not match its checksum")
        contents.attachments.append((name, media_type, data))
    elif opcode == METADATA:
        contents.metadata.append((cursor.text(), cursor.mapping()))
