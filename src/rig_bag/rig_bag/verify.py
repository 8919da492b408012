"""Checks a bag from its bytes: whether it is undamaged, whole, and what it says it is."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from rig_bag import definitions
from rig_bag.account import Account
from rig_bag.contents import Contents, Messages
from rig_bag.errors import BagError
from rig_bag.mcap_audit import Audit, audit
from rig_bag.mcap_scan import read_file
from rig_bag.metadata import EMPTY_START, BagMetadata
from rig_bag.ticks import account_of, groups_of, recorded_counts, schema_of, stamps

__all__ = ["Check", "Verification", "verify"]


@dataclass
class Check:
    """One question that was asked of the bag."""

    name: str
    #: Whether it could be asked at all.
    asked: bool = True
    problems: list[str] = field(default_factory=list)
    #: What is no fault, but should be known.
    notes: list[str] = field(default_factory=list)

    @property
    def result(self) -> str:
        return "failed" if self.problems else "ok" if self.asked else "not checked"


@dataclass
class Verification:
    """All that was found."""

    bag: Path
    checks: list[Check]
    #: Messages by topic, as they are in the files.
    counts: dict[str, int]
    #: Ticks by group of topics, as :meth:`rig_bag.account.Account.report` has them.
    ticks: dict[str, dict[str, Any]]

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not any(check.problems for check in self.checks)

    def mapping(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "bag": str(self.bag),
            "ok": self.ok,
            "checks": [
                {"name": check.name, "result": check.result, "problems": check.problems, "notes": check.notes}
                for check in self.checks
            ],
            "messages": self.counts,
            "ticks": self.ticks,
        }

    def text(self) -> str:
        """For a person."""
        width = max(len(check.name) for check in self.checks)
        lines = [f"{self.bag}: {'undamaged and as it should be' if self.ok else 'NOT as it should be'}", ""]
        for check in self.checks:
            remarks = check.problems + check.notes
            lines.append(f"{check.name:{width}}  {check.result:11}  {remarks[0] if remarks else ''}".rstrip())
            lines += [f"{'':{width}}  {'':11}  {remark}" for remark in remarks[1:]]
        if self.ticks:
            names = [_short(group) for group in self.ticks]
            width = max(map(len, names))
            columns = ("expected", "answered", "received", "missing", "duplicates", "late")
            lines += ["", f"{'one message a tick':{width}}  " + "  ".join(f"{column:>10}" for column in columns)]
            for name, entry in zip(names, self.ticks.values(), strict=True):
                cells = ("-" if entry[column] is None else str(entry[column]) for column in columns)
                lines.append(f"{name:{width}}  " + "  ".join(f"{cell:>10}" for cell in cells))
        return "\n".join(lines)


def _short(group: str) -> str:
    """``/rig/a/b|/rig/a/c`` as ``/rig/a/b|c``."""
    first, *others = group.split("|")
    return "|".join([first, *(name.rpartition("/")[2] for name in others)])


def verify(bag: str | os.PathLike[str]) -> Verification:
    """Check a bag.

    Raises
    ------
    BagError: there is no such bag, or nothing in it that could be checked.
    """
    path = Path(bag)
    if path.is_file() and path.suffix == ".mcap":
        path = path.parent
    if path.is_file():
        raise BagError(f"{path} is no MCAP file; only MCAP bags are checked")
    if not path.is_dir():
        raise BagError(f"there is no bag {path}")
    there = sorted(file.name for file in path.glob("*.mcap"))
    closed = Check("metadata.yaml")
    metadata: BagMetadata | None = None
    try:
        metadata = BagMetadata.load(path)
    except BagError as error:
        closed.problems.append(f"{error}; bag repair makes a valid bag of what is there")
    names = list(metadata.files) if metadata is not None else there
    if not names:
        raise BagError(f"{path} holds no MCAP file; only MCAP bags are checked")
    checks, contents = _files(path, names)
    checks.append(closed)
    closed.problems += [f"{name} is there, and metadata.yaml does not name it" for name in there if name not in names]
    counts: dict[str, int] = {}
    for channel in _channels(contents):
        counts[channel.topic] = counts.get(channel.topic, 0) + len(channel)
    readable = len(contents) == len(names)
    if metadata is not None and readable:
        closed.problems += _against_metadata(metadata, contents, counts)
    else:
        closed.asked = False
    result = Verification(path, checks, counts, {})
    checks += _about_messages(contents, counts, result) if readable else map(_unasked, ("stamps", "ticks"))
    checks.append(_definitions(contents) if contents else _unasked("definitions"))
    return result


def _unasked(name: str) -> Check:
    return Check(name, asked=False)


def _channels(files: Sequence[Contents]) -> Iterator[Messages]:
    for contents in files:
        yield from contents.channels.values()


# -- files -----------------------------------------------------------------------------------------------------------


def _files(path: Path, names: Sequence[str]) -> tuple[list[Check], list[Contents]]:
    structure, checksums, index, summary = map(Check, ("structure", "checksums", "index", "summary"))
    contents = []
    for name in names:
        try:
            found = audit(read_file(path / name), name)
        except BagError as error:
            found = Audit(structure=[str(error)])
        structure.problems += found.structure
        index.problems += [f"{name}: {problem}" for problem in found.index]
        summary.problems += [f"{name}: {problem}" for problem in found.summary]
        if found.contents is None:
            checksums.asked = index.asked = summary.asked = False
            continue
        contents.append(found.contents)
        checksums.notes.append(f"{name}: {_counted(found.checksums) or 'none'} match")
        if found.bare:
            checksums.notes.append(f"{name}: {_counted(found.bare)} carry none")
    return [structure, checksums, index, summary], contents


def _counted(parts: dict[str, int]) -> str:
    return ", ".join(
        name if name in ("summary", "data section") else f"{count} {name}" for name, count in parts.items()
    )


def _against_metadata(metadata: BagMetadata, files: Sequence[Contents], counts: dict[str, int]) -> list[str]:
    problems = []
    said = {entry.name: entry.count for entry in metadata.topics}
    for topic in sorted({*said, *counts}):
        have, says = counts.get(topic), said.get(topic)
        if have != says:
            problems.append(f"{topic}: metadata.yaml says {says} messages, the files hold {have}")
    if metadata.messages != sum(counts.values()):
        problems.append(
            f"metadata.yaml says {metadata.messages} messages in all, the files hold {sum(counts.values())}"
        )
    types = {
        channel.topic: contents.schemas.get(channel.schema, ("",))[0]
        for contents in files
        for channel in contents.channels.values()
    }
    for entry in metadata.topics:
        if types.get(entry.name, entry.type) != entry.type:
            problems.append(f"{entry.name}: metadata.yaml says {entry.type}, the files {types[entry.name]}")
    times = [time for channel in _channels(files) for time in channel.log_times]
    start, duration = (min(times), max(times) - min(times)) if times else (EMPTY_START, 0)
    if times and (metadata.start, metadata.duration) != (start, duration):
        problems.append(
            f"metadata.yaml says start {metadata.start} ns, duration {metadata.duration} ns; it is {start}, {duration}"
        )
    for part, contents in zip(metadata.parts, files, strict=False):
        times = [time for channel in contents.channels.values() for time in channel.log_times]
        start, duration = (min(times), max(times) - min(times)) if times else (EMPTY_START, 0)
        if (part.start, part.duration, part.messages) != (start, duration, len(times)) and len(metadata.parts) > 1:
            problems.append(
                f"metadata.yaml says of {part.path} start {part.start} ns, duration {part.duration} ns, "
                f"{part.messages} messages; it is {start}, {duration}, {len(times)}"
            )
    return problems + _against_copy(metadata, files)


def _against_copy(metadata: BagMetadata, files: Sequence[Contents]) -> list[str]:
    """The last file carries a copy of metadata.yaml."""
    for name, values in files[-1].metadata if files else ():
        if name == "rosbag2" and "serialized_metadata" in values:
            try:
                copy = yaml.safe_load(values["serialized_metadata"])
            except yaml.YAMLError as error:
                return [f"the copy of metadata.yaml in the file is not YAML: {error}"]
            # Other recorders write it before the end, with what they knew by then.
            if (
                metadata.version == 9
                and isinstance(copy, dict)
                and "custom_data" in copy
                and copy != yaml.safe_load(metadata.text())
            ):
                return ["metadata.yaml is not what its copy in the file says"]
    return []


# -- messages --------------------------------------------------------------------------------------------------------


def _about_messages(files: Sequence[Contents], counts: dict[str, int], result: Verification) -> list[Check]:
    times, ticks = Check("stamps"), Check("ticks")
    try:
        groups = groups_of(files)
        account = account_of(files, groups)
        _monotone(files, account, times)
    except BagError as error:
        ticks.problems.append(str(error))
        return [times, ticks]
    result.ticks = account.report()
    for group, entry in result.ticks.items():
        for before, after, missing in entry["gaps"]:
            ticks.problems.append(f"{group}: {missing} missing between the stamps {before} and {after} ns")
        if entry["missing"] and not entry["gaps"]:
            ticks.problems.append(f"{group}: {entry['missing']} missing at the trial's begin or end")
        # Those that its publisher speaks of, it has sent: they were lost on the way.
        sent = min(entry["answered"] or 0, entry["received"] + entry["missing"]) - entry["received"]
        if entry["missing"] and sent > 0:
            ticks.problems.append(f"{group}: {sent} of them were lost on the way: its node says that it answered them")
        if entry["duplicates"]:
            ticks.problems.append(f"{group}: {entry['duplicates']} are there twice")
    ticks.asked = bool(groups)
    recorded = recorded_counts(files)
    if recorded is None:
        ticks.notes.append("the recorder left no account of its own")
    else:
        differ = [topic for topic, count in recorded.items() if counts.get(topic, 0) != count]
        ticks.problems += [
            f"{topic}: the recorder counted {recorded[topic]}, the files hold {counts.get(topic, 0)}"
            for topic in differ
        ]
    if account.trial is not None and not account.trial.ended:
        ticks.notes.append("the bag ends before its trial does: what came after is not in it")
    return [times, ticks]


def _monotone(files: Sequence[Contents], account: Account, check: Check) -> None:
    last: dict[str, int] = {}
    newest: dict[str, int] = {}
    for contents in files:
        for channel in contents.channels.values():
            back = _backwards([last.get(channel.topic, 0), *channel.log_times])
            last[channel.topic] = max([last.get(channel.topic, 0), *channel.log_times[-1:]])
            if back:
                check.problems.append(f"{channel.topic}: the time of reception goes back {back} times")
            if account.ticks_of(channel.topic) is None:
                continue
            values = stamps(contents, channel) or []
            back = _backwards([newest.get(channel.topic, -1), *values])
            newest[channel.topic] = max([newest.get(channel.topic, -1), *values[-1:]])
            if back:
                check.problems.append(f"{channel.topic}: the stamp goes back {back} times")


def _backwards(values: Sequence[int]) -> int:
    return sum(after < before for before, after in itertools.pairwise(values))


def _definitions(files: Sequence[Contents]) -> Check:
    check = Check("definitions")
    seen: set[str] = set()
    for contents in files:
        for channel in contents.channels.values():
            name, _, text = contents.schemas.get(channel.schema, ("", "", b""))
            if name in seen:
                continue
            seen.add(name)
            try:
                recorded = schema_of(contents, channel)
            except BagError as error:
                check.problems.append(str(error))
                continue
            try:
                installed = definitions.full_definition(name)
            except BagError:
                check.notes.append(f"{name} is not installed here, so it is not compared")
                continue
            if text.decode() != installed:
                if definitions.as_installed(recorded):
                    check.notes.append(f"{name}: only comments differ from what is installed")
                else:
                    check.problems.append(f"{name} was recorded with other fields than the installed definition has")
    return check
