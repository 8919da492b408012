"""Quality of service: the ``--qos-*`` arguments, and profiles that match those who publish."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSPresetProfiles,
    QoSProfile,
    QoSReliabilityPolicy,
)

from ros2_fallback.command import non_negative_int

__all__ = ["add_qos_arguments", "is_given", "matching_profile", "profile_from_arguments"]

#: The presets, untyped in rclpy.
_PRESETS: Any = QoSPresetProfiles
_POLICIES: dict[str, Any] = {
    "history": QoSHistoryPolicy,
    "reliability": QoSReliabilityPolicy,
    "durability": QoSDurabilityPolicy,
    "liveliness": QoSLivelinessPolicy,
}


def add_qos_arguments(parser: argparse.ArgumentParser, default_profile: str) -> None:
    """Declare the ``--qos-*`` arguments; the presets start from `default_profile`."""
    group = parser.add_argument_group("quality of service")
    group.add_argument(
        "--qos-profile",
        choices=_PRESETS.short_keys(),
        default=default_profile,
        help=f"preset that the others change (default: {default_profile})",
    )
    group.add_argument("--qos-depth", type=non_negative_int, metavar="N", help="length of the queue")
    for name, policy in _POLICIES.items():
        group.add_argument(f"--qos-{name}", choices=policy.short_keys(), help=f"{name} policy")
    group.add_argument(
        "--qos-liveliness-lease-duration-seconds", type=float, metavar="S", help="lease duration of the liveliness"
    )


def is_given(args: argparse.Namespace) -> bool:
    """Whether any policy was given besides the preset."""
    names = ("depth", *_POLICIES, "liveliness_lease_duration_seconds")
    return any(getattr(args, f"qos_{name}") is not None for name in names)


def profile_from_arguments(args: argparse.Namespace) -> QoSProfile:
    """The preset with the policies that were given."""
    profile = _preset(args.qos_profile)
    for name, policy in _POLICIES.items():
        key = getattr(args, f"qos_{name}")
        if key is not None:
            setattr(profile, name, policy.get_from_short_key(key))
    lease = args.qos_liveliness_lease_duration_seconds
    if lease is not None and lease >= 0.0:
        profile.liveliness_lease_duration = Duration(seconds=lease)
    if args.qos_depth is not None:
        profile.depth = args.qos_depth
    elif profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL and profile.depth == 0:
        profile.depth = 1
    return profile


def _preset(name: str) -> QoSProfile:
    """A copy of a preset: the presets themselves are shared."""
    profile: QoSProfile = copy.copy(_PRESETS.get_from_short_key(name))
    return profile


def matching_profile(publishers: Sequence[Any], preset: str = "sensor_data", depth: int | None = None) -> QoSProfile:
    """The preset, reliable and transient local as far as every publisher offers it.

    Asking for less than some of them offer connects to all of them; where they differ, that is said on stdout.

    Args:
        publishers: of the topic, as rclpy's TopicEndpointInfo.
        preset: short key of the profile to start from.
        depth: length of the queue, None: the preset's.
    """
    profile = _preset(preset)
    if depth is not None:
        profile.depth = depth
    if not publishers:
        return profile
    profile.reliability = _offered_by_all(
        [publisher.qos_profile.reliability for publisher in publishers],
        QoSReliabilityPolicy.RELIABLE,
        QoSReliabilityPolicy.BEST_EFFORT,
    )
    profile.durability = _offered_by_all(
        [publisher.qos_profile.durability for publisher in publishers],
        QoSDurabilityPolicy.TRANSIENT_LOCAL,
        QoSDurabilityPolicy.VOLATILE,
    )
    return profile


def _offered_by_all(offers: Sequence[Any], strong: Any, weak: Any) -> Any:
    count = sum(offer == strong for offer in offers)
    if count == len(offers):
        return strong
    if count:
        policy = type(strong).__name__
        print(
            f"Some, but not all, publishers are offering {policy}.{strong.name}. "
            f"Falling back to {policy}.{weak.name} as it will connect to all publishers"
        )
    return weak
