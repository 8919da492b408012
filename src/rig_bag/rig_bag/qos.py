"""Quality of service as bags store it: rosbag2's names and layout, independent of rclpy.

Source: the fields and their spelling are those of ``metadata.yaml`` version 9 (rosbag2 for Jazzy), where every policy
is its lower-case name and every duration a pair of seconds and nanoseconds.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rig_bag.errors import BagError

__all__ = ["INFINITE", "Qos", "load_overrides", "parse_profiles", "profiles_text"]

#: [ns] what the middleware calls an infinite duration.
INFINITE = 2**63 - 1

_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")


@dataclass(frozen=True)
class Qos:
    """One offered profile; durations in nanoseconds, policies by name."""

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline: int = INFINITE
    lifespan: int = INFINITE
    liveliness: str = "automatic"
    liveliness_lease_duration: int = INFINITE
    avoid_ros_namespace_conventions: bool = False

    @classmethod
    def from_rclpy(cls, profile: Any) -> Qos:
        """Translate an ``rclpy.qos.QoSProfile`` (as endpoint information carries it)."""
        return cls(
            history=profile.history.name.lower(),
            depth=int(profile.depth),
            reliability=profile.reliability.name.lower(),
            durability=profile.durability.name.lower(),
            deadline=profile.deadline.nanoseconds,
            lifespan=profile.lifespan.nanoseconds,
            liveliness=profile.liveliness.name.lower(),
            liveliness_lease_duration=profile.liveliness_lease_duration.nanoseconds,
            avoid_ros_namespace_conventions=bool(profile.avoid_ros_namespace_conventions),
        )

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> Qos:
        """Translate one entry of ``offered_qos_profiles``; unknown keys are ignored, missing ones take the default."""
        values: dict[str, Any] = {}
        for name in cls.__dataclass_fields__:
            if name not in mapping:
                continue
            value = mapping[name]
            if name in _DURATIONS:
                value = int(value["sec"]) * 1_000_000_000 + int(value["nsec"])
            values[name] = value
        return cls(**values)

    def to_rclpy(self) -> Any:
        """As an ``rclpy.qos.QoSProfile``."""
        # Imported here: bags are read where ROS is not installed.
        from rclpy import duration, qos

        policies = {
            "history": qos.HistoryPolicy,
            "reliability": qos.ReliabilityPolicy,
            "durability": qos.DurabilityPolicy,
            "liveliness": qos.LivelinessPolicy,
        }
        values = {name: kind[getattr(self, name).upper()] for name, kind in policies.items()}
        values |= {name: duration.Duration(nanoseconds=getattr(self, name)) for name in _DURATIONS}
        return qos.QoSProfile(
            depth=self.depth, avoid_ros_namespace_conventions=self.avoid_ros_namespace_conventions, **values
        )

    def mapping(self) -> dict[str, Any]:
        """The profile in the order and spelling of ``metadata.yaml`` version 9."""
        result: dict[str, Any] = {}
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if name in _DURATIONS:
                value = dict(zip(("sec", "nsec"), divmod(value, 1_000_000_000), strict=True))
            result[name] = value
        return result


def profiles_text(profiles: Iterable[Qos]) -> str:
    """The YAML text that an MCAP channel carries as ``offered_qos_profiles``."""
    entries = [profile.mapping() for profile in profiles]
    return str(yaml.safe_dump(entries, sort_keys=False, default_flow_style=False)).strip()


def parse_profiles(text: str) -> tuple[Qos, ...]:
    """Inverse of :func:`profiles_text`; numbers as policies (before version 9) are read as their names."""
    entries = yaml.safe_load(text) if text else None
    return tuple(Qos.from_mapping(_named(entry)) for entry in entries or ())


_NUMBERS = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown"),
    "durability": ("system_default", "transient_local", "volatile", "unknown"),
    "liveliness": ("system_default", "automatic", "unknown", "manual_by_topic", "unknown"),
}


def _named(entry: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(entry)
    for key, names in _NUMBERS.items():
        value = result.get(key)
        if isinstance(value, int):
            result[key] = names[value] if value < len(names) else "unknown"
    return result


_POLICIES = {
    "history": ("keep_last", "keep_all", "system_default"),
    "reliability": ("reliable", "best_effort", "system_default", "best_available"),
    "durability": ("volatile", "transient_local", "system_default", "best_available"),
    "liveliness": ("automatic", "manual_by_topic", "system_default", "best_available"),
}


def load_overrides(path: str | os.PathLike[str]) -> dict[str, Qos]:
    """Profiles by topic from a YAML file, as ``ros2 bag --qos-profile-overrides-path`` takes it.

    What an entry does not name has the default of a profile: ``keep_last`` 10, ``reliable``, ``volatile``, and no
    deadline, lifespan or lease. A duration is ``{sec: 1, nsec: 0}``.

    Raises
    ------
    BagError: the file cannot be read, or says something that is no profile; where, and what would be one.
    """
    try:
        document = yaml.safe_load(Path(path).read_bytes())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BagError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if not isinstance(document, Mapping):
        raise BagError(f"{path}: a map of topics to profiles is wanted, as in /topic: {{reliability: best_effort}}")
    return {str(topic): _override(f"{path}: {topic}", entry) for topic, entry in document.items()}


def _override(where: str, entry: Any) -> Qos:
    if not isinstance(entry, Mapping):
        raise BagError(f"{where}: a map of policies is wanted, not {entry!r}")
    unknown = [str(key) for key in entry if key not in Qos.__dataclass_fields__]
    if unknown:
        raise BagError(
            f"{where}: there is no policy {', '.join(unknown)}; there are {', '.join(Qos.__dataclass_fields__)}"
        )
    for name, allowed in _POLICIES.items():
        if entry.get(name, allowed[0]) not in allowed:
            raise BagError(f"{where}: {name} is one of {', '.join(allowed)}, not {entry[name]!r}")
    for name in _DURATIONS:
        parts = entry.get(name, {"sec": 0, "nsec": 0})
        if not isinstance(parts, Mapping) or not all(_is_count(parts.get(key)) for key in ("sec", "nsec")):
            raise BagError(f"{where}: {name} is written {{sec: 1, nsec: 0}}, not {parts!r}")
    if not _is_count(entry.get("depth", 1)):
        raise BagError(f"{where}: depth is a number of messages, not {entry['depth']!r}")
    if not isinstance(entry.get("avoid_ros_namespace_conventions", False), bool):
        raise BagError(f"{where}: avoid_ros_namespace_conventions is true or false")
    return Qos.from_mapping(entry)


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
