"""A new bag: where it is made, what it says of its surroundings, what is attached to it."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from rig_bag.errors import BagError
from rig_bag.trial import Trial
from rig_bag.writer import BagWriter
from rig_runtime.surroundings import surroundings

__all__ = ["open_bag", "place_of"]

#: [bytes] Of each word in a bag's name: with two of them a file's name stays within the 255 that systems take.
_LONGEST = 80


def open_bag(path: str | os.PathLike[str], attachments: Iterable[str] = (), **options: int) -> BagWriter:
    """A bag at ``path`` with the files attached; options as :class:`rig_bag.writer.BagWriter` has them.

    Raises
    ------
    BagError: it cannot be made, or a file cannot be read; in that case the bag is closed, empty.
    """
    writer = BagWriter(path, custom_data=surroundings(), **options)
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
    """A trial's own bag in a folder: subject, set, trial, attempt; if nobody counts these, the first that is free.

    An attempt that is started a second time, by hand, is recorded too: with ``_2`` at the end.
    """
    words = [word for word in (trial.subject or "trial", trial.set, f"{trial.trial:03d}") if word]
    # What a service call carries becomes the name of a directory, and nothing else.
    stem = "_".join(_fit(re.sub(r"[^\w-]", "-", word)) for word in words)
    if trial.attempt:
        stem += f"_a{trial.attempt}"
        names: Iterator[str] = itertools.chain([stem], (f"{stem}_{again}" for again in itertools.count(2)))
    else:
        names = (f"{stem}_a{attempt}" for attempt in itertools.count(1))
    return next(folder / name for name in names if not (folder / name).exists())


def _fit(word: str) -> str:
    return word.encode()[:_LONGEST].decode(errors="ignore")
