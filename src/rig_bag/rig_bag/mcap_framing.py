"""Framing all messages of a file at once, with arrays instead of a loop.

The index says where messages are; nothing of it is believed. Read at these places, the lengths of the messages must
tile the chunks without gap or overlap but for whole records of other kinds, as going from record to record would find.
Where they do not, or there is no index, the file has to be gone through in that way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rig_bag.contents import Places
from rig_bag.mcap_records import CHUNK, MESSAGE, MESSAGE_FIXED, MESSAGE_INDEX, frames

__all__ = ["Framing", "frame"]

_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_ENTRY = 16  # [bytes] of a message in the index: its time and its offset in the unpacked chunk
_INDEX_FIXED = 6  # [bytes] before them: the channel, and how many bytes follow
_LATEST = np.iinfo(np.int64).max


@dataclass
class Framing:
    """What the chunks of a file hold."""

    #: Messages of each channel.
    places: dict[int, Places]
    #: Of each chunk the records that are no messages: (opcode, content).
    others: list[list[tuple[int, bytes]]]
    count: int


def frame(data: bytes, section: Sequence[tuple[int, int, int, int]], chunks: Sequence[bytes]) -> Framing | None:
    """Frame the unpacked ``chunks`` of a file ``data`` whose data section has the records ``section``.

    None if they cannot be framed by their index.
    """
    ends = np.cumsum([0, *map(len, chunks)])
    offsets = _indexed(data, section, ends)
    if offsets is None:
        return None
    buffer = b"".join(chunks)
    last = len(buffer) - _HEAD.itemsize
    if (offsets > max(last, 0)).any():
        return None
    # Stable: quickest for what is in runs that are sorted already.
    starts = np.sort(offsets.astype(np.int64), kind="stable")
    heads = np.ndarray(max(last + 1, 0), _HEAD, buffer, strides=(1,))[starts]
    lengths = heads["length"]
    if (heads["opcode"] != MESSAGE).any() or ((lengths < MESSAGE_FIXED) | (lengths > len(buffer))).any():
        return None
    if (heads["log_time"] > _LATEST).any() or (heads["publish_time"] > _LATEST).any():
        return None
    sizes = lengths.astype(np.int64) - MESSAGE_FIXED
    others = _between(buffer, ends, starts, starts + _HEAD.itemsize + sizes)
    if others is None:
        return None
    return Framing(_by_channel(buffer, heads, starts + _HEAD.itemsize, sizes), others, len(starts))


def _indexed(
    data: bytes, section: Sequence[tuple[int, int, int, int]], ends: npt.NDArray[np.int64]
) -> npt.NDArray[np.uint64] | None:
    """Where the index says that messages begin, counted through all chunks."""
    entries: list[bytes] = []
    chunk_of: list[int] = []
    chunk = -1
    for opcode, _, start, end in section:
        if opcode == CHUNK:
            chunk += 1
        elif opcode == MESSAGE:
            return None
        elif opcode == MESSAGE_INDEX:
            size = end - start - _INDEX_FIXED
            if chunk < 0 or size < 0 or size % _ENTRY:
                return None
            entries.append(data[start + _INDEX_FIXED : end])
            chunk_of.append(chunk)
    if not entries:
        return np.empty(0, np.uint64)
    counts = [len(entry) // _ENTRY for entry in entries]
    offsets = np.frombuffer(b"".join(entries), "<u8")[1::2]
    return offsets + np.repeat(ends[chunk_of].astype(np.uint64), counts)


def _between(
    buffer: bytes, chunk_ends: npt.NDArray[np.int64], starts: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]
) -> list[list[tuple[int, bytes]]] | None:
    """The records between the messages, of each chunk; None if messages overlap, or anything else is there."""
    # What a message follows: the one before it, or the begin of its chunk. Likewise at the end of each chunk.
    first = np.searchsorted(starts, chunk_ends)
    begins = np.concatenate([chunk_ends[:1], ends])
    gaps: list[tuple[int, int, int]] = []
    for chunk in range(len(chunk_ends) - 1):
        a, b = first[chunk], first[chunk + 1]
        before = begins[a : b + 1].copy()
        before[0] = chunk_ends[chunk]
        after = np.append(starts[a:b], chunk_ends[chunk + 1])
        for place in np.flatnonzero(before != after):
            gaps.append((chunk, int(before[place]), int(after[place])))
    others: list[list[tuple[int, bytes]]] = [[] for _ in chunk_ends[1:]]
    for chunk, begin, end in gaps:
        if begin > end:
            return None
        try:
            found = [(opcode, buffer[a:b]) for opcode, _, a, b in frames(buffer, begin, end)]
        except ValueError:
            return None
        if any(opcode == MESSAGE for opcode, _ in found):
            return None
        others[chunk] += found
    return others


def _by_channel(
    buffer: bytes, heads: npt.NDArray[np.void], begins: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]
) -> dict[int, Places]:
    order = np.argsort(heads["channel"], kind="stable")
    channels, first = np.unique(heads["channel"][order], return_index=True)
    last = [*first[1:], len(order)][: len(first)]
    log_times, publish_times = heads["log_time"].astype(np.int64), heads["publish_time"].astype(np.int64)
    result = {}
    for channel, begin, end in zip(channels.tolist(), first, last, strict=True):
        of = order[begin:end]
        result[channel] = Places(buffer, begins[of], sizes[of], log_times[of], publish_times[of], of)
    return result
