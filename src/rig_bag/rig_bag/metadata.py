"""``metadata.yaml`` of a rosbag2 bag, version 9: what rosbag2 for Jazzy decodes, every field of it, without condition.

Source: rosbag2 for Jazzy, the fields of its bag metadata and their encoding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from rig_bag.errors import BagError
from rig_bag.qos import Qos, parse_profiles

__all__ = ["EMPTY_START", "BagMetadata", "FileEntry", "TopicEntry"]

#: libyaml reads many times faster; what it reads is the same.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

VERSION = 9
#: [ns] the start of a bag that holds no message, as rosbag2 writes it.
EMPTY_START = 2**63 - 1


@dataclass(frozen=True)
class TopicEntry:
    """One topic of a bag."""

    name: str
    type: str
    count: int
    qos: tuple[Qos, ...] = ()
    type_hash: str = ""
    serialization_format: str = "cdr"


@dataclass(frozen=True)
class FileEntry:
    """One file of a bag. Times in nanoseconds since the epoch."""

    path: str
    start: int
    duration: int
    messages: int

    def mapping(self) -> dict[str, Any]:
        return {
            "path": self.path,
            "starting_time": {"nanoseconds_since_epoch": self.start},
            "duration": {"nanoseconds": self.duration},
            "message_count": self.messages,
        }


@dataclass(frozen=True)
class BagMetadata:
    """What a bag says of itself. Times in nanoseconds since the epoch."""

    files: tuple[str, ...]
    start: int
    duration: int
    topics: tuple[TopicEntry, ...]
    custom_data: Mapping[str, str] = field(default_factory=dict)
    ros_distro: str = "jazzy"
    storage: str = "mcap"
    version: int = VERSION
    compression_format: str = ""
    compression_mode: str = ""
    message_count: int = -1
    #: each of the files, where it is known; the bag's own times and count stand for them where it is not
    parts: tuple[FileEntry, ...] = ()

    @property
    def messages(self) -> int:
        return self.message_count if self.message_count >= 0 else sum(topic.count for topic in self.topics)

    def mapping(self) -> dict[str, Any]:
        """The document below ``rosbag2_bagfile_information``."""
        return {
            "version": VERSION,
            "storage_identifier": self.storage,
            "duration": {"nanoseconds": self.duration},
            "starting_time": {"nanoseconds_since_epoch": self.start},
            "message_count": self.messages,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type,
                        "serialization_format": topic.serialization_format,
                        "offered_qos_profiles": [profile.mapping() for profile in topic.qos],
                        "type_description_hash": topic.type_hash,
                    },
                    "message_count": topic.count,
                }
                for topic in self.topics
            ],
            "compression_format": self.compression_format,
            "compression_mode": self.compression_mode,
            "relative_file_paths": list(self.files),
            "files": [
                part.mapping()
                for part in self.parts
                or [FileEntry(path, self.start, self.duration, self.messages) for path in self.files]
            ],
            "custom_data": dict(self.custom_data) or None,
            "ros_distro": self.ros_distro,
        }

    def text(self) -> str:
        """The document that an MCAP ``rosbag2`` metadata record carries."""
        return _dump(self.mapping())

    def file_text(self) -> str:
        """The text of ``metadata.yaml``."""
        return _dump({"rosbag2_bagfile_information": self.mapping()})

    @classmethod
    def load(cls, directory: Path) -> BagMetadata:
        """Read ``metadata.yaml``; versions 4 to 9 are understood.

        Raises
        ------
        BagError: it is missing or not of that form.
        """
        path = directory / "metadata.yaml"
        try:
            document = yaml.load(path.read_bytes(), Loader=_Loader)  # noqa: S506 a safe one
        except FileNotFoundError:
            raise BagError(
                f"{directory} has no metadata.yaml: it is no bag, or its recorder did not close it"
            ) from None
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise BagError(f"{path} cannot be read: {error}") from error
        try:
            return cls._parse(document["rosbag2_bagfile_information"])
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise BagError(f"{path} is not the metadata of a rosbag2 bag ({type(error).__name__}: {error})") from error

    @classmethod
    def _parse(cls, data: Mapping[str, Any]) -> BagMetadata:
        topics = []
        for entry in data["topics_with_message_count"]:
            topic = entry["topic_metadata"]
            offered = topic.get("offered_qos_profiles") or ()
            qos = parse_profiles(offered) if isinstance(offered, str) else tuple(Qos.from_mapping(q) for q in offered)
            topics.append(
                TopicEntry(
                    name=_text(topic["name"]),
                    type=_text(topic["type"]),
                    count=int(entry["message_count"]),
                    qos=qos,
                    type_hash=topic.get("type_description_hash") or "",
                    serialization_format=topic["serialization_format"],
                )
            )
        return cls(
            files=tuple(map(_text, data["relative_file_paths"])),
            start=int(data["starting_time"]["nanoseconds_since_epoch"]),
            duration=int(data["duration"]["nanoseconds"]),
            topics=tuple(topics),
            custom_data={str(key): str(value) for key, value in (data.get("custom_data") or {}).items()},
            ros_distro=data.get("ros_distro") or "",
            storage=data["storage_identifier"],
            version=int(data["version"]),
            compression_format=data.get("compression_format") or "",
            compression_mode=data.get("compression_mode") or "",
            message_count=int(data["message_count"]),
            parts=tuple(
                FileEntry(
                    path=_text(file["path"]),
                    start=int(file["starting_time"]["nanoseconds_since_epoch"]),
                    duration=int(file["duration"]["nanoseconds"]),
                    messages=int(file["message_count"]),
                )
                for file in data.get("files") or ()
            ),
        )


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


class _Dumper(yaml.SafeDumper):
    """Repeats what is equal instead of referring to it, which simpler readers do not follow."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _dump(document: Any) -> str:
    return str(
        yaml.dump(document, Dumper=_Dumper, sort_keys=False, default_flow_style=False, allow_unicode=True, width=1000)
    )
