"""Classes of messages and services by their names."""

from __future__ import annotations

import importlib
from typing import Any

from ros2_fallback.command import CommandError

__all__ = ["interface_class", "message_class", "service_class", "type_name"]


def interface_class(name: str, kind: str | None = None) -> Any:
    """The class of ``package/kind/Name``; with `kind` given, ``package/Name`` will do.

    Raises:
        CommandError: if the name is malformed or there is no such interface.
    """
    parts = name.split("/")
    if len(parts) == 2 and kind is not None:
        parts.insert(1, kind)
    if len(parts) != 3 or not all(part.isidentifier() for part in parts) or (kind is not None and parts[1] != kind):
        raise CommandError(f"'{name}' is not the name of an interface (e.g. 'std_msgs/msg/String')")
    try:
        return getattr(importlib.import_module(f"{parts[0]}.{parts[1]}"), parts[2])
    except (AttributeError, ImportError) as error:
        raise CommandError(f"The interface '{name}' is invalid or not installed: {error}") from None


def message_class(name: str) -> Any:
    """The class of a message, e.g. ``std_msgs/msg/String`` or ``std_msgs/String``. Raises CommandError."""
    return interface_class(name, "msg")


def service_class(name: str) -> Any:
    """The class of a service, e.g. ``std_srvs/srv/Trigger`` or ``std_srvs/Trigger``. Raises CommandError."""
    return interface_class(name, "srv")


def type_name(message: Any) -> str:
    """The full name of a message's type, e.g. ``std_msgs/msg/String``."""
    module = type(message).__module__.split(".")
    return f"{module[0]}/{module[1]}/{type(message).__name__}"
