"""What a page may say: JSON objects of known types with checked fields, nothing else.

`force` comes 100 times a second and more, the others when somebody does something. Every number is finite and bounded,
every text short. What does not fit is refused whole.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

__all__ = ["COMMANDS", "MAX_BYTES", "ProtocolError", "parse"]

#: Longest message that a page may send; the server closes on a longer one before it has read it.
MAX_BYTES = 2048

_Check = Callable[[Any], Any]


class ProtocolError(ValueError):
    """A message that no page of ours sends; says why."""


def _number(low: float, high: float) -> _Check:
    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ProtocolError(f"{str(value)[:40]!r} is no number")
        # An integer may be too large for a float; comparing it is exact.
        if not low <= value <= high:
            raise ProtocolError(f"{str(value)[:40]} is not from {low:g} to {high:g}")
        return float(value)

    return check


def _whole(high: int) -> _Check:
    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= high:
            raise ProtocolError(f"{str(value)[:40]!r} is no whole number from 0 to {high}")
        return value

    return check


def _text(length: int) -> _Check:
    def check(value: Any) -> str:
        if not isinstance(value, str) or len(value) > length or not value.isprintable():
            raise ProtocolError(f"must be printable text of at most {length} characters")
        return value

    return check


def _one_of(*choices: str) -> _Check:
    def check(value: Any) -> str:
        if value not in choices:
            raise ProtocolError(f"must be one of {', '.join(choices)}")
        return str(value)

    return check


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ProtocolError("must be true or false")
    return value


def _optional(check: _Check) -> _Check:
    return lambda value: None if value is None else check(value)


_NEWTONS = _number(-1e6, 1e6)
_MILLISECONDS = _number(0.0, 1e12)
_SHORT_TIME = _number(0.0, 60_000.0)

_FIELDS: dict[str, dict[str, _Check]] = {
    # Force [N]; t: when it was sent, age: how long before that its newest input event was [ms], null if none is new.
    "force": {"x": _NEWTONS, "y": _NEWTONS, "z": _NEWTONS, "t": _MILLISECONDS, "age": _optional(_SHORT_TIME)},
    "idle": {"reason": _one_of("hidden", "out of focus", "leaving")},
    "sync": {"t": _MILLISECONDS},
    "stats": {
        "rtt": _SHORT_TIME,
        "drawn50": _SHORT_TIME,
        "drawn99": _SHORT_TIME,
        "drawnmax": _SHORT_TIME,
        "fps": _number(0.0, 1000.0),
    },
    "drive": {},
    "leave": {},
    "stop": {},
    "release": {},
    "start": {
        "subject": _text(80),
        "group": _text(80),
        "set": _text(80),
        "trial": _whole(2**32 - 1),
        "duration": _number(0.0, 86400.0),
    },
    "abort": {"reason": _text(200)},
    "mode": {"mode": _one_of("off", "training", "assistance")},
    "choose": {"protocol": _text(80), "subject": _text(80)},
    "session": {"do": _one_of("pause", "resume", "repeat")},
    "feedback": {"on": _flag},
}

#: Types that act on the graph: rarer, and limited more tightly.
COMMANDS = frozenset({"drive", "leave", "release", "start", "abort", "mode", "choose", "session", "feedback"})


def parse(text: str) -> dict[str, Any]:
    """A message with every field checked, under `type` its type.

    Raises
    ------
    ProtocolError: not JSON, not a known type, a field too many or too few, a value that is not allowed.
    """
    try:
        message = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"not JSON: {str(error)[:80]}") from None
    if not isinstance(message, dict):
        raise ProtocolError("not an object")
    kind = message.pop("type", None)
    fields = _FIELDS.get(kind) if isinstance(kind, str) else None
    if fields is None:
        raise ProtocolError(f"unknown type {str(kind)[:40]!r}")
    if message.keys() != fields.keys():
        raise ProtocolError(f"{kind}: fields must be {', '.join(fields) or 'none'}")
    checked: dict[str, Any] = {"type": kind}
    for name, check in fields.items():
        try:
            checked[name] = check(message[name])
        except ProtocolError as error:
            raise ProtocolError(f"{kind}.{name}: {error}") from None
    return checked


def finite_or_none(value: float) -> float | None:
    """A number for JSON, which knows neither NaN nor infinity."""
    return value if math.isfinite(value) else None


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")
