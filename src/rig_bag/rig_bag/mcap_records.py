"""What every reader and writer of MCAP files here shares: the records' numbers, their framing, and unpacking a chunk.

A record is an opcode (1 byte), the length of its content (8 bytes), its content. Whatever is wrong with the bytes is
raised as one of :data:`DAMAGE`. Source: the MCAP specification, version 0.
"""

from __future__ import annotations

import struct
import threading
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import zstandard

try:
    import lz4.frame  # type: ignore[import-untyped]
except ImportError:
    lz4 = None

__all__ = ["DAMAGE", "MAGIC", "Chunk", "Cursor", "frames", "parse_chunk"]

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = range(1, 7)
MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS = range(7, 12)
METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(12, 16)

#: What reading damaged bytes raises.
DAMAGE = (ValueError, KeyError, IndexError, struct.error, zstandard.ZstdError)

#: Bytes of a record before its content, and of a message's content before its data.
FRAME_SIZE = 9
MESSAGE_FIXED = 22

#: A chunk that claims to be larger than this when unpacked is taken for damage.
_CHUNK_LIMIT = 1 << 30

_frame = struct.Struct("<BQ").unpack_from
_of_thread = threading.local()


class Cursor:
    """Takes values off the front of one record's content."""

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
        inner = Cursor(self.take(self.number(4)))
        result = {}
        while not inner.at_end:
            key = inner.text()
            result[key] = inner.text()
        return result

    @property
    def left(self) -> int:
        """Bytes that have not been taken."""
        return len(self._data) - self._position

    @property
    def at_end(self) -> bool:
        return self.left <= 0


def frames(data: bytes, start: int = 0, stop: int | None = None) -> Iterator[tuple[int, int, int, int]]:
    """Yield (opcode, offset of the record, start and end of its content) of the records from ``start`` to ``stop``."""
    position = start
    size = len(data) if stop is None else stop
    while position < size:
        if position + FRAME_SIZE > size:
            raise ValueError(f"cut off at byte {size}")
        opcode, length = _frame(data, position)
        end = position + FRAME_SIZE + length
        if end > size:
            raise ValueError(f"the record at byte {position} is cut off, or its length is damaged")
        yield opcode, position, position + FRAME_SIZE, end
        position = end


class Chunk(NamedTuple):
    """A chunk record, still packed. Times in nanoseconds."""

    start_time: int
    end_time: int
    size: int
    crc: int
    compression: str
    packed: bytes

    def unpack(self, offset: int) -> bytes:
        """Its records, checked against its checksum if it has one; ``offset`` is where it is, for the message."""
        if self.size > _CHUNK_LIMIT:
            raise ValueError(f"the chunk at byte {offset} claims {self.size} bytes")
        if self.compression == "zstd":
            # The frame says its size too: a damaged one must not make us ask for that much memory.
            if zstandard.frame_content_size(self.packed) not in (-1, self.size):
                raise ValueError(f"the chunk at byte {offset} does not have the size that it claims")
            records = _decompressor().decompress(self.packed, max_output_size=max(self.size, 1))
        elif self.compression == "lz4":
            records = _unpack_lz4(self.packed)
        elif self.compression == "":
            records = self.packed
        else:
            raise ValueError(
                f"the chunk at byte {offset} is compressed with {self.compression!r}, which is not known here"
            )
        if len(records) != self.size or (self.crc and zlib.crc32(records) != self.crc):
            raise ValueError(f"the chunk at byte {offset} does not match its checksum")
        return records


def _decompressor() -> zstandard.ZstdDecompressor:
    """One for each thread: made for each chunk, it would cost as much as unpacking it."""
    if not hasattr(_of_thread, "decompressor"):
        _of_thread.decompressor = zstandard.ZstdDecompressor()
    return _of_thread.decompressor  # type: ignore[no-any-return]


def parse_chunk(content: bytes, *, whole: bool = True) -> Chunk:
    """The chunk that a record holds; with ``whole=False``, of a cut one, whose packed records are what is there."""
    cursor = Cursor(content)
    start_time, end_time, size, crc = cursor.number(8), cursor.number(8), cursor.number(8), cursor.number(4)
    compression, length = cursor.text(), cursor.number(8)
    if not whole:
        length = min(length, cursor.left)
    return Chunk(start_time, end_time, size, crc, compression, cursor.take(length))


def _unpack_lz4(packed: bytes) -> bytes:
    if lz4 is None:
        raise ValueError("its chunks are compressed with lz4, and the package lz4 is not installed")
    try:
        return bytes(lz4.frame.decompress(packed))
    except RuntimeError as error:
        raise ValueError(str(error)) from error
