"""What a file of any length has to remember of its pieces until its summary is written: on the disk, not in memory.

The list lies in a nameless file beside the bag, which goes with the list, or with the process, however that ends. It
can be read as long as it is there, also after the bag has been closed.
"""

from __future__ import annotations

import errno
import os
import struct
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

_HEAD = struct.Struct("<BQIQQHI")
_COUNT = struct.Struct("<HI")
_LENGTH = struct.Struct("<I")


@dataclass
class Piece:
    """A run of whole records in the file, and what the summary says of it."""

    opcode: int
    #: its first byte, and the CRC-32 of the file up to there
    offset: int
    crc: int
    start_time: int
    end_time: int
    #: messages of each channel
    counts: dict[int, int]
    #: the summary's record
    summary: bytes


class Pieces:
    """A list that grows and shrinks at its end."""

    def __init__(self, directory: Path) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(dir=directory, buffering=0)  # noqa: SIM115 (as long as the list)
        self._size = 0

    def append(self, piece: Piece) -> None:
        """Add one at the end.

        Raises
        ------
        OSError: there is no room; the list is as it was.
        """
        data = _HEAD.pack(
            piece.opcode,
            piece.offset,
            piece.crc,
            piece.start_time,
            piece.end_time,
            len(piece.counts),
            len(piece.summary),
        )
        data += b"".join(_COUNT.pack(*pair) for pair in piece.counts.items()) + piece.summary
        data += _LENGTH.pack(len(data))
        self._file.seek(self._size)
        if self._file.write(data) != len(data):
            # A disk that takes a part has no room for the rest.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._size += len(data)

    def pop(self) -> Piece:
        """Take the last one off."""
        length = _LENGTH.unpack(self._read(self._size - _LENGTH.size, _LENGTH.size))[0]
        begin = self._size - _LENGTH.size - length
        piece = _piece(self._read(begin, length), 0)[0]
        self._size = begin
        return piece

    def __iter__(self) -> Iterator[Piece]:
        data, position = self._read(0, self._size), 0
        while position < len(data):
            piece, position = _piece(data, position)
            yield piece

    def __del__(self) -> None:
        self._file.close()

    def _read(self, begin: int, length: int) -> bytes:
        self._file.seek(begin)
        data = b""
        while len(data) < length:
            data += self._file.read(length - len(data))
        return data


def _piece(data: bytes, position: int) -> tuple[Piece, int]:
    opcode, offset, crc, start_time, end_time, channels, length = _HEAD.unpack_from(data, position)
    position += _HEAD.size
    end = position + channels * _COUNT.size
    counts = dict(_COUNT.iter_unpack(data[position:end]))
    piece = Piece(opcode, offset, crc, start_time, end_time, counts, data[end : end + length])
    return piece, end + length + _LENGTH.size
