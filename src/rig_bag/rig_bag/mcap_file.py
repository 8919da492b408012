"""A writer of MCAP files that survives a full disk.

Layout: magic, header, then chunks (each a compressed run of schema, channel and message records, followed by one index
record a channel), attachments and metadata, a checksum of all this, a summary that repeats and indexes it, footer,
magic. Whatever reaches the file is a whole number of records, and an indexed piece can be taken back off its end; so
a file that ran out of space is cut at the last whole chunk and still gets its summary. The hot path is
:meth:`McapFile.write`: two appends to one buffer.
Source: the MCAP specification, version 0 (little endian throughout; a string is a length of 32 bits and UTF-8).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import zstandard

from rig_bag.mcap_pieces import Piece, Pieces
from rig_bag.mcap_records import (
    ATTACHMENT,
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_FIXED,
    MESSAGE_INDEX,
    METADATA,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
    SUMMARY_OFFSET,
)

__all__ = ["Channel", "Declarations", "McapFile"]

_pack_message = struct.Struct("<BQHIQQ").pack
_pack_index = struct.Struct("<QQ").pack


def _record(opcode: int, *parts: bytes) -> bytes:
    content = b"".join(parts)
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(value: str) -> bytes:
    data = value.encode("utf-8")
    return struct.pack("<I", len(data)) + data


def _map(mapping: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in mapping.items())
    return struct.pack("<I", len(data)) + data


class Channel:
    """One topic of the file."""

    __slots__ = ("count", "id", "index", "topic")

    def __init__(self, identifier: int, topic: str) -> None:
        self.id = identifier
        self.topic = topic
        #: messages taken so far
        self.count = 0
        self.index = bytearray()


@dataclass
class Declarations:
    """What a file declares before it is used: the records of its schemas and channels, and the channels themselves."""

    schemas: list[bytes] = field(default_factory=list)
    channel_records: list[bytes] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)


class McapFile:
    """Writes one file. Every method that touches the disk raises ``OSError`` and then leaves the file cut at its last
    whole record; after that only :meth:`finish`, :meth:`drop` and :meth:`close` make sense.

    ``declared``: the declarations of the file that this one continues, whose channels are then good for this one.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        chunk_size: int = 64 * 1024,
        level: int = 1,
        library: str = "rig_bag",
        declared: Declarations | None = None,
    ) -> None:
        self.path = Path(path)
        self._chunk_size = chunk_size
        self._compressor = zstandard.ZstdCompressor(level=level)
        self._fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._size = 0
        self._crc = 0
        self._buffer = bytearray()
        self.declared = declared or Declarations()
        self._buffer += b"".join(self.declared.schemas + self.declared.channel_records)
        self._pieces = Pieces(self.path.parent)
        self._start = -1
        self._end = 0
        try:
            self._append(MAGIC + _record(HEADER, _text("ros2"), _text(library)))
        except OSError:
            self.close()
            raise

    # -- description -------------------------------------------------------------------------------------------------

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a message type; returns its identifier."""
        identifier = len(self.declared.schemas) + 1
        record = _record(
            SCHEMA, struct.pack("<H", identifier), _text(name), _text(encoding), struct.pack("<I", len(data)), data
        )
        self.declared.schemas.append(record)
        self._buffer += record
        return identifier

    def add_channel(self, topic: str, schema: int, encoding: str, metadata: Mapping[str, str]) -> Channel:
        """Declare a topic."""
        channel = Channel(len(self.declared.channels) + 1, topic)
        record = _record(CHANNEL, struct.pack("<HH", channel.id, schema), _text(topic), _text(encoding), _map(metadata))
        self.declared.channels.append(channel)
        self.declared.channel_records.append(record)
        self._buffer += record
        return channel

    # -- data --------------------------------------------------------------------------------------------------------

    def write(self, channel: Channel, data: bytes, log_time: int, publish_time: int) -> None:
        """Append one message; times in nanoseconds since the epoch, 0 <= t < 2**64."""
        buffer = self._buffer
        count = channel.count
        channel.index += _pack_index(log_time, len(buffer))
        buffer += _pack_message(
            MESSAGE, MESSAGE_FIXED + len(data), channel.id, count & 0xFFFFFFFF, log_time, publish_time
        )
        buffer += data
        channel.count = count + 1
        if log_time > self._end:  # noqa: PLR1730 (a call for each message would cost more)
            self._end = log_time
        if log_time < self._start or self._start < 0:
            self._start = log_time
        if len(buffer) >= self._chunk_size:
            self.flush()

    def flush(self) -> None:
        """Compress what is buffered into a chunk and hand it to the operating system."""
        raw = self._buffer
        if self._start < 0:
            # Topics that have no message yet: a chunk without messages would have no times.
            self._buffer = bytearray()
            self._append(bytes(raw))
            return
        start_time, end_time = self._start, self._end
        indexed = [channel for channel in self.declared.channels if channel.index]
        counts = {channel.id: len(channel.index) // 16 for channel in indexed}
        data = self._compressor.compress(raw)
        chunk = _record(
            CHUNK,
            struct.pack("<QQQI", start_time, end_time, len(raw), zlib.crc32(raw)),
            _text("zstd"),
            struct.pack("<Q", len(data)),
            data,
        )
        records = [chunk]
        offsets = bytearray()
        position = self._size + len(chunk)
        for channel in indexed:
            index = bytes(channel.index)
            offsets += struct.pack("<HQ", channel.id, position)
            record = _record(MESSAGE_INDEX, struct.pack("<HI", channel.id, len(index)), index)
            records.append(record)
            position += len(record)
            channel.index = bytearray()
        summary = _record(
            CHUNK_INDEX,
            struct.pack("<QQQQ", start_time, end_time, self._size, len(chunk)),
            struct.pack("<I", len(offsets)),
            bytes(offsets),
            struct.pack("<Q", position - self._size - len(chunk)),
            _text("zstd"),
            struct.pack("<QQ", len(data), len(raw)),
        )
        # Cleared before the write: a chunk that the disk refuses must not be tried again with the next one.
        self._buffer = bytearray()
        self._start, self._end = -1, 0
        self._add_piece(CHUNK_INDEX, records, summary, start_time, end_time, counts)

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Write a metadata record (a name and a map of strings)."""
        record = _record(METADATA, _text(name), _map(mapping))
        summary = _record(METADATA_INDEX, struct.pack("<QQ", self._size, len(record)), _text(name))
        self._add_piece(METADATA_INDEX, [record], summary)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time: int, create_time: int) -> None:
        """Write a file into the file."""
        content = struct.pack("<QQ", log_time, create_time) + _text(name) + _text(media_type)
        content += struct.pack("<Q", len(data)) + data
        record = _record(ATTACHMENT, content, struct.pack("<I", zlib.crc32(content)))
        summary = _record(
            ATTACHMENT_INDEX,
            struct.pack("<QQQQQ", self._size, len(record), log_time, create_time, len(data)),
            _text(name),
            _text(media_type),
        )
        self._add_piece(ATTACHMENT_INDEX, [record], summary)

    # -- what is in it -----------------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Bytes in the file, without what is buffered."""
        return self._size

    def times(self) -> tuple[int, int]:
        """First and last log time of the chunks in the file; (0, 0) if it has none."""
        chunks = [piece for piece in self._pieces if piece.opcode == CHUNK_INDEX]
        if not chunks:
            return 0, 0
        return min(piece.start_time for piece in chunks), max(piece.end_time for piece in chunks)

    def counts(self) -> dict[str, int]:
        """Messages of each topic that are in the file, in the order of the channels."""
        totals = dict.fromkeys((channel.id for channel in self.declared.channels), 0)
        for piece in self._pieces:
            for identifier, count in piece.counts.items():
                totals[identifier] += count
        return {channel.topic: totals[channel.id] for channel in self.declared.channels}

    # -- the end -----------------------------------------------------------------------------------------------------

    def drop(self) -> bool:
        """Take the last chunk (and what follows it) back off the file, to make room. False if there is none."""
        if not any(piece.opcode == CHUNK_INDEX for piece in self._pieces):
            return False
        while True:
            piece = self._pieces.pop()
            self._cut(piece.offset)
            self._crc = piece.crc
            if piece.opcode == CHUNK_INDEX:
                return True

    def finish(self) -> None:
        """Write the summary and the footer. May be repeated after :meth:`drop`; what is buffered is not written."""
        data_end, crc = self._size, self._crc
        body = _record(DATA_END, struct.pack("<I", crc))
        start = data_end + len(body)
        totals = self.counts()
        counts = {channel.id: totals[channel.topic] for channel in self.declared.channels}
        opcodes = [piece.opcode for piece in self._pieces]
        pairs = b"".join(struct.pack("<HQ", identifier, count) for identifier, count in counts.items() if count)
        statistics = _record(
            STATISTICS,
            struct.pack(
                "<QHIIIIQQ",
                sum(counts.values()),
                len(self.declared.schemas),
                len(self.declared.channels),
                opcodes.count(ATTACHMENT_INDEX),
                opcodes.count(METADATA_INDEX),
                opcodes.count(CHUNK_INDEX),
                *self.times(),
            ),
            struct.pack("<I", len(pairs)),
            pairs,
        )
        groups: list[tuple[int, list[bytes]]] = [
            (SCHEMA, self.declared.schemas),
            (CHANNEL, self.declared.channel_records),
            (STATISTICS, [statistics]),
        ]
        groups += [
            (kind, [piece.summary for piece in self._pieces if piece.opcode == kind])
            for kind in (CHUNK_INDEX, ATTACHMENT_INDEX, METADATA_INDEX)
        ]
        summary = b""
        offsets = b""
        for opcode, records in groups:
            group = b"".join(records)
            if group:
                offsets += _record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start + len(summary), len(group)))
            summary += group
        offset_start = start + len(summary)
        summary += offsets + struct.pack("<BQQQ", FOOTER, 20, start, offset_start)
        try:
            self._append(body + summary + struct.pack("<I", zlib.crc32(summary)) + MAGIC)
        finally:
            # Further records, and a summary written again, would go where the data ends.
            self._size, self._crc = data_end, crc

    def sync(self) -> None:
        """Have the operating system put the file on the disk."""
        os.fdatasync(self._fd)

    def close(self) -> None:
        """Close the file as it is; idempotent."""
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            os.close(fd)

    # -- bytes -------------------------------------------------------------------------------------------------------

    def _add_piece(
        self,
        opcode: int,
        records: list[bytes],
        summary: bytes,
        start_time: int = 0,
        end_time: int = 0,
        counts: dict[int, int] | None = None,
    ) -> None:
        piece = Piece(opcode, self._size, self._crc, start_time, end_time, counts or {}, summary)
        self._append(b"".join(records))
        try:
            self._pieces.append(piece)
        except OSError:
            self._cut(piece.offset)
            self._crc = piece.crc
            raise

    def _append(self, data: bytes) -> None:
        if self._fd < 0:
            raise ValueError(f"{self.path} is closed")
        view = memoryview(data)
        position = self._size
        try:
            while view:
                written = os.pwrite(self._fd, view, position)
                position += written
                view = view[written:]
        except OSError:
            self._cut(self._size)
            raise
        self._size = position
        self._crc = zlib.crc32(data, self._crc)

    def _cut(self, size: int) -> None:
        os.ftruncate(self._fd, size)
        self._size = size
