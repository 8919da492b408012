"""What a bag's file holds, however it was read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Contents", "Messages", "Places"]


class Places(NamedTuple):
    """Messages as places in a buffer; all arrays of shape (messages,)."""

    buffer: bytes
    #: Where each message's data begins, and how long it is [B].
    begins: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    #: [ns]
    log_times: npt.NDArray[np.int64]
    publish_times: npt.NDArray[np.int64]
    order: npt.NDArray[np.int64]


class Messages:
    """The messages of one channel, in the order of the file.

    They come one by one, or all at once as places in a buffer; then no object is made of any until one is asked for.
    """

    def __init__(self, topic: str, schema: int, encoding: str, metadata: dict[str, str]) -> None:
        self.topic = topic
        self.schema = schema
        self.encoding = encoding
        self.metadata = metadata
        self._places: Places | None = None
        self._log_times: list[int] = []
        self._publish_times: list[int] = []
        self._order: list[int] = []
        self._data: list[bytes] = []

    def append(self, log_time: int, publish_time: int, order: int, data: bytes) -> None:
        """Take one message; ``order``: how many stand before it in the file, of all channels."""
        self._log_times.append(log_time)
        self._publish_times.append(publish_time)
        self._order.append(order)
        self._data.append(data)

    def adopt(self, places: Places) -> None:
        """Take all messages at once."""
        self._places = places

    def __len__(self) -> int:
        return len(self._data) if self._places is None else len(self._places.begins)

    @property
    def log_times(self) -> list[int]:
        self._make_objects()
        return self._log_times

    @property
    def publish_times(self) -> list[int]:
        self._make_objects()
        return self._publish_times

    @property
    def order(self) -> list[int]:
        self._make_objects()
        return self._order

    @property
    def data(self) -> list[bytes]:
        self._make_objects()
        return self._data

    def times(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Log and publish times [ns].

        Raises
        ------
        ValueError: one is beyond what 64 bits with a sign hold.
        """
        if self._places is not None:
            return self._places.log_times, self._places.publish_times
        try:
            return np.array(self._log_times, np.int64), np.array(self._publish_times, np.int64)
        except OverflowError:
            raise ValueError("a message is of a time after the year 2262") from None

    def rows(self) -> npt.NDArray[np.uint8] | None:
        """The bytes of all messages, shape (messages, bytes); None if they are not all of one length."""
        if not len(self):
            return np.empty((0, 0), np.uint8)
        if self._places is None:
            size = len(self._data[0])
            if any(len(item) != size for item in self._data):
                return None
            return np.frombuffer(b"".join(self._data), np.uint8).reshape(len(self._data), size)
        buffer, begins, sizes = self._places[:3]
        size = int(sizes[0])
        if size == 0 or (sizes != size).any():
            return None
        # Every run of so many bytes in the buffer, as one element each: those wanted are then copied whole.
        runs = np.ndarray((len(buffer) - size + 1,), f"V{size}", buffer, strides=(1,))
        return runs[begins].view(np.uint8).reshape(len(begins), size)

    def _make_objects(self) -> None:
        places = self._places
        if places is not None:
            self._places = None
            self._log_times, self._publish_times = places.log_times.tolist(), places.publish_times.tolist()
            self._order = places.order.tolist()
            buffer, ends = places.buffer, places.begins + places.sizes
            self._data = [buffer[a:b] for a, b in zip(places.begins.tolist(), ends.tolist(), strict=True)]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Messages):
            return NotImplemented
        self._make_objects()
        other._make_objects()
        return vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]


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
