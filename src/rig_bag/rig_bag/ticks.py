"""Keeps the account of a trial's ticks from a bag's contents, as the recorder kept it while it recorded."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Any

from rig_bag import cdr
from rig_bag.account import Account
from rig_bag.contents import Contents, Messages
from rig_bag.errors import BagError
from rig_bag.trial import TRIAL_TYPE, Trial

__all__ = ["account_of", "groups_of", "recorded_counts", "schema_of", "stamps"]

_SECOND = 1_000_000_000
_TRIAL_TOPIC = "/trial/state"
_REPORT_TYPE = "mig_interfaces/msg/NodeReport"


def schema_of(contents: Contents, channel: Messages) -> cdr.Schema:
    """The definition of a channel's messages.

    Raises
    ------
    BagError: the file does not hold it in a form that is read here.
    """
    name, encoding, text = contents.schemas.get(channel.schema, ("", "", b""))
    if encoding != "ros2msg" or channel.encoding != "cdr":
        raise BagError(f"{channel.topic} is stored as {encoding}/{channel.encoding}; only ros2msg/cdr is read here")
    try:
        return cdr.parse(name, text.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise BagError(f"{channel.topic}: the definition of {name} is no text: {error}") from error


def stamps(contents: Contents, channel: Messages) -> list[int] | None:
    """The stamp [ns] of each message; None if its type does not begin with one."""
    if not schema_of(contents, channel).begins_with_stamp:
        return None
    result = []
    for data in channel.data:
        if len(data) < 12:
            raise BagError(f"{channel.topic} holds a message of {len(data)} bytes, which has no room for its stamp")
        seconds, nanoseconds = struct.unpack_from("<iI" if data[1] else ">iI", data, 4)
        result.append(seconds * _SECOND + nanoseconds)
    return result


def groups_of(files: Sequence[Contents]) -> list[str]:
    """The groups of topics that have one message a tick: those that the recorder named, else the rig's own."""
    for contents in files:
        for name, values in contents.metadata:
            if name == "completeness":
                return [key.removeprefix("ticks ") for key in values if key.startswith("ticks ")]
    there = {channel.topic for contents in files for channel in contents.channels.values()}
    trials = [topic for topic in there if topic.endswith(_TRIAL_TOPIC)]
    if len(trials) != 1:
        return []
    # Imported here: it needs ROS, which the bags of other recorders do not.
    from rig_bag.configuration import RecorderConfig

    namespace = trials[0].removesuffix(_TRIAL_TOPIC)
    groups = []
    for group in RecorderConfig().per_tick_topics:
        names = [f"{namespace}/{name}" for name in group.split("|")]
        if any(name in there for name in names):
            groups.append("|".join(names))
    return groups


def account_of(files: Sequence[Contents], groups: Iterable[str]) -> Account:
    """Go through the messages in their order.

    Raises
    ------
    BagError: a message does not fit its definition.
    """
    account = Account(groups)
    for contents in files:
        events: list[tuple[int, Any, Any]] = []
        for channel in contents.channels.values():
            ticks = account.ticks_of(channel.topic)
            if ticks is not None:
                values = stamps(contents, channel)
                if values is not None:
                    events += [(order, ticks, stamp) for order, stamp in zip(channel.order, values, strict=True)]
            elif contents.schemas.get(channel.schema, ("",))[0] in (TRIAL_TYPE, _REPORT_TYPE):
                schema = schema_of(contents, channel)
                of_trial = schema.name == "mig_interfaces/TrialState"
                events += [
                    (order, None, Trial.from_message(message) if of_trial else message)
                    for order, message in zip(channel.order, map(schema.decode, channel.data), strict=True)
                ]
        under_way = -1
        for _, ticks, value in sorted(events, key=lambda event: event[0]):
            if ticks is not None:
                ticks.observe(value)
            elif not isinstance(value, Trial):
                account.note_answers(value.armed_uid, value.ticks_done, value.publishes)
            else:
                if value.under_way:
                    under_way = value.uid
                # What is left over, latched, from a trial before this recording is none of its own.
                if value.uid == under_way:
                    account.follow(value)
    return account


def recorded_counts(files: Sequence[Contents]) -> dict[str, int] | None:
    """How many messages of each topic the recorder says that it wrote; None if it left no account.

    Raises
    ------
    BagError: its account is not of the form that it has.
    """
    for contents in files:
        for name, values in contents.metadata:
            if name == "completeness":
                try:
                    return {key.removeprefix("count "): int(n) for key, n in values.items() if key.startswith("count ")}
                except ValueError as error:
                    raise BagError(f"the record 'completeness' is not what the recorder writes: {error}") from error
    return None
