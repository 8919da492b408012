"""Makes a valid bag of one that a kill or a power failure cut. The original is only read."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import yaml

from rig_bag.contents import Contents, Messages
from rig_bag.errors import BagError
from rig_bag.mcap_audit import audit
from rig_bag.mcap_file import Channel
from rig_bag.mcap_salvage import Loss, Salvage, salvage
from rig_bag.mcap_scan import read_file
from rig_bag.metadata import BagMetadata
from rig_bag.qos import parse_profiles
from rig_bag.ticks import account_of, groups_of
from rig_bag.writer import BagWriter

__all__ = ["Lost", "Repair", "repair"]

#: Metadata records that the repaired bag writes anew.
_OWN_RECORDS = ("rosbag2", "completeness", "repair")


@dataclass(frozen=True)
class Lost:
    """What one topic lost in one place. Times of reception in nanoseconds.

    Attributes
    ----------
    after: of the last message before that is there; None if there is none.
    until: of the first message after that is there, or when the lost part ended; None: not known, up to the end.
    count: of messages; None: not known.
    """

    topic: str
    after: int | None
    until: int | None
    count: int | None


@dataclass
class Repair:
    """What became of a bag. ``out`` is None if it needed no repair, and nothing was written."""

    bag: Path
    out: Path | None = None
    messages: dict[str, int] = field(default_factory=dict)
    lost: list[Lost] = field(default_factory=list)
    #: What happened to the bytes, as sentences.
    damage: list[str] = field(default_factory=list)
    unchecked: int = 0
    orphans: int = 0

    def mapping(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "bag": str(self.bag), "out": None if self.out is None else str(self.out)}

    def text(self) -> str:
        """For a person."""
        if self.out is None:
            return f"{self.bag} is whole: there is nothing to repair, and nothing was written"
        lines = [f"{self.out}: {sum(self.messages.values())} messages recovered from {self.bag}", *self.damage]
        if self.unchecked:
            lines.append(f"{self.unchecked} messages are from a cut chunk, and no checksum covers them")
        if self.orphans:
            lines.append(f"{self.orphans} messages are whole, and left out: the definition of their topic is lost")
        width = max([len(topic) for topic in self.messages], default=0)
        lines += ["", f"{'topic':{width}}  {'recovered':>9}  lost"]
        for topic, count in self.messages.items():
            places = [_range(lost) for lost in self.lost if lost.topic == topic] or ["nothing"]
            lines.append(f"{topic:{width}}  {count:9}  {'; '.join(places)}")
        return "\n".join(lines)


def _range(lost: Lost) -> str:
    count = "" if lost.count is None else f"{lost.count} messages "
    after = "from the begin" if lost.after is None else f"after {_seconds(lost.after)}"
    return f"{count}{after} {'to the end' if lost.until is None else f'until {_seconds(lost.until)}'}"


def _seconds(nanoseconds: int) -> str:
    return "{}.{:09d} s".format(*divmod(nanoseconds, 1_000_000_000))


def repair(bag: str | os.PathLike[str], out: str | os.PathLike[str] | None = None) -> Repair:
    """Write a valid bag with every complete record of a bag that is not valid.

    Parameters
    ----------
    out: the new bag, which must not exist; by default beside the old one, named as it and ``_repaired``.

    Raises
    ------
    BagError: no bag; nothing in it can be recovered; the new one exists already or cannot be written.
    """
    path = Path(bag)
    if path.is_file() and path.suffix == ".mcap":
        path = path.parent
    if path.is_file():
        raise BagError(f"{path} is no MCAP file; only MCAP bags can be repaired")
    if not path.is_dir():
        raise BagError(f"there is no bag {path}")
    metadata = _metadata(path)
    files = [path / name for name in metadata.files] if metadata is not None else []
    files = [file for file in files if file.is_file()] or sorted(path.glob("*.mcap"), key=_number)
    if not files:
        raise BagError(f"{path} holds no MCAP file; only MCAP bags can be repaired")
    raw = [read_file(file) for file in files]
    result = Repair(path)
    if metadata is not None and _is_valid(raw, metadata):
        return result
    found = [salvage(data, str(file)) for data, file in zip(raw, files, strict=True)]
    if not any(part.contents.channels for part in found):
        raise BagError(f"{path} holds no complete record: there is nothing to recover")
    for file, part in zip(files, found, strict=True):
        result.damage += [_sentence(file.name, loss) for loss in part.losses]
        result.unchecked += part.unchecked
        result.orphans += part.orphans
        result.lost += _lost(part)
    _write(result, found, metadata, Path(out) if out is not None else path.with_name(f"{path.name}_repaired"))
    return result


def _number(path: Path) -> tuple[int, str]:
    """Files in the order in which they were written: by the number at the end of the name."""
    match = re.search(r"(\d+)$", path.stem)
    return (int(match[1]) if match else 0, path.name)


def _metadata(path: Path) -> BagMetadata | None:
    try:
        return BagMetadata.load(path)
    except BagError:
        return None


def _is_valid(raw: Sequence[bytes], metadata: BagMetadata) -> bool:
    counts: dict[str, int] = {}
    for data in raw:
        found = audit(data, "")
        if found.contents is None or found.index or found.summary:
            return False
        for channel in found.contents.channels.values():
            counts[channel.topic] = counts.get(channel.topic, 0) + len(channel)
    return counts == {entry.name: entry.count for entry in metadata.topics}


def _sentence(name: str, loss: Loss) -> str:
    if loss.start == loss.end:
        return f"{name}: {loss.why}"
    return f"{name}: bytes {loss.start} to {loss.end} are lost: {loss.why}"


def _lost(part: Salvage) -> list[Lost]:
    result = []
    for loss in part.losses:
        for identifier, channel in part.contents.channels.items():
            before = [time for time, order in zip(channel.log_times, channel.order, strict=True) if order < loss.before]
            after = [time for time, order in zip(channel.log_times, channel.order, strict=True) if order >= loss.before]
            count = loss.counts.get(identifier, 0) if loss.counts else None
            if count != 0:
                until = after[0] if after else loss.end_time
                result.append(Lost(channel.topic, before[-1] if before else None, until, count))
    return result


# -- the new bag -----------------------------------------------------------------------------------------------------


def _write(result: Repair, found: Sequence[Salvage], metadata: BagMetadata | None, out: Path) -> None:
    files = [part.contents for part in found]
    account = account_of(files, groups_of(files))
    custom = dict(metadata.custom_data) if metadata is not None else {}
    if account.trial is not None:
        custom |= account.trial.custom_data()
    strings = account.strings()
    custom |= {key: strings[key] for key in ("complete", "lost")} | {"closed_because": "repaired", "repaired": "true"}
    with BagWriter(out, custom_data=custom) as writer:
        result.out = writer.path
        for contents in files:
            for name, media_type, data in contents.attachments:
                writer.attach(name, data, media_type)
            _copy(contents, writer, result.messages)
            for name, values in contents.metadata:
                if name not in _OWN_RECORDS:
                    writer.add_metadata(name, values)
        if account.trial is not None and not any(name == "trial" for part in files for name, _ in part.metadata):
            writer.add_metadata("trial", account.trial.strings())
        counts = {f"count {topic}": str(count) for topic, count in result.messages.items()}
        sizes = {"messages": str(writer.messages), "bytes": str(writer.bytes)}
        writer.add_metadata("completeness", {**strings, **sizes, **counts})
        lost = json.dumps([asdict(lost) for lost in result.lost])
        writer.add_metadata("repair", {"source": result.bag.name, "damage": "\n".join(result.damage), "lost": lost})


def _copy(contents: Contents, writer: BagWriter, counts: dict[str, int]) -> None:
    """Every message with its own bytes and times, in the order of the file."""
    sources: list[tuple[int, int, int, Channel, bytes]] = []
    for channel in contents.channels.values():
        if channel.schema not in contents.schemas:
            continue
        target = _declare(contents, channel, writer)
        counts[channel.topic] = counts.get(channel.topic, 0) + len(channel)
        sources += [
            (order, log_time, publish_time, target, data)
            for order, log_time, publish_time, data in zip(
                channel.order, channel.log_times, channel.publish_times, channel.data, strict=True
            )
        ]
    for _, log_time, publish_time, target, data in sorted(sources, key=lambda source: source[0]):
        writer.write(target, data, log_time, publish_time)


def _declare(contents: Contents, channel: Messages, writer: BagWriter) -> Channel:
    name, encoding, text = contents.schemas[channel.schema]
    if encoding != "ros2msg" or channel.encoding != "cdr":
        raise BagError(f"{channel.topic} is stored as {encoding}/{channel.encoding}; only ros2msg/cdr can be repaired")
    try:
        qos = parse_profiles(channel.metadata.get("offered_qos_profiles", ""))
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, KeyError):
        qos = ()
    type_hash = channel.metadata.get("topic_type_hash", "")
    return writer.add_topic(channel.topic, name, qos, type_hash, definition=text.decode("utf-8", "replace"))
