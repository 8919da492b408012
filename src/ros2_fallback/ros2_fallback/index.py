"""What is installed, by the ament index: packages, their executables and their interfaces."""

from __future__ import annotations

import os
from pathlib import Path

from ament_index_python import (
    PackageNotFoundError,
    get_package_prefix,
    get_packages_with_prefixes,
    get_resource,
    get_resources,
)

from ros2_fallback.command import CommandError

__all__ = ["executables", "interface_packages", "interfaces", "package_names", "prefix"]

#: What the definition of each kind of interface may be called.
_SUFFIXES = {"msg": ("idl", "msg"), "srv": ("idl", "srv"), "action": ("idl", "action")}


def package_names() -> list[str]:
    """Every package in the index, sorted."""
    return sorted(get_packages_with_prefixes())


def prefix(package: str) -> Path | None:
    """Where the package is installed, None if it is not."""
    try:
        return Path(get_package_prefix(package))
    except (PackageNotFoundError, ValueError):
        return None


def executables(package: str) -> list[Path]:
    """The executable files below ``<prefix>/lib/<package>``, sorted, without hidden folders.

    Raises:
        CommandError: if there is no such package.
    """
    where = prefix(package)
    if where is None:
        raise CommandError(f"Package '{package}' not found")
    found = []
    for folder, subfolders, files in os.walk(where / "lib" / package):
        subfolders[:] = [name for name in subfolders if not name.startswith(".")]
        found += [path for path in (Path(folder, name) for name in files) if os.access(path, os.X_OK)]
    return sorted(found)


def interface_packages() -> list[str]:
    """Every package that has interfaces, sorted."""
    return sorted(get_resources("rosidl_interfaces"))


def interfaces(package: str, kinds: tuple[str, ...] = ("msg", "srv", "action")) -> list[str]:
    """The package's interfaces of those kinds as ``msg/Name``, sorted; generated ones (``_Request``) are left out.

    Raises:
        CommandError: if there is no such package.
    """
    if prefix(package) is None:
        raise CommandError(f"Unknown package '{package}'")
    try:
        listing, _ = get_resource("rosidl_interfaces", package)
    except LookupError:
        return []
    names = set()
    for line in listing.splitlines():
        stem, _, suffix = line.rpartition(".")
        kind = stem.split("/", 1)[0]
        if kind in kinds and suffix in _SUFFIXES.get(kind, ()) and "_" not in stem:
            names.add(stem)
    return sorted(names)
