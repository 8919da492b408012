"""Quality of service as bags store it: rosbag2's names and layout, independent of rclpy.

Source: the fields and their spelling are those of ``metadata.yaml`` version 9 (rosbag2 for Jazzy), where every policy
is its lower-case name and every duration a pair of seconds and nanoseconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

__all__ = ["INFINITE", "Qos", "parse_profiles", "profiles_text"]

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
