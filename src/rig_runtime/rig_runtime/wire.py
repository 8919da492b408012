"""Messages of the loop as arrays over their serialised bytes, for the path of a tick.

A message object costs tens of microseconds each time that one is made, filled, or taken apart field by field. On a
topic of the loop all messages have one layout, because their texts and the lengths of their sequences stay the same:
each number lies at a fixed place. Here it is read and written there. What is published reads as if rclpy had sent it;
what has another layout is read as rclpy reads it.

Layout of plain CDR (OMG CORBA 3.4, part 2, 9.3): four bytes that say the byte order; then each number aligned to its
size, a text as a length of 32 bits that counts its final zero, a sequence as a count of 32 bits and its elements.
"""

from __future__ import annotations

import struct
import sys
from typing import Any

import numpy as np
import numpy.typing as npt
from rclpy.serialization import deserialize_message, serialize_message

__all__ = ["MalformedError", "WireMessage", "decode", "stamp_of"]

_NUMBERS = {
    "boolean": "?",
    "octet": "u1",
    "uint8": "u1",
    "int8": "i1",
    "uint16": "u2",
    "int16": "i2",
    "uint32": "u4",
    "int32": "i4",
    "uint64": "u8",
    "int64": "i8",
    "float": "f4",
    "double": "f8",
}
_BEGIN = 4
_STAMP_BYTES = slice(_BEGIN, _BEGIN + 8)
_SECOND = 1_000_000_000
_LITTLE = sys.byteorder == "little"
_STAMP = struct.Struct("=iI")
_LITTLE_STAMP, _BIG_STAMP = struct.Struct("<iI"), struct.Struct(">iI")
_END_OF_STAMP = _BEGIN + _STAMP.size

#: [s] Of a stamp; a day before the end of a ROS time's 32 bits, so that a trial that begins there can be counted.
LAST_SECOND = 2**31 - 1 - 86_400


class MalformedError(ValueError):
    """A message that no node of the rig sends: not to be taken, and no reason to end."""


def stamp_of(data: bytes | bytearray) -> int:
    """The stamp [ns] of a serialised message that begins with a header.

    Raises
    ------
    MalformedError: too short, or no time.
    """
    if len(data) < _END_OF_STAMP:
        raise MalformedError(f"{len(data)} bytes are no message with a stamp")
    sec, nanosec = (_LITTLE_STAMP if data[1] & 1 else _BIG_STAMP).unpack_from(data, _BEGIN)
    if not (0 <= sec <= LAST_SECOND and nanosec < _SECOND):
        raise MalformedError(f"{sec} s and {nanosec} ns are no stamp")
    return int(sec) * _SECOND + int(nanosec)


def decode(data: bytes, type_: Any) -> Any:
    """A serialised message as an object.

    Raises
    ------
    MalformedError: these bytes are no message of this type.
    """
    try:
        return deserialize_message(data, type_)
    except RuntimeError as error:  # rclpy's RMWError is one
        raise MalformedError(f"{len(data)} bytes are no {type_.__name__}: {str(error)[:200]}") from None


class WireMessage:
    """One message of a topic, again and again: load what came, or write fields and publish :attr:`data`.

    ``message["wrench.force"]`` is an array over the bytes, valid until the next :meth:`load`, for a sequence or a
    nested message of equal numbers (a vector: x, y, z); for a single number it is the number.

    Parameters
    ----------
    type_: message class, which begins with a header.
    frame_id: of the header.
    lengths: of each sequence of numbers, by its name.
    """

    def __init__(self, type_: Any, frame_id: str, **lengths: int) -> None:
        self._type = type_
        prototype = type_()
        prototype.header.frame_id = frame_id
        for name, length in lengths.items():
            setattr(prototype, name, [0.0] * length)
        self._empty = bytes(serialize_message(prototype))
        self._bytes = bytearray(self._empty)
        self._fields: dict[str, npt.NDArray[Any]] = {}
        self._texts: dict[str, str] = {}
        #: One bits where the bytes are the same in all messages of this layout.
        self._mask = bytearray(len(self._empty))
        self._mask[:_BEGIN] = b"\xff" * _BEGIN
        self._position = _BEGIN
        self._lay_out(prototype, "")
        if self._position != len(self._bytes) or bool(self._empty[1] & 1) is not _LITTLE:
            raise TypeError(f"{type_.__name__} is not laid out as expected")  # a field of a kind that no topic has
        # As one integer each: compared part by part it takes three times as long.
        self._fixed = int.from_bytes(self._mask, "little")
        self._layout = int.from_bytes(self._empty, "little") & self._fixed
        # The middleware leaves between the numbers what was in the memory there; here it is zero, so that a run that
        # repeats another one repeats it to the last byte.
        self._empty = self._layout.to_bytes(len(self._empty), "little")
        self.clear()

    def __getitem__(self, path: str) -> Any:
        field = self._fields[path]
        return field if field.ndim else field.item()

    def __setitem__(self, path: str, value: Any) -> None:
        self._fields[path][()] = value

    @property
    def paths(self) -> tuple[str, ...]:
        """Names of all fields."""
        return tuple(self._fields)

    @property
    def stamp(self) -> int:
        """The header's stamp [ns]."""
        return stamp_of(self._bytes)

    @stamp.setter
    def stamp(self, nanoseconds: int) -> None:
        _STAMP.pack_into(self._bytes, _BEGIN, *divmod(nanoseconds, _SECOND))

    def take_stamp(self, other: WireMessage) -> None:
        """The stamp of another message."""
        self._bytes[_STAMP_BYTES] = other._bytes[_STAMP_BYTES]

    @property
    def data(self) -> bytes:
        """The message, for :meth:`rclpy.publisher.Publisher.publish`."""
        return bytes(self._bytes)

    def clear(self) -> None:
        """All numbers zero."""
        self._bytes[:] = self._empty

    def load(self, data: bytes) -> bool:
        """Take a message; whether its frame is the expected one.

        A sequence that has not the expected length comes out as NaN (numbers that are none as zero).

        Raises
        ------
        MalformedError: as :func:`decode`.
        """
        if self._fits(data):
            self._bytes[:] = data
            return True
        return self._load_object(decode(data, self._type))

    def check(self, data: bytes) -> None:
        """Whether :meth:`load` can take a message that is to be kept until then.

        Raises
        ------
        MalformedError: it cannot.
        """
        if not self._fits(data):
            decode(data, self._type)

    # -- inside ------------------------------------------------------------------------------------------------------

    def _fits(self, data: bytes) -> bool:
        return len(data) == len(self._empty) and int.from_bytes(data, "little") & self._fixed == self._layout

    def _load_object(self, message: Any) -> bool:
        for path, field in self._fields.items():
            value = message
            for name in path.split("."):
                value = getattr(value, name)
            if hasattr(value, "get_fields_and_field_types"):
                continue  # its numbers are fields too
            if field.ndim and len(value) != len(field):
                value = np.nan if field.dtype.kind == "f" else 0
            field[...] = value
        return all(_text(message, path) == text for path, text in self._texts.items())

    def _lay_out(self, message: Any, prefix: str) -> None:
        for name, kind in message.get_fields_and_field_types().items():
            value, path = getattr(message, name), prefix + name
            if kind in _NUMBERS:
                self._place(path, _NUMBERS[kind], ())
            elif kind == "string":
                size = len(value.encode()) + 1
                self._fix(4)
                self._mask_next(size)
                self._texts[path] = value
            elif kind.startswith("sequence<"):
                self._fix(4)
                self._place(path, _NUMBERS[kind[len("sequence<") : -1]], (len(value),))
            else:
                self._lay_out(value, path + ".")
                self._join(path, value)

    def _fix(self, size: int) -> None:
        self._align(size)
        self._mask_next(size)

    def _mask_next(self, size: int) -> None:
        self._mask[self._position : self._position + size] = b"\xff" * size
        self._position += size

    def _align(self, size: int) -> None:
        self._position += -(self._position - _BEGIN) % size

    def _place(self, path: str, kind: str, shape: tuple[int, ...]) -> None:
        dtype = np.dtype(kind)
        if 0 not in shape:
            self._align(dtype.itemsize)
        self._fields[path] = np.ndarray(shape, dtype, self._bytes, min(self._position, len(self._bytes)))
        self._position += dtype.itemsize * int(np.prod(shape))

    def _join(self, path: str, message: Any) -> None:
        """A nested message of equal numbers, which has just been laid out, also as one array."""
        kinds = list(message.get_fields_and_field_types().values())
        if len(set(kinds)) == 1 and kinds[0] in _NUMBERS:
            dtype = np.dtype(_NUMBERS[kinds[0]])
            start = self._position - len(kinds) * dtype.itemsize
            self._fields[path] = np.ndarray((len(kinds),), dtype, self._bytes, start)


def _text(message: Any, path: str) -> str:
    for name in path.split("."):
        message = getattr(message, name)
    return str(message)
