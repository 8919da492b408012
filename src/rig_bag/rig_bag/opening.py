"""A new bag: where it is made, what it says of its surroundings, what is attached to it."""

from __future__ import annotations

import itertools
import os
import platform
import re
from collections.abc import Iterable
from pathlib import Path

import rclpy

from rig_bag.errors import BagError
from rig_bag.trial import Trial
from rig_bag.writer import BagWriter

__all__ = ["open_bag", "place_of"]


#: [bytes] Of each word in a bag's name: with two of them a file's name stays within the 255 that systems take.
_LONGEST = 80


def open_bag(path: str | os.PathLike[str], attachments: Iterable[str] = ()) -> BagWriter:
    """A bag at ``path`` with the files attached.

    Raises
    ------
    BagError: it cannot be made, or a file cannot be read; in that case the bag is closed, empty.
    """
    writer = BagWriter(path, custom_data=_surroundings())
    for name in filter(None, attachments):
        file = Path(name)
        try:
            data, changed = file.read_bytes(), file.stat().st_mtime_ns
        except OSError as error:
            writer.close()
            raise BagError(f"cannot attach {file}: {error.strerror}") from error
        media_type = "application/yaml" if file.suffix in (".yaml", ".yml") else "application/octet-stream"
        writer.attach(file.name, data, media_type, changed)
    return writer


def place_of(trial: Trial, folder: Path) -> Path:
    """A trial's own bag in a folder: subject, set, trial, attempt; if nobody counts these, the first that is free."""
    words = [word for word in (trial.subject or "trial", trial.set, f"{trial.trial:03d}") if word]
    # What a service call carries becomes the name of a directory, and nothing else.
    stem = "_".join(_fit(re.sub(r"[^\w-]", "-", word)) for word in words)
    if trial.attempt:
        return folder / f"{stem}_a{trial.attempt}"
    places = (folder / f"{stem}_a{attempt}" for attempt in itertools.count(1))
    return next(place for place in places if not place.exists())


def _fit(word: str) -> str:
    return word.encode()[:_LONGEST].decode(errors="ignore")


def _surroundings() -> dict[str, str]:
    """What the recording was made with."""
    return {
        "host": platform.node(),
        "machine": platform.machine(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "rmw": rclpy.get_rmw_implementation_identifier(),
        "scheduling": {0: "other", 1: "fifo", 2: "round robin"}.get(os.sched_getscheduler(0), "unknown"),
    }
