"""Decoding serialised messages with the definitions that the bag itself carries.

Rules of plain CDR (XCDR1) as ROS 2 writes it: four bytes say the byte order; each primitive is aligned to its size,
counted from after those four bytes; a string is a length of 32 bits that counts its final zero, and UTF-8; a sequence
is a count of 32 bits and its elements; an empty sequence pads nothing; a message without fields is one byte.
Source: OMG CORBA 3.4, part 2, 9.3; checked against rclpy and two independent readers in the tests.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from rig_bag.errors import BagError

__all__ = ["Schema", "parse"]

_PRIMITIVES = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
#: The same in the letters of :mod:`struct`, to read one number.
_LETTERS = dict(zip(["?", "u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"], "?BbhHiIqQfd", strict=True))
_SINGLE = {(order, kind): struct.Struct(order + _LETTERS[code]) for order in "<>" for kind, code in _PRIMITIVES.items()}
#: Messages of equal components that become one axis of an array, in this order.
_AXES = {
    "geometry_msgs/Vector3": ("x", "y", "z"),
    "geometry_msgs/Point": ("x", "y", "z"),
    "geometry_msgs/Quaternion": ("x", "y", "z", "w"),
}
_TIMES = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(\[[^\]]*\])?\s+([A-Za-z]\w*)\s*(=?)")
_SECOND = 1_000_000_000


@dataclass(frozen=True)
class _Field:
    name: str
    type: str
    #: None: single; 0: a sequence; n: an array of n.
    length: int | None


class _VariesError(Exception):
    """The messages of a topic have no common layout."""


@dataclass(frozen=True)
class Schema:
    """A message type with everything it needs, able to decode."""

    name: str
    types: dict[str, tuple[_Field, ...]]

    @property
    def begins_with_stamp(self) -> bool:
        """Whether the first eight bytes of a message's data are a time: its header's stamp, or a stamp of its own."""
        fields = self.types[self.name]
        return bool(fields) and fields[0].type in ("std_msgs/Header", "builtin_interfaces/Time")

    def axes(self) -> dict[str, tuple[str, ...]]:
        """Names along the last axis of the columns that :meth:`array` makes of a vector: {column: names}."""
        found: dict[str, tuple[str, ...]] = {}

        def walk(name: str, prefix: str) -> None:
            for field in self.types[name]:
                if field.type in _AXES:
                    found[prefix + field.name] = _AXES[field.type]
                elif field.type in self.types and field.length is None:
                    walk(field.type, f"{prefix}{field.name}.")

        walk(self.name, "")
        return found

    def decode(self, data: bytes) -> SimpleNamespace:
        """One message as nested namespaces; sequences of numbers as numpy arrays, others as lists.

        Raises
        ------
        BagError: the bytes do not fit the definition.
        """
        try:
            return _Walker(self.types, data).message(self.name)
        except (struct.error, ValueError, IndexError, UnicodeDecodeError) as error:
            raise BagError(f"a {self.name} does not fit its definition: {error}") from error

    def array(self, data: Sequence[bytes]) -> npt.NDArray[Any] | None:
        """All messages of a topic as one structured array, or None if they have no common layout.

        A header gives the columns ``stamp`` [ns] and ``frame_id``; other times are int64 [ns]; Vector3, Point and
        Quaternion are one column with the last axis x, y, z (, w); other nested messages give dotted columns; an array
        or a sequence of numbers that has the same length in every message is a column with that as last axis.
        """
        sizes = {len(item) for item in data}
        if len(sizes) > 1:
            return None
        return self.table(np.frombuffer(b"".join(data), np.uint8).reshape(len(data), *sizes or [0]))

    def table(self, rows: npt.NDArray[np.uint8], **leading: npt.NDArray[np.int64]) -> npt.NDArray[Any] | None:
        """As :meth:`array`, of serialised messages of one length, shape (messages, bytes), behind ``leading`` columns.

        Raises
        ------
        BagError: the bytes do not fit the definition.
        """
        sample = rows[0].tobytes() if len(rows) else b"\x00\x01\x00\x00" + bytes(4096)
        walker = _Walker(self.types, sample)
        columns: list[_Column] = []
        try:
            walker.layout(self.name, "", columns)
        except _VariesError:
            return None
        except (struct.error, ValueError, IndexError, UnicodeDecodeError) as error:
            raise BagError(f"a {self.name} does not fit its definition: {error}") from error
        before: list[tuple[Any, ...]] = [(name, np.int64) for name in leading]
        # Zero, and not empty: an empty text has no bytes in the view.
        result = np.zeros(len(rows), np.dtype(before + [(each.name, each.result, each.shape) for each in columns]))
        if not len(rows):
            return result
        for at in (0, *walker.lengths):
            same = np.ndarray(len(rows), np.uint32, rows, at, rows.strides[:1])
            if (same != same[0]).any():
                return None
        for name, values in leading.items():
            result[name] = values
        _fill(result, rows, columns)
        return result


@dataclass(frozen=True)
class _Column:
    name: str
    offset: int
    stored: Any
    result: Any
    shape: tuple[int, ...] = ()
    kind: str = ""


def _fill(result: npt.NDArray[Any], rows: npt.NDArray[np.uint8], columns: Sequence[_Column]) -> None:
    """Bring the stored columns into those of the result."""
    assert result.dtype.fields is not None
    begin = end = target = 0

    def copy() -> None:
        """Numbers that lie side by side here and there go together."""
        if end > begin:
            kind, count = f"V{end - begin}", len(rows)
            stored = np.ndarray(count, kind, rows, begin, rows.strides[:1])
            np.ndarray(count, kind, result, target, result.strides)[...] = stored  # type: ignore[call-overload]

    for column in columns:
        place = result.dtype.fields[column.name][1]
        if column.kind == "" and column.stored == column.result:
            size = column.result.itemsize * math.prod(column.shape)
            if column.offset != end or place - target != column.offset - begin:
                copy()
                begin, target = column.offset, place
            end = column.offset + size
            continue
        if column.stored == "S0":
            continue
        values = np.ndarray((len(rows), *column.shape), column.stored, rows, column.offset, _strides(rows, column))
        if column.kind == "time":
            result[column.name] = values["s"].astype(np.int64) * _SECOND + values["n"]
        elif column.kind == "text":
            # Nearly always the same everywhere, such as a frame: then one is decoded.
            same = (values == values[0]).all()
            result[column.name] = np.char.decode(values[:1] if same else values, "utf-8")
        else:
            result[column.name] = values
    copy()


def _strides(rows: npt.NDArray[np.uint8], column: _Column) -> tuple[int, ...]:
    """Of the stored column: a message each, and then its numbers one after the other."""
    return (*rows.strides[:1], *(np.dtype(column.stored).itemsize for _ in column.shape))


class _Walker:
    """Goes through the bytes of one message by its definition."""

    def __init__(self, types: dict[str, tuple[_Field, ...]], data: bytes) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise ValueError("it does not begin as plain CDR does")
        self._types = types
        self._data = data
        self._order: Literal["<", ">"] = "<" if data[1] else ">"
        self._position = 4
        #: Offsets of the lengths that were read.
        self.lengths: list[int] = []

    def _align(self, size: int) -> int:
        self._position += -(self._position - 4) % size
        return self._position

    def _skip(self, size: int) -> int:
        start, self._position = self._position, self._position + size
        if self._position > len(self._data):
            raise ValueError("it is too short")
        return start

    def _count(self) -> int:
        self._align(4)
        self.lengths.append(self._position)
        start = self._skip(4)
        return int(struct.unpack_from(self._order + "I", self._data, start)[0])

    def _text(self) -> tuple[int, int]:
        """Offset and size of a string without its final zero."""
        size = self._count()
        return self._skip(size), max(0, size - 1)

    def _numbers(self, kind: str, count: int) -> tuple[int, np.dtype[Any]]:
        dtype = np.dtype(kind).newbyteorder(self._order)
        if count:
            self._align(dtype.itemsize)
        return self._skip(dtype.itemsize * count), dtype

    # -- one message, in full ----------------------------------------------------------------------------------------

    def message(self, name: str) -> SimpleNamespace:
        fields = self._types[name]
        if not fields:
            self._skip(1)
        return SimpleNamespace(**{field.name: self._value(field) for field in fields})

    def _value(self, field: _Field) -> Any:
        if field.length is None:
            return self._single(field.type)
        count = field.length or self._count()
        if field.type in _PRIMITIVES:
            start, dtype = self._numbers(_PRIMITIVES[field.type], count)
            return np.frombuffer(self._data, dtype, count, start)
        return [self._single(field.type) for _ in range(count)]

    def _single(self, kind: str) -> Any:
        number = _SINGLE.get((self._order, kind))
        if number is not None:
            self._align(number.size)
            return number.unpack_from(self._data, self._skip(number.size))[0]
        if kind == "string":
            start, size = self._text()
            return self._data[start : start + size].decode("utf-8")
        if kind == "wstring":
            raise ValueError("wide strings are not decoded here")
        return self.message(kind)

    # -- the layout that messages like this one share ----------------------------------------------------------------

    def layout(self, name: str, prefix: str, columns: list[_Column]) -> None:
        fields = self._types[name]
        if not fields:
            self._skip(1)
        for field in fields:
            path = prefix + field.name
            if field.type in _PRIMITIVES:
                count = 1 if field.length is None else field.length or self._count()
                start, dtype = self._numbers(_PRIMITIVES[field.type], count)
                shape = () if field.length is None else (count,)
                columns.append(_Column(path, start, dtype, dtype.newbyteorder("="), shape))
            elif field.length is not None or field.type == "wstring":
                raise _VariesError
            elif field.type == "string":
                start, size = self._text()
                columns.append(_Column(path, start, f"S{size}", f"U{max(size, 1)}", kind="text"))
            elif field.type in _TIMES:
                start = self._align(4)
                self._skip(8)
                stored = np.dtype([("s", self._order + "i4"), ("n", self._order + "u4")])
                columns.append(_Column(path, start, stored, np.dtype(np.int64), kind="time"))
            elif field.type in _AXES:
                start, dtype = self._numbers("f8", len(_AXES[field.type]))
                columns.append(_Column(path, start, dtype, np.dtype(np.float64), (len(_AXES[field.type]),)))
            else:
                self.layout(field.type, "" if field.type == "std_msgs/Header" else f"{path}.", columns)


@lru_cache(maxsize=1024)
def parse(name: str, text: str) -> Schema:
    """Parse the definition that a bag carries under encoding ``ros2msg``; ``name`` as ``package/msg/Name``.

    Raises
    ------
    BagError: it is not of that form, or mentions a type that it does not define.
    """
    parts = re.split(r"^=+$\n^MSG: *(\S+) *$", text, flags=re.MULTILINE)
    root = _short(name)
    texts = {root: parts[0]} | {_short(key): body for key, body in zip(parts[1::2], parts[2::2], strict=True)}
    types = {key: tuple(_fields(body, key.partition("/")[0])) for key, body in texts.items()}
    for key, fields in types.items():
        for field in fields:
            if field.type not in _PRIMITIVES and field.type not in ("string", "wstring") and field.type not in types:
                raise BagError(f"{name}: its definition mentions {field.type} (in {key}) and does not define it")
    return Schema(root, types)


def _short(name: str) -> str:
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"


def _fields(text: str, package: str) -> list[_Field]:
    result = []
    for line in text.splitlines():
        match = _FIELD.match(line.partition("#")[0])
        if match is None or match[4]:
            continue
        kind, bound, name = match[1], match[2], match[3]
        if kind not in _PRIMITIVES and kind not in ("string", "wstring"):
            kind = _short(kind) if "/" in kind else f"{package}/{kind}"
        length = None
        if bound is not None:
            inner = bound[1:-1].strip()
            length = int(inner) if inner.isdigit() else 0
        result.append(_Field(name, kind, length))
    return result
