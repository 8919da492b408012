"""Takes everything that is still whole out of an MCAP file that was cut off, or damaged, anywhere.

A chunk counts if it matches its checksum; of a chunk that the end of the file cuts, the records that unpack count, and
are told apart, since no checksum covers them. After damage, the next chunk is found by its own bytes and checksum. A
file with chunks has no message outside of them: what looks like one is another record whose opcode is damaged.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import zstandard

from rig_bag.contents import Contents
from rig_bag.mcap_records import (
    CHANNEL,
    CHUNK,
    DAMAGE,
    DATA_END,
    FOOTER,
    FRAME_SIZE,
    MAGIC,
    MESSAGE,
    MESSAGE_FIXED,
    MESSAGE_INDEX,
    SCHEMA,
    Chunk,
    Cursor,
    frames,
    parse_chunk,
)
from rig_bag.mcap_scan import check_begin, take

__all__ = ["Loss", "Salvage", "salvage"]

_LAST_OPCODE = DATA_END
#: From the begin of a chunk's record to the name of its compression.
_TO_COMPRESSION = FRAME_SIZE + 8 + 8 + 8 + 4
_COMPRESSIONS = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
_message = struct.Struct("<HIQQ").unpack_from


@dataclass
class Loss:
    """A run of bytes of which nothing could be used."""

    start: int
    end: int
    why: str
    #: Messages recovered from before it.
    before: int = 0
    #: [ns] until when the lost messages went, if that is known.
    end_time: int | None = None
    #: By channel, if that is known.
    counts: dict[int, int] = field(default_factory=dict)


@dataclass
class Salvage:
    """What was recovered and what was not."""

    contents: Contents
    losses: list[Loss]
    #: Messages out of a cut chunk, which no checksum covers.
    unchecked: int = 0
    #: Messages that are whole, and whose topic's definition is lost.
    orphans: int = 0


@dataclass
class _Run:
    """Unpacked records, or a loss in their place."""

    records: bytes = b""
    loss: Loss | None = None
    checked: bool = True
    #: Whether it is certainly a chunk, whole or not, and no other record whose opcode is damaged.
    chunk: bool = False
    #: Where it is, if it is a message outside of the chunks.
    outside: tuple[int, int] | None = None


def salvage(data: bytes, name: str) -> Salvage:
    """Take out of a file's bytes what is whole; ``name`` is what an error calls them.

    Raises
    ------
    BagError: they do not begin as an MCAP file does.
    """
    check_begin(data, name)
    contents = Contents()
    runs = list(_runs(data, contents))
    if any(run.chunk for run in runs):
        runs = [_Run(loss=Loss(*run.outside, "damaged")) if run.outside is not None else run for run in runs]
    # Definitions first: the one that a message needs may be recovered only from the summary.
    for run in runs:
        for opcode, start, end in _whole_records(run.records):
            if opcode in (SCHEMA, CHANNEL):
                _try_take(opcode, run.records[start:end], contents)
    result = Salvage(contents, [])
    for run in runs:
        if run.loss is not None:
            run.loss.before = contents.count
            result.losses.append(run.loss)
        for opcode, start, end in _whole_records(run.records):
            if opcode != MESSAGE or end - start < MESSAGE_FIXED:
                continue
            identifier, _, log_time, publish_time = _message(run.records, start)
            channel = contents.channels.get(identifier)
            if channel is None or channel.schema not in contents.schemas:
                result.orphans += 1
                continue
            channel.append(log_time, publish_time, contents.count, run.records[start + MESSAGE_FIXED : end])
            contents.count += 1
            result.unchecked += not run.checked
    return result


def _runs(data: bytes, contents: Contents) -> Iterator[_Run]:
    """Go from record to record, over what is damaged; definitions outside of chunks go to ``contents``."""
    position, size, closed = len(MAGIC), len(data), False
    bad: Loss | None = None
    while position < size:
        opcode, end = _frame(data, position)
        if opcode is None:
            following = _next_chunk(data, position + 1, size)
            if following is None:
                begin, end_time = _cut_chunk(data[position:])
                yield _Run(begin, checked=False, chunk=_compressed(data, position))
                yield _Run(loss=Loss(position, size, "the file is cut", end_time=end_time))
                return
            yield _Run(loss=Loss(position, following, "damaged"))
            position = following
            continue
        content = data[position + FRAME_SIZE : end]
        if opcode == CHUNK:
            try:
                records = parse_chunk(content).unpack(position)
                yield _Run(records, chunk=bool(records))
                bad = None
            except DAMAGE as error:
                # Its length may be what is damaged: then the next chunk begins before the end that it claims.
                end = _next_chunk(data, position + 1, end) or end
                bad = Loss(position, end, str(error))
                yield _Run(loss=bad, chunk=_compressed(data, position))
        elif opcode == MESSAGE:
            yield _Run(data[position:end], outside=(position, end))
        elif opcode == MESSAGE_INDEX:
            if bad is not None:
                _note_index(content, bad)
        elif opcode == FOOTER:
            return
        else:
            closed = closed or opcode == DATA_END
            _try_take(opcode, content, contents)
        position = end
    if not closed:
        yield _Run(loss=Loss(size, size, "the recorder did not close the file: what it had not written yet"))


def _compressed(data: bytes, position: int) -> bool:
    """Whether the record here says where a chunk does how it is compressed."""
    return data.startswith(_COMPRESSIONS, position + _TO_COMPRESSION)


def _frame(data: bytes, position: int) -> tuple[int | None, int]:
    """Opcode and end of the record here; no opcode if there is none, or not all of it."""
    if position + FRAME_SIZE > len(data):
        return None, position
    opcode, length = struct.unpack_from("<BQ", data, position)
    end = position + FRAME_SIZE + length
    if not 0 < opcode <= _LAST_OPCODE or end > len(data):
        return None, position
    return opcode, end


def _next_chunk(data: bytes, start: int, stop: int) -> int | None:
    """Where the first chunk begins, from ``start`` on and before ``stop``, that is there in full and undamaged."""
    places = sorted(
        place - _TO_COMPRESSION
        for compression in _COMPRESSIONS
        for place in _find_all(data, compression, start + _TO_COMPRESSION, stop)
    )
    for place in places:
        opcode, end = _frame(data, place)
        if opcode != CHUNK:
            continue
        try:
            chunk = parse_chunk(data[place + FRAME_SIZE : end])
            chunk.unpack(place)
        except DAMAGE:
            continue
        if chunk.crc:
            return place
    return None


def _find_all(data: bytes, pattern: bytes, start: int, stop: int) -> Iterator[int]:
    place = data.find(pattern, start)
    while place >= 0 and place - _TO_COMPRESSION < stop:
        yield place
        place = data.find(pattern, place + 1)


def _cut_chunk(record: bytes) -> tuple[bytes, int | None]:
    """What unpacks of a chunk whose end is missing, and its last time if that is there; nothing if this is no chunk."""
    if record[:1] != bytes([CHUNK]):
        return b"", None
    try:
        chunk = parse_chunk(record[FRAME_SIZE:], whole=False)
    except DAMAGE:
        return b"", None
    return _unpack_begin(chunk), chunk.end_time


def _unpack_begin(chunk: Chunk) -> bytes:
    if chunk.compression == "":
        return chunk.packed
    if chunk.compression != "zstd":
        return b""
    try:
        # Compression goes by blocks of up to 128 KiB; those that are whole unpack.
        return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.packed)
    except DAMAGE:
        return b""


def _whole_records(records: bytes) -> Iterator[tuple[int, int, int]]:
    try:
        for opcode, _, start, end in frames(records):
            yield opcode, start, end
    except ValueError:
        return


def _try_take(opcode: int, content: bytes, contents: Contents) -> None:
    try:
        take(opcode, content, contents, 0)
    except DAMAGE:
        # An attachment or a definition that is damaged is left out; the messages are worth more.
        return


def _note_index(content: bytes, loss: Loss) -> None:
    """The index of a damaged chunk still says what was in it."""
    try:
        cursor = Cursor(content)
        channel = cursor.number(2)
        entries = list(struct.iter_unpack("<QQ", cursor.take(cursor.number(4))))
    except DAMAGE:
        return
    loss.counts[channel] = loss.counts.get(channel, 0) + len(entries)
    loss.end_time = max([loss.end_time or 0, *(log_time for log_time, _ in entries)])
