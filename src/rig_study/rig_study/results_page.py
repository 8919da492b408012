"""The tables of ``docs/results.md``: rows between two marks, and text around them that nobody but a person writes.

    <!-- table NAME: written by ./rig reproduce -->
    | claim | wanted | measured |
    | --- | --- | --- |
    | ... |
    <!-- end -->

The first cell names a row. A row that is measured again is replaced where it stands, a new one comes at the end.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from rig_study.declared import StudyError

__all__ = ["Row", "line", "update"]

Row = tuple[str, ...]

_TABLE = re.compile(r"(<!-- table (?P<name>.+?): .*?-->\n)(?P<body>.*?)(<!-- end -->)", re.DOTALL)


def line(row: Row) -> str:
    """A row as it stands in the page."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"


def update(page: Path, tables: Mapping[str, Sequence[Row]], *, whole: Collection[str] = ()) -> None:
    """Put rows into the page's tables.

    Parameters
    ----------
    whole: tables of which these are all rows; what else stands in them is of claims that are no more, and goes.

    Raises
    ------
    StudyError: the page cannot be read or written, or lacks a table.
    """
    try:
        text = page.read_text(encoding="utf-8")
        names = [found["name"] for found in _TABLE.finditer(text)]
        if lacking := [name for name in tables if names.count(name) != 1]:
            raise StudyError(f"{page}: must have one place '<!-- table {lacking[0]}: ... -->' to '<!-- end -->'")

        def replaced(found: re.Match[str]) -> str:
            head, rows = found["body"].splitlines()[:2], found["body"].splitlines()[2:]
            new = [line(row) for row in tables.get(found["name"], ())]
            body = [*head, *(new if found["name"] in whole else _merged(rows, new))]
            return found[1] + "".join(f"{row}\n" for row in body) + found[4]

        partial = page.with_suffix(".partial")
        partial.write_text(_TABLE.sub(replaced, text), encoding="utf-8")
        partial.replace(page)
    except OSError as error:
        raise StudyError(f"{page}: {error.strerror or error}") from None


def _merged(there: Sequence[str], new: Sequence[str]) -> list[str]:
    rows = {_name(row): row for row in there} | {_name(row): row for row in new}
    return list(rows.values())


def _name(row: str) -> str:
    return row.split(" | ", maxsplit=1)[0]
