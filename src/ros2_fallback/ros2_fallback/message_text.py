"""Messages as text and back: the YAML that ``ros2 topic echo`` prints and that ``pub`` and ``call`` read, and CSV."""

from __future__ import annotations

import functools
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import yaml
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

from ros2_fallback.command import CommandError
from ros2_fallback.message_types import message_class, type_name

__all__ = ["FillError", "fill", "fill_from_yaml", "to_csv", "to_plain", "to_yaml"]

#: the largest number that float32 holds
_FLOAT32_MAX = (2.0 - 2.0**-23) * 2.0**127
_LINE_BREAKS = re.compile("[\\x85\\u2028\\u2029]")
_INTEGER = re.compile(r"(?P<unsigned>u?)int(?P<bits>8|16|32|64)")


class FillError(CommandError):
    """A value does not fit the message; the text names the field."""


class _Dumper(yaml.SafeDumper):
    """Never abbreviates a repeated value by an anchor."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    # Line breaks other than \n become spaces when PyYAML reads them back, unless they are escaped.
    style = '"' if _LINE_BREAKS.search(text) else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


def _represent_fields(dumper: yaml.SafeDumper, fields: Mapping[str, Any]) -> yaml.Node:
    # Without a style of its own: a line a field in flow style too, but in a list that is on one line.
    pairs = [(dumper.represent_data(name), dumper.represent_data(value)) for name, value in fields.items()]
    return yaml.MappingNode("tag:yaml.org,2002:map", pairs)


_Dumper.add_representer(str, _represent_text)
_Dumper.add_representer(dict, _represent_fields)


def _fields(message: Any) -> list[tuple[str, Any]]:
    """Names and rosidl types of a message's fields, in order."""
    return list(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))


def to_yaml(
    message: Any,
    *,
    truncate_length: int | None = None,
    no_arr: bool = False,
    no_str: bool = False,
    flow_style: bool = False,
) -> str:
    """The message as YAML, a line a field (with `flow_style`: lists on one line), ending with a line break.

    Args:
        message: any ROS message.
        truncate_length: arrays, bytes and strings longer than this end with ``...``; None: all is shown.
        no_arr: show the type and the length of arrays instead of their elements.
        no_str: show the length of strings instead of their text.
        flow_style: lists in brackets instead of lines.
    """
    text: str = yaml.dump(
        to_plain(message, truncate_length=truncate_length, no_arr=no_arr, no_str=no_str),
        Dumper=_Dumper,
        allow_unicode=True,
        default_flow_style=flow_style,
        width=sys.maxsize,
    )
    return text


def to_plain(
    message: Any, *, truncate_length: int | None = None, no_arr: bool = False, no_str: bool = False
) -> dict[str, Any]:
    """The message as dictionaries, lists, strings and numbers; arguments as for :func:`to_yaml`."""

    def plain(value: Any, field_type: Any) -> Any:
        if isinstance(value, bytes):  # a byte is one, and has no number type of its own in YAML
            return _shortened(value.decode("latin-1"), truncate_length)
        if isinstance(value, str):
            return f"<string length: <{len(value)}>>" if no_str else _shortened(value, truncate_length)
        if isinstance(value, (bool, int, float)):
            return value
        if isinstance(field_type, AbstractNestedType):
            if no_arr:
                return _array_summary(value, field_type)
            shown = value if truncate_length is None else value[:truncate_length]
            # Arrays of numbers know how to become Python's own; lists hold strings, bytes or messages.
            items = shown.tolist() if hasattr(shown, "tolist") else [plain(v, field_type.value_type) for v in shown]
            return items if len(shown) == len(value) else [*items, "..."]
        if hasattr(value, "SLOT_TYPES"):
            return {name: plain(getattr(value, name), slot) for name, slot in _fields(value)}
        return value.item()  # a numpy scalar

    return {name: plain(getattr(message, name), slot) for name, slot in _fields(message)}


def to_csv(message: Any, *, truncate_length: int | None = None, no_arr: bool = False, no_str: bool = False) -> str:
    """All fields, nested ones included, separated by commas; arguments as for :func:`to_yaml`."""

    def cells(value: Any, field_type: Any) -> list[str]:
        if isinstance(value, str) and no_str:
            return [f"<string length: <{len(value)}>>"]
        if isinstance(value, str):
            return [_shortened(value, truncate_length)]
        if isinstance(value, bytes):
            return [str(value)]
        if isinstance(field_type, AbstractNestedType):
            if no_arr:
                return [_array_summary(value, field_type)]
            shown = value if truncate_length is None else value[:truncate_length]
            items = [cell for item in shown for cell in cells(item, field_type.value_type)]
            return (items if len(shown) == len(value) else [*items, "..."]) or [""]
        if hasattr(value, "SLOT_TYPES"):
            return [cell for name, slot in _fields(value) for cell in cells(getattr(value, name), slot)]
        return [str(value)]

    return ",".join(cell for name, slot in _fields(message) for cell in cells(getattr(message, name), slot))


def _shortened(text: str, length: int | None) -> str:
    return text if length is None or len(text) <= length else text[:length] + "..."


def _array_summary(value: Any, field_type: AbstractNestedType) -> str:
    element = _name_of(field_type.value_type)
    if isinstance(field_type, Array):
        return f"<array type: {element}[{field_type.size}]>"
    if isinstance(field_type, BoundedSequence):
        return f"<sequence type: {element}[{field_type.maximum_size}], length: {len(value)}>"
    return f"<sequence type: {element}, length: {len(value)}>"


def _name_of(field_type: Any) -> str:
    if isinstance(field_type, NamespacedType):
        return "/".join(field_type.namespaced_name())
    if isinstance(field_type, BasicType):
        return str(field_type.typename)
    return "wstring" if isinstance(field_type, AbstractWString) else "string"


def fill_from_yaml(message: Any, text: str | bytes, *, stamps: bool = False) -> list[Callable[[Any], None]]:
    """Fill the message's fields from YAML, as :func:`fill` does.

    Raises:
        CommandError: if the text is not YAML, not a mapping, or does not fit.
    """
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise CommandError(f"The passed value is not YAML: {error}") from None
    if not isinstance(values, Mapping):
        raise CommandError("The passed value needs to be a dictionary in YAML format")
    try:
        return fill(message, values, stamps=stamps)
    except FillError as error:
        raise CommandError(f"Failed to populate field: {error}") from None


def fill(message: Any, values: Mapping[Any, Any], *, stamps: bool = False) -> list[Callable[[Any], None]]:
    """Set those fields of the message that `values` has; the others keep what they have.

    Args:
        message: any ROS message.
        values: field names to values, nested as the message is.
        stamps: whether a header may be given as ``auto`` and a time as ``now``.

    Returns:
        Functions that take a ``builtin_interfaces/msg/Time`` and set one field given as ``auto`` or ``now`` to it.

    Raises:
        FillError: if a field is unknown or a value does not fit its type; it names the field by its path.
    """
    setters: list[Callable[[Any], None]] = []
    _fill(message, values, "", setters if stamps else None)
    return setters


def _fill(message: Any, values: Any, path: str, setters: list[Callable[[Any], None]] | None) -> None:
    if not isinstance(values, Mapping):
        raise FillError(f"{path} ({type_name(message)}) needs a mapping of its fields, not {values!r}")
    slots = dict(_fields(message))
    for name, value in values.items():
        where = f"{path}.{name}" if path else str(name)
        slot = slots.get(name)
        if slot is None:
            raise FillError(
                f"'{where}': {type_name(message)} has no field '{name}' (it has: {', '.join(slots) or 'none'})"
            )
        current = getattr(message, name)
        if setters is not None and value == "auto" and _is(slot, "std_msgs/msg/Header"):
            setters.append(functools.partial(setattr, current, "stamp"))
        elif setters is not None and value == "now" and _is(slot, "builtin_interfaces/msg/Time"):
            setters.append(functools.partial(setattr, message, name))
        elif isinstance(slot, NamespacedType):
            _fill(current, value, where, setters)
        else:
            setattr(message, name, _value(value, slot, where, setters))


def _is(slot: Any, name: str) -> bool:
    return isinstance(slot, NamespacedType) and _name_of(slot) == name


def _value(value: Any, slot: Any, path: str, setters: list[Callable[[Any], None]] | None) -> Any:
    """The value that a field of type `slot` takes, made from one that YAML has."""
    if isinstance(slot, AbstractNestedType):
        return _array(value, slot, path, setters)
    if isinstance(slot, NamespacedType):
        message = message_class(_name_of(slot))()
        _fill(message, value, path, setters)
        return message
    if isinstance(value, (Mapping, list)) or value is None:
        raise FillError(f"'{path}' needs a {_name_of(slot)}, not {value!r}")
    if isinstance(slot, (AbstractString, AbstractWString)):
        text = str(value)
        limit = getattr(slot, "maximum_size", None)
        if limit is not None and len(text) > limit:
            raise FillError(f"'{path}' takes at most {limit} characters, not {len(text)}")
        return text
    return _basic(value, slot.typename, path)


def _array(value: Any, slot: AbstractNestedType, path: str, setters: list[Callable[[Any], None]] | None) -> list[Any]:
    if isinstance(value, bytes):  # YAML's !!binary
        value = list(value)
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise FillError(f"'{path}' needs a list of {_name_of(slot.value_type)}, not {value!r}")
    if isinstance(slot, Array) and len(value) != slot.size:
        raise FillError(f"'{path}' needs {slot.size} elements, not {len(value)}")
    if isinstance(slot, BoundedSequence) and len(value) > slot.maximum_size:
        raise FillError(f"'{path}' takes at most {slot.maximum_size} elements, not {len(value)}")
    return [_value(item, slot.value_type, f"{path}[{i}]", setters) for i, item in enumerate(value)]


def _basic(value: Any, kind: str, path: str) -> Any:
    """A boolean, a byte, a whole number or a number; numbers may come as strings (YAML reads ``1e-3`` as one)."""
    try:
        if kind == "boolean":
            return _boolean(value)
        if kind == "octet":
            return _byte(value)
        integer = _INTEGER.fullmatch(kind)
        if integer:
            number = int(value)
            if isinstance(value, float) and number != value:
                raise ValueError
            bits = int(integer["bits"])
            low, high = (0, 2**bits - 1) if integer["unsigned"] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            if not low <= number <= high:
                raise FillError(f"'{path}' needs a {kind} in [{low}, {high}], not {value!r}")
            return number
        real = float(value)
        if kind == "float" and math.isfinite(real) and abs(real) > _FLOAT32_MAX:
            raise FillError(f"'{path}' needs a number that float32 can hold, not {value!r}")
        return real
    except (TypeError, ValueError, OverflowError):
        raise FillError(f"'{path}' needs a {kind}, not {value!r}") from None


def _boolean(value: Any) -> bool:
    words = {"true": True, "false": False, "1": True, "0": False}
    key = str(value).lower()
    if key not in words:
        raise ValueError
    return words[key]


def _byte(value: Any) -> bytes:
    if isinstance(value, bytes):
        data = value
    elif isinstance(value, str):
        data = value.encode("latin-1")
    else:
        data = bytes([value])
    if len(data) != 1:
        raise ValueError
    return data
