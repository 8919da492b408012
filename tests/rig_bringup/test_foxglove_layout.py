"""The layout for Foxglove names panels that it has, and topics and fields that the rig has."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig_runtime import topics

LAYOUT = json.loads((Path(__file__).resolve().parents[2] / "config" / "foxglove_layout.json").read_text())
KNOWN = {f"/rig/{topic.name}": topic.type for topic in vars(topics).values() if isinstance(topic, topics.Topic)}


def leaves(part: Any) -> Iterator[str]:
    if isinstance(part, str):
        yield part
    else:
        yield from leaves(part["first"])
        yield from leaves(part["second"])


def paths(part: Any) -> Iterator[str]:
    """Everything that looks like a topic, with a field or without."""
    if isinstance(part, dict):
        for key, value in part.items():
            yield from paths(key)
            yield from paths(value)
    elif isinstance(part, list):
        for item in part:
            yield from paths(item)
    elif isinstance(part, str) and part.startswith("/rig/"):
        yield part


def test_every_panel_is_placed_and_configured() -> None:
    placed = list(leaves(LAYOUT["layout"]))
    assert sorted(placed) == sorted(LAYOUT["configById"])


def test_every_path_is_a_field_of_a_topic() -> None:
    found = list(paths(LAYOUT["configById"]))
    assert len(found) > 8
    for path in found:
        topic, *fields = re.sub(r"\[\d+\]", "", path).split(".")
        message = KNOWN[topic]()
        for field in fields:
            message = getattr(message, field)
