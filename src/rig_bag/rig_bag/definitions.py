"""Definitions of message types, as installed: the text that a bag carries, and the type's hash.

A bag must be readable where the type is not installed, so it carries each definition with all those that it needs:
the type's own text, then for each type it mentions a separator line and ``MSG: package/Name``.
Sources: MCAP's well-known schema encoding ``ros2msg``; REP 2011 for the hash (``RIHS01_...``).
"""

from __future__ import annotations

import importlib
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from rig_bag import cdr
from rig_bag.errors import BagError

__all__ = ["as_installed", "begins_with_stamp", "full_definition", "message_class", "type_hash"]

_SEPARATOR = "=" * 80
_PRIMITIVE = re.compile(r"^(bool|byte|char|u?int(8|16|32|64)|float(32|64)|w?string)$")
#: ``type[bound] name`` of one field; a constant has ``=`` after its name.
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+([A-Za-z]\w*)\s*(=?)")


def _split(type_name: str) -> tuple[str, str]:
    parts = type_name.split("/")
    if (len(parts) == 3 and parts[1] == "msg") or len(parts) == 2:
        return parts[0], parts[-1]
    raise BagError(f"{type_name} is not the name of a message type (package/msg/Name)")


def _file(type_name: str, suffix: str) -> Path:
    package, name = _split(type_name)
    try:
        share = get_package_share_directory(package)
    except PackageNotFoundError:
        raise BagError(f"{type_name}: package {package} is not installed, or its workspace is not sourced") from None
    path = Path(share) / "msg" / f"{name}{suffix}"
    if not path.is_file():
        raise BagError(f"{type_name}: {path} is missing; is it a message of this version of {package}?")
    return path


def _fields(text: str, package: str) -> list[str]:
    """Types of the fields in order; those of other messages as ``package/Name``."""
    types = []
    for line in text.splitlines():
        match = _FIELD.match(line.partition("#")[0])
        if match is None or match[3]:
            continue
        name = match[1]
        if not _PRIMITIVE.match(name):
            name = "/".join(_split(name)) if "/" in name else f"{package}/{name}"
        types.append(name)
    return types


@cache
def _text(type_name: str) -> str:
    return _file(type_name, ".msg").read_text(encoding="utf-8")


@cache
def full_definition(type_name: str) -> str:
    """Text of a type such as ``std_msgs/msg/Header`` followed by the texts of all types that it needs.

    Raises
    ------
    BagError: the type, or one that it needs, is not installed.
    """
    package, _ = _split(type_name)
    text = _text(type_name)
    parts = [text]
    seen = {"/".join(_split(type_name))}
    queue = _fields(text, package)
    while queue:
        name = queue.pop(0)
        if "/" not in name or name in seen:
            continue
        seen.add(name)
        inner = _text(name)
        parts.append(f"{_SEPARATOR}\nMSG: {name}\n{inner}")
        queue.extend(_fields(inner, name.partition("/")[0]))
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def as_installed(recorded: cdr.Schema) -> bool:
    """Whether messages of a recorded definition have the fields of the installed one.

    Raises
    ------
    BagError: the type is not installed.
    """
    package, _, name = recorded.name.partition("/")
    return recorded == cdr.parse(recorded.name, full_definition(f"{package}/msg/{name}"))


@cache
def type_hash(type_name: str) -> str:
    """The type's REP 2011 hash as installed; empty if the installation does not carry it."""
    try:
        entries = json.loads(_file(type_name, ".json").read_text(encoding="utf-8"))["type_hashes"]
    except (BagError, KeyError, ValueError):
        return ""
    package, name = _split(type_name)
    for entry in entries:
        if entry.get("type_name") == f"{package}/msg/{name}":
            return str(entry["hash_string"])
    return ""


def begins_with_stamp(type_name: str) -> bool:
    """Whether a message's first eight bytes of CDR data are a time: its header's stamp, or a stamp of its own."""
    package, _ = _split(type_name)
    fields = _fields(_text(type_name), package)
    return bool(fields) and fields[0] in ("std_msgs/Header", "builtin_interfaces/Time")


def message_class(type_name: str) -> Any:
    """The Python class of an installed message type.

    Raises
    ------
    BagError: it cannot be imported.
    """
    package, name = _split(type_name)
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise BagError(f"{type_name} is not installed for Python ({error})") from error
