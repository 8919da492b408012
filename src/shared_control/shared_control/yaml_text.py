"""YAML from outside: plain values, or one sentence that says what is wrong and where."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from shared_control.parameters import ParameterError

__all__ = ["MOST_BYTES", "parse", "read"]

#: No configuration is longer; what is, is some other file.
MOST_BYTES = 1_000_000

#: What the library's constructors raise of themselves, as of a month 99, of a nesting without end or of `!!bool x`.
_OF_CONSTRUCTORS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def read(path: Path) -> tuple[bytes, Any]:
    """The bytes of a file and the values in them.

    Raises
    ------
    ParameterError: as :func:`parse`; or the file cannot be read.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read: {error.strerror or error}") from None
    return raw, parse(raw, str(path))


def parse(text: bytes | str, where: str) -> Any:
    """The values of a text: None, truth values, numbers, texts, dates, lists, mappings.

    Raises
    ------
    ParameterError: it is too long, or not YAML (with line and column).
    """
    # Imported here: only who reads a file pays for the parser.
    import yaml

    if len(text) > MOST_BYTES:
        raise ParameterError(f"{where}: cannot be read: {len(text)} bytes; a configuration has at most {MOST_BYTES}")
    try:
        return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # noqa: S506 both are safe ones
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""
        raise ParameterError(f"{where}{place}: not valid YAML: {error.problem or error.context}") from None
    except yaml.YAMLError as error:
        raise ParameterError(f"{where}: cannot be read: {error}") from None
    except _OF_CONSTRUCTORS as error:
        raise ParameterError(f"{where}: not valid YAML: {type(error).__name__}: {error}") from None
