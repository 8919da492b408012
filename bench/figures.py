"""A run of `./rig bench` as a table in Markdown, and into a document: so that the document says what the file holds."""

from __future__ import annotations

from pathlib import Path

from compare import Bench
from rows import BenchError, Row, spread

#: Between these lines of a document stands the table.
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"

_SPEED = "10 million turns of a Python loop [s]"
_HEAD = ("row", "what", "this", "baseline", "ratio", "spread", "load", "wanted")


def markdown(bench: Bench) -> str:
    """One line about the machine, one of the table for each row, and what was not measured."""
    about = bench.machine
    loads = [f"{found[0]:.1f}" for found in (about["load average"], bench.body["load average after"])]
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    head = (
        f"Commit {about['commit']}; {about['processors usable']} processors ({about['processor']}), kernel "
        f"{about['kernel']}; load {' to '.join(loads)}, 10 million turns of a Python loop in "
        f"{about.get(_SPEED, '?')} s; `RIG_REALTIME={about['RIG_REALTIME']}`; {about['middleware']}; "
        f"{versions}."
    )
    lines = [
        head,
        "",
        _line(_HEAD),
        _line(["---"] * len(_HEAD)),
        *(_line(_cells(row)) for row in bench.rows),
    ]
    left_out = {**bench.body.get("not run", {}), **bench.body.get("failures", {})}
    lines += ["", *(f"Not measured: `{name}`: {reason}" for name, reason in left_out.items())] if left_out else []
    return "\n".join(lines)


def put(text: str, document: Path) -> str:
    """Put the table in place of what stands between the marks; returns what was done.

    Raises
    ------
    BenchError: no such document, or no marks in it.
    """
    try:
        before, _, rest = document.read_text(encoding="utf-8").partition(f"{BEGIN}\n")
    except OSError as error:
        raise BenchError(f"{document}: {error.strerror}") from None
    _, mark, after = rest.partition(END)
    if not mark:
        raise BenchError(f"{document} has no lines {BEGIN} and {END} to put the table between")
    document.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")
    return f"the table is in {document}"


def _line(cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"  # type: ignore[call-overload]


def _cells(row: Row) -> list[str]:
    met = {None: "", True: ": yes", False: ": **no**"}[row.met]
    base = f"{row.baseline}, {_number(row.base)} {row.unit}" if row.baselines else row.baseline
    return [
        f"`{row.name}`",
        row.what,
        f"{_number(row.value)} {row.unit}",
        base,
        "" if row.ratio is None else _number(row.ratio),
        _number(spread(row.relative), 2) if len(row.values) > 1 else "one run",
        " to ".join(f"{load:.1f}" for load in row.load),
        f"{row.wanted}{met}",
    ]


def _number(value: float, digits: int = 3) -> str:
    # What is large stays whole, without an exponent.
    return f"{value:.0f}" if abs(value) >= 10 ** (digits - 1) else f"{value:.{digits}g}"
