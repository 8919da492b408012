"""Writes the topics of a bag as tables that other tools open: CSV, NumPy's npz, or Parquet."""

from __future__ import annotations

import csv
import importlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from rig_bag.errors import BagError
from rig_bag.reader import info, read
from rig_bag.ticks import schema_of

__all__ = ["FORMATS", "export"]

Columns = dict[str, npt.NDArray[Any]]


def export(
    bag: str | os.PathLike[str], to: str | os.PathLike[str], form: str = "csv", topics: Sequence[str] | None = None
) -> list[Path]:
    """Write a file for each topic into a folder that need not exist; returns the files.

    A vector is a column for each axis (``wrench.force.x``), an array one for each index (``state.0``); times are whole
    nanoseconds. Where the messages of a topic have no common layout, an array that changes its length has empty cells
    at its end, and a sequence of messages has a column for each field of each (``status.0.name``).

    Raises
    ------
    BagError: as :func:`rig_bag.read`; no such format; a file is there already or cannot be written.
    """
    if form not in FORMATS:
        raise BagError(f"there is no format {form!r}; there are {', '.join(FORMATS)}")
    write = FORMATS[form]()
    folder = Path(to)
    written = []
    axes = {
        channel.topic: schema_of(contents, channel).axes()
        for contents in info(bag).contents()
        for channel in contents.channels.values()
    }
    for topic, table in read(bag, topics).items():
        path = folder / f"{topic.strip('/').replace('/', '.')}.{form}"
        if path.exists():
            raise BagError(f"{path} exists already; name another folder")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write(path, _columns(table, axes[topic]))
        except OSError as error:
            raise BagError(f"cannot write {path}: {error.strerror or error}") from error
        written.append(path)
    return written


def _columns(table: Any, axes: dict[str, tuple[str, ...]]) -> Columns:
    if isinstance(table, list):
        return _columns_of_rows(table)
    result: Columns = {}
    for name in table.dtype.names:
        values = table[name]
        if values.ndim == 1:
            result[name] = values
            continue
        for index, axis in enumerate(axes.get(name, range(values.shape[1]))):
            result[f"{name}.{axis}"] = values[:, index]
    return result


def _columns_of_rows(rows: Sequence[SimpleNamespace]) -> Columns:
    flat = [dict(_flat(row, "")) for row in rows]
    names: dict[str, None] = {}
    for entry in flat:
        names |= dict.fromkeys(entry)
    result: Columns = {}
    for name in names:
        values = [entry.get(name) for entry in flat]
        if all(value is not None for value in values):
            result[name] = np.array(values)
        elif any(isinstance(value, str) for value in values):
            result[name] = np.array(["" if value is None else value for value in values])
        else:
            # What is not there is not a number.
            result[name] = np.array([np.nan if value is None else value for value in values], float)
    return result


def _flat(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, SimpleNamespace):
        for key, inner in vars(value).items():
            yield from _flat(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, (list, np.ndarray)):
        for index, inner in enumerate(value):
            yield from _flat(inner, f"{name}.{index}")
    else:
        yield name, value


# -- formats ---------------------------------------------------------------------------------------------------------


def _csv() -> Callable[[Path, Columns], None]:
    def write(path: Path, columns: Columns) -> None:
        with path.open("x", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(columns)
            # The shortest text that reads back as the same number.
            writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))

    return write


def _npz() -> Callable[[Path, Columns], None]:
    def write(path: Path, columns: Columns) -> None:
        arrays: dict[str, Any] = dict(columns)
        np.savez_compressed(path, **arrays)

    return write


def _parquet() -> Callable[[Path, Columns], None]:
    try:
        pyarrow = importlib.import_module("pyarrow")
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise BagError("Parquet needs pyarrow (pip install pyarrow); csv and npz need nothing more") from None

    def write(path: Path, columns: Columns) -> None:
        parquet.write_table(pyarrow.table(columns), path)

    return write


FORMATS: dict[str, Callable[[], Callable[[Path, Columns], None]]] = {"csv": _csv, "npz": _npz, "parquet": _parquet}
