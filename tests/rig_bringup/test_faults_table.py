"""The table of docs/safety.md and the rows of `./rig faults` are the same."""

from __future__ import annotations

import re
from pathlib import Path

from rig_bringup.faults.cli import ROWS

ROOT = Path(__file__).parents[2]

#: Row, fault, what each node does, within, also in.
COLUMNS = 5


def table() -> list[list[str]]:
    """The cells of every line of the tables of that chapter, without their heads."""
    text = (ROOT / "docs" / "safety.md").read_text()
    chapter = text.partition("\n## The table\n")[2].partition("\n### Measured\n")[0]
    lines = [line.strip("|").split("|") for line in chapter.splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in cells] for cells in lines]
    return [cells for cells in rows if cells[0] != "row" and set(cells[0]) - set("- ")]


def test_every_row_stands_in_the_table_once_with_its_limit() -> None:
    told = [(name, cells[3]) for cells in table() for name in re.findall("`([^`]+)`", cells[0])]
    assert sorted(name for name, _ in told) == sorted(ROWS)
    for name, within in told:
        limit = ROWS[name].within
        assert within.isdigit() == (limit is not None), name
        assert limit is None or within == f"{1e3 * limit:.0f}", name


def test_every_line_says_what_is_done_and_the_tests_that_it_names_are_there() -> None:
    text = (ROOT / "tests" / "graph" / "test_faults.py").read_text()
    chosen = re.findall(r"^(?:ZERO|OTHERS) = \((.*?)\)", text, re.MULTILINE)
    live = {name for names in chosen for name in names.split('"')}
    for cells in table():
        assert len(cells) == COLUMNS
        assert all(cells[:4]), cells
        files = re.findall("`([^`]+)`", cells[4])
        assert [file for file in files if not (ROOT / "tests" / file).is_file()] == []
        for name in re.findall("`([^`]+)`", cells[0]):
            assert ("graph/test_faults.py" in files) == (name in live), name
