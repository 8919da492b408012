"""Checks one MCAP file from its bytes: that what it says of itself, in its indexes and in its summary, is so.

:mod:`rig_bag.mcap_scan` needs neither; other readers rely on both. Source: the MCAP specification, version 0.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from rig_bag.contents import Contents
from rig_bag.errors import BagError
from rig_bag.mcap_records import (
    ATTACHMENT,
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DAMAGE,
    DATA_END,
    FOOTER,
    FRAME_SIZE,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
    SUMMARY_OFFSET,
    Cursor,
    frames,
    parse_chunk,
)
from rig_bag.mcap_scan import scan_bytes

__all__ = ["Audit", "audit"]

_FOOTER_SIZE = FRAME_SIZE + 20
_message = struct.Struct("<HIQ").unpack_from


@dataclass
class Audit:
    """What was found in one file. Each list holds problems as sentences; empty: all is well.

    Attributes
    ----------
    contents: None if the file cannot be read at all; ``structure`` says why, and the rest is unchecked.
    checksums: parts of the file that carry a checksum, by kind; all of them match.
    bare: parts that could carry one and do not.
    """

    contents: Contents | None = None
    structure: list[str] = field(default_factory=list)
    index: list[str] = field(default_factory=list)
    summary: list[str] = field(default_factory=list)
    checksums: Counter[str] = field(default_factory=Counter)
    bare: Counter[str] = field(default_factory=Counter)


@dataclass
class _Section:
    """Records as they describe each other: found in the data, or claimed by the summary."""

    schemas: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    channels: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    chunks: list[tuple[Any, ...]] = field(default_factory=list)
    attachments: list[tuple[Any, ...]] = field(default_factory=list)
    metadata: list[tuple[Any, ...]] = field(default_factory=list)


def audit(data: bytes, name: str) -> Audit:
    """Check the bytes of a file; ``name`` is what messages call it."""
    result = Audit()
    try:
        result.contents = scan_bytes(data, name)
        found, end = _walk_data(data, result)
    except BagError as error:
        result.structure.append(str(error))
        return result
    except DAMAGE as error:
        result.contents = None
        result.structure.append(f"{name} is damaged: {error}")
        return result
    try:
        _check_summary(data, end, found, result)
    except DAMAGE as error:
        result.summary.append(f"the summary of {name} is damaged: {error}")
    return result


# -- the data section ------------------------------------------------------------------------------------------------


class _ChunkSeen:
    """One chunk, and the index records that follow it."""

    def __init__(self, content: bytes, offset: int, length: int, section: _Section) -> None:
        self.chunk = parse_chunk(content)
        self.offset, self.length = offset, length
        self.messages: dict[int, list[tuple[int, int]]] = {}
        self.indexes: dict[int, int] = {}
        self.index_length = 0
        records = self.chunk.unpack(offset)
        for opcode, at, start, end in frames(records):
            if opcode == MESSAGE:
                channel, _, log_time = _message(records, start)
                self.messages.setdefault(channel, []).append((log_time, at))
            else:
                _describe(opcode, records[start:end], section)

    def take_index(self, content: bytes, offset: int, length: int, problems: list[str]) -> None:
        cursor = Cursor(content)
        channel = cursor.number(2)
        body = cursor.take(cursor.number(4))
        claimed = sorted(struct.iter_unpack("<QQ", body))
        if claimed != sorted(self.messages.get(channel, [])):
            problems.append(f"the index at byte {offset} does not match channel {channel} of the chunk before it")
        self.indexes[channel] = offset
        self.index_length += length

    def finish(self, section: _Section, problems: list[str]) -> None:
        chunk = self.chunk
        missing = sorted(set(self.messages) - set(self.indexes))
        if missing:
            problems.append(f"the chunk at byte {self.offset} has no index of channels {missing}")
        times = [log_time for entries in self.messages.values() for log_time, _ in entries]
        if times and (min(times), max(times)) != (chunk.start_time, chunk.end_time):
            problems.append(f"the chunk at byte {self.offset} claims other times than its messages have")
        section.chunks.append(
            (
                *(chunk.start_time, chunk.end_time, self.offset, self.length, self.indexes, self.index_length),
                *(chunk.compression, len(chunk.packed), chunk.size),
            )
        )


def _walk_data(data: bytes, result: Audit) -> tuple[_Section, int]:
    """What is in the data section, and where that ends; indexes are checked on the way."""
    section = _Section()
    current: _ChunkSeen | None = None
    for opcode, offset, start, end in frames(data, len(MAGIC)):
        if opcode == MESSAGE_INDEX and current is not None:
            current.take_index(data[start:end], offset, end - offset, result.index)
            continue
        if current is not None:
            current.finish(section, result.index)
            current = None
        content = data[start:end]
        if opcode == CHUNK:
            current = _ChunkSeen(content, offset, end - offset, section)
            (result.checksums if current.chunk.crc else result.bare)["chunks"] += 1
        elif opcode == MESSAGE_INDEX:
            result.index.append(f"the index at byte {offset} follows no chunk")
        elif opcode == ATTACHMENT:
            cursor = Cursor(content)
            times = cursor.number(8), cursor.number(8)
            name, media_type, size = cursor.text(), cursor.text(), cursor.number(8)
            section.attachments.append((offset, end - offset, *times, size, name, media_type))
            (result.checksums if any(content[-4:]) else result.bare)["attachments"] += 1
        elif opcode == METADATA:
            section.metadata.append((offset, end - offset, Cursor(content).text()))
        elif opcode == DATA_END:
            (result.checksums if any(content) else result.bare)["data section"] += 1
            return section, end
        else:
            _describe(opcode, content, section)
    raise ValueError("its end is missing")


def _describe(opcode: int, content: bytes, section: _Section) -> None:
    """Note a schema or a channel."""
    if opcode == SCHEMA:
        section.schemas[int.from_bytes(content[:2], "little")] = (content,)
    elif opcode == CHANNEL:
        section.channels[int.from_bytes(content[:2], "little")] = (content,)


# -- the summary -----------------------------------------------------------------------------------------------------


def _check_summary(data: bytes, start: int, found: _Section, result: Audit) -> None:
    footer = len(data) - len(MAGIC) - _FOOTER_SIZE
    opcode, length = struct.unpack_from("<BQ", data, max(footer, 0))
    if footer < start or (opcode, length) != (FOOTER, 20):
        raise ValueError("it does not end with a footer")
    summary_start, offset_start, crc = struct.unpack_from("<QQI", data, footer + FRAME_SIZE)
    if summary_start == 0:
        result.summary.append("there is no summary: other readers have to read the whole file")
        return
    if summary_start != start:
        raise ValueError(f"the footer says that it begins at byte {summary_start}; the data ends at {start}")
    if crc and zlib.crc32(memoryview(data)[start : footer + FRAME_SIZE + 16]) != crc:
        raise ValueError("it does not match its checksum")
    (result.checksums if crc else result.bare)["summary"] += 1
    claimed, statistics, groups = _Section(), None, {}
    stop = offset_start or footer
    for opcode, offset, begin, end in frames(data, start, stop):
        content = data[begin:end]
        first, size = groups.get(opcode, (offset, 0))
        groups[opcode] = (first, size + end - offset)
        if opcode == STATISTICS:
            statistics = _statistics(content)
        else:
            _claim(opcode, content, claimed)
    said = [
        struct.unpack_from("<BQQ", data, begin)
        for opcode, _, begin, _ in frames(data, stop, footer)
        if opcode == SUMMARY_OFFSET
    ]
    if said and sorted(said) != sorted((opcode, *place) for opcode, place in groups.items()):
        result.summary.append("its table of groups does not match the groups")
    for kind in ("schemas", "channels", "chunks", "attachments", "metadata"):
        have, says = getattr(found, kind), getattr(claimed, kind)
        if have != says:
            result.summary.append(f"it says of {len(says)} {kind}, and the data of {len(have)}, what does not agree")
    assert result.contents is not None
    if statistics is None:
        result.summary.append("there are no statistics")
    elif statistics != _count(result.contents, found):
        result.summary.append("the statistics do not match the data")


def _claim(opcode: int, content: bytes, section: _Section) -> None:
    cursor = Cursor(content)
    if opcode == CHUNK_INDEX:
        start_time, end_time, offset, length = (cursor.number(8) for _ in range(4))
        indexes = dict(struct.iter_unpack("<HQ", cursor.take(cursor.number(4))))
        index_length, compression = cursor.number(8), cursor.text()
        sizes = cursor.number(8), cursor.number(8)
        section.chunks.append((start_time, end_time, offset, length, indexes, index_length, compression, *sizes))
    elif opcode == ATTACHMENT_INDEX:
        numbers = [cursor.number(8) for _ in range(5)]
        section.attachments.append((*numbers, cursor.text(), cursor.text()))
    elif opcode == METADATA_INDEX:
        section.metadata.append((cursor.number(8), cursor.number(8), cursor.text()))
    else:
        _describe(opcode, content, section)


def _statistics(content: bytes) -> tuple[Any, ...]:
    cursor = Cursor(content)
    numbers = [cursor.number(size) for size in (8, 2, 4, 4, 4, 4, 8, 8)]
    return (*numbers, dict(struct.iter_unpack("<HQ", cursor.take(cursor.number(4)))))


def _count(contents: Contents, found: _Section) -> tuple[Any, ...]:
    times = [time for channel in contents.channels.values() for time in channel.log_times]
    return (
        contents.count,
        len(found.schemas),
        len(found.channels),
        *(len(found.attachments), len(found.metadata), len(found.chunks)),
        *(min(times, default=0), max(times, default=0)),
        {identifier: len(channel) for identifier, channel in contents.channels.items() if len(channel)},
    )
