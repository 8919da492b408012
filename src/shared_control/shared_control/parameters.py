"""Configuration as frozen dataclasses whose fields carry unit, description and bounds.

A fact has one home: a default, its unit and its bounds are declared once, by :func:`parameter`, in the dataclass that
needs them. ROS parameters, scenario files, documentation and tests are all read off these declarations.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar, get_type_hints

__all__ = ["Declaration", "ParameterError", "build", "declarations", "parameter", "shown"]

T = TypeVar("T")

#: The types that a parameter may have; the same ones that ROS parameters have.
_KINDS: dict[Any, str] = {
    bool: "bool",
    int: "int",
    float: "float",
    str: "str",
    tuple[bool, ...]: "bool array",
    tuple[int, ...]: "int array",
    tuple[float, ...]: "float array",
    tuple[str, ...]: "str array",
}


#: [characters] No sentence is longer; who has put a book into a field need not read it again.
_LONGEST = 1000

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxtuple, _SHORT.maxdict = 3, 12, 12, 6
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 100


class ParameterError(ValueError):
    """A parameter is unknown, has a wrong type or lies outside its bounds. The message names key, value and range."""

    def __init__(self, message: str) -> None:
        half = _LONGEST // 2
        super().__init__(message if len(message) <= _LONGEST else f"{message[:half]} ... {message[-half:]}")


def shown(value: Any) -> str:
    """A value for an error message: as Python writes it, its middle left out where it is long."""
    try:
        return _SHORT.repr(value)
    except ValueError:
        return "a number of more digits than Python writes"


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    ge: float | None = None,
    le: float | None = None,
    choices: Sequence[str] | None = None,
    length: int | None = None,
    live: bool = False,
) -> Any:
    """Declare one field of a configuration dataclass.

    Parameters
    ----------
    default: value if nothing overrides it; lists are stored as tuples.
    description: one sentence for a person.
    unit: SI unit, empty if dimensionless.
    ge, le: bounds (inclusive), element by element for arrays.
    choices: allowed strings.
    length: exact number of elements of an array.
    live: whether the value may change while a trial runs.
    """
    if isinstance(default, list):
        default = tuple(default)
    meta = {
        "description": description,
        "unit": unit,
        "ge": ge,
        "le": le,
        "choices": tuple(choices) if choices is not None else None,
        "length": length,
        "live": live,
    }
    return dataclasses.field(default=default, metadata={"parameter": meta})


@dataclasses.dataclass(frozen=True)
class Declaration:
    """One declared parameter: everything that is known of it without a value."""

    name: str
    kind: str
    default: Any
    description: str
    unit: str
    ge: float | None
    le: float | None
    choices: tuple[str, ...] | None
    length: int | None
    live: bool

    @property
    def is_array(self) -> bool:
        return self.kind.endswith("array")

    def allowed(self) -> str:
        """The allowed range in words, for error messages and ROS descriptors."""
        parts = [self.kind]
        if self.length is not None:
            parts.append(f"of {self.length} elements")
        if self.choices is not None:
            parts.append("one of " + ", ".join(self.choices))
        if self.ge is not None and self.le is not None:
            parts.append(f"from {self.ge:g} to {self.le:g}")
        elif self.ge is not None:
            parts.append(f"at least {self.ge:g}")
        elif self.le is not None:
            parts.append(f"at most {self.le:g}")
        if self.unit:
            parts.append(f"[{self.unit}]")
        return " ".join(parts)

    def check(self, value: Any) -> Any:
        """Return ``value`` in the declared type.

        Raises
        ------
        ParameterError: wrong type, not finite, outside the bounds, not among the choices, wrong length.
        """
        if self.is_array:
            if isinstance(value, str) or (not isinstance(value, Sequence) and not hasattr(value, "tolist")):
                raise self._error(value)
            items = tuple(self._scalar(item, value) for item in value)
            if self.length is not None and len(items) != self.length:
                raise self._error(value)
            return items
        return self._scalar(value, value)

    def _scalar(self, item: Any, whole: Any) -> Any:
        kind = self.kind.removesuffix(" array")
        if kind == "float" and isinstance(item, (int, float)) and not isinstance(item, bool):
            try:
                item = float(item)
            except OverflowError:
                raise self._error(whole) from None
            if not math.isfinite(item):
                raise self._error(whole)
        elif kind == "int" and isinstance(item, int) and not isinstance(item, bool):
            item = int(item)
        elif (kind == "bool" and isinstance(item, bool)) or (kind == "str" and isinstance(item, str)):
            pass
        else:
            raise self._error(whole)
        if (self.ge is not None and item < self.ge) or (self.le is not None and item > self.le):
            raise self._error(whole)
        if self.choices is not None and item not in self.choices:
            raise self._error(whole)
        return item

    def _error(self, value: Any) -> ParameterError:
        return ParameterError(f"{self.name}: {shown(value)} is not allowed; it must be {self.allowed()}")


def declarations(cls: type) -> Iterator[Declaration]:
    """Yield the declared parameters of a configuration dataclass, in order."""
    hints = get_type_hints(cls)
    for field in dataclasses.fields(cls):
        yield Declaration(
            name=field.name, kind=_KINDS[hints[field.name]], default=field.default, **field.metadata["parameter"]
        )


def build(cls: type[T], values: Mapping[str, Any], where: str = "") -> T:
    """Build a configuration from a mapping, with every value checked.

    Raises
    ------
    ParameterError: an unknown key (the nearest known one is named) or a value that its declaration refuses; the message
        begins with ``where``.
    """
    known = {declaration.name: declaration for declaration in declarations(cls)}
    prefix = f"{where}: " if where else ""
    checked = {}
    for key, value in values.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]}?" if near else "known here: " + ", ".join(known)
            raise ParameterError(f"{prefix}unknown parameter {key} = {shown(value)}; {hint}")
        try:
            checked[key] = known[key].check(value)
        except ParameterError as error:
            raise ParameterError(f"{prefix}{error}") from None
    return cls(**checked)
