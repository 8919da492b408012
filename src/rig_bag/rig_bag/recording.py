"""One recording without ROS: takes (topic, serialised bytes, time of reception), writes them, and knows what it has.

Its shell is :mod:`rig_bag.recorder`. :meth:`Recording.receive` is the hot path.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable, Mapping

from rig_bag import definitions
from rig_bag.account import Account
from rig_bag.continuity import Continuity
from rig_bag.mcap_file import Channel
from rig_bag.qos import Qos
from rig_bag.trial import Trial
from rig_bag.writer import BagWriter

__all__ = ["Recording", "Stream", "Trial"]

_unpack_little = struct.Struct("<iI").unpack_from
_unpack_big = struct.Struct(">iI").unpack_from
_SECOND = 1_000_000_000
_END_OF_STAMP = 12
#: Messages held back in lockstep until the first tick gives them a log time.
_PENDING_LIMIT = 100_000


class Stream:
    """One topic of the recording."""

    __slots__ = ("channel", "name", "stamped", "ticks", "type_name")

    def __init__(self, name: str, type_name: str, channel: Channel, stamped: bool, ticks: Continuity | None) -> None:
        self.name = name
        self.type_name = type_name
        self.channel = channel
        #: Whether the first field is a stamp, or a header, which begins with one.
        self.stamped = stamped
        self.ticks = ticks


class Recording:
    """Writes the messages of a set of topics into one bag and keeps account of ticks.

    Parameters
    ----------
    writer: the open bag; the recording closes it.
    per_tick: topics that have one message a tick; ``a|b|c`` stands for one message on one of the three, and is checked
        but holds up neither the progress nor the end.
    lockstep: take the log time from the newest tick stamp seen instead of from the time of reception, so that the bag
        plays at the trial's rate although it ran faster; likewise the time of publication of what has no stamp. What
        comes before the first tick is held back until there is one.
    progress_ticks: how often the progress moves on before ``on_progress`` is called.
    on_progress: called from :meth:`receive`.
    """

    def __init__(
        self,
        writer: BagWriter,
        *,
        per_tick: Iterable[str] = (),
        lockstep: bool = False,
        progress_ticks: int,
        on_progress: Callable[[], None] | None = None,
    ) -> None:
        self.writer = writer
        self._write = writer.write
        self.account = Account(per_tick)
        #: [ns] newest stamp up to which every per-tick topic is here; -1 before that. Never goes back within a trial.
        self.progress = -1
        self._gating = self.account.gating
        #: How many per-tick topics are no further than the progress: it moves on when none is.
        self._behind = len(self._gating)
        self._lockstep = lockstep
        self._progress_ticks = progress_ticks
        self._on_progress = on_progress
        self._advances = 0
        self._newest = -1
        self._pending: list[tuple[Stream, bytes, int, int, int]] = []
        self._streams: dict[str, Stream] = {}
        #: What the middleware said that it lost, by topic.
        self._lost: dict[str, int] = {}
        self._clock_jumps: list[int] = []

    # -- topics ------------------------------------------------------------------------------------------------------

    def add_topic(self, name: str, type_name: str, qos: Iterable[Qos] = (), type_hash: str | None = None) -> Stream:
        """Declare a topic by its fully qualified name.

        Raises
        ------
        BagError: its type is not installed, or it has another type already.
        """
        channel = self.writer.add_topic(name, type_name, qos, type_hash)
        if name not in self._streams:
            stamped = definitions.begins_with_stamp(type_name)
            ticks = self.account.ticks_of(name) if stamped else None
            self._streams[name] = Stream(name, type_name, channel, stamped, ticks)
        return self._streams[name]

    def streams(self) -> Mapping[str, Stream]:
        return self._streams

    # -- messages ----------------------------------------------------------------------------------------------------

    def receive(self, stream: Stream, data: bytes, now: int, sent: int = 0) -> None:
        """Take one serialised message received at ``now`` and published at ``sent`` [ns] (0: that is not known). A
        stamp of 0 was never set, and is no time of publication.

        Raises
        ------
        BagError: the bag cannot take it (full disk, closed).
        """
        stamp = -1
        if stream.stamped and len(data) >= _END_OF_STAMP:  # what is malformed is recorded too, as it came
            seconds, nanoseconds = _unpack_little(data, 4) if data[1] else _unpack_big(data, 4)
            stamp = seconds * _SECOND + nanoseconds
        ticks = stream.ticks
        if ticks is not None and stamp > self._newest:
            self._newest = stamp
        if not self._lockstep:
            self._write(stream.channel, data, now, stamp if stamp > 0 else sent or now)
        elif self._newest >= 0:
            if self._pending:
                self._write_pending()
            self._write(stream.channel, data, self._newest, stamp if stamp > 0 else self._newest)
        elif len(self._pending) < _PENDING_LIMIT:
            self._pending.append((stream, data, stamp, now, sent))
        else:
            # Nothing ticks here: this is no lockstep run, and the time of reception is all there is.
            self._lockstep = False
            self._write_pending()
            self._write(stream.channel, data, now, stamp if stamp > 0 else sent or now)
        if ticks is not None:
            newest = ticks.newest
            if newest >= 0 < ticks.step == stamp - newest:
                ticks.newest = stamp
                ticks.received += 1
            else:
                ticks.observe(stamp)
            if ticks.gates and newest <= self.progress < ticks.newest:
                self._behind -= 1
                if self._behind == 0:
                    self._advance()

    def _advance(self) -> None:
        """Every per-tick topic is beyond the progress: move it to the slowest of them."""
        progress, behind = self._gating[0].newest, 0
        for ticks in self._gating:
            newest = ticks.newest
            if newest < progress:
                progress, behind = newest, 1
            elif newest == progress:
                behind += 1
        self._behind = behind
        if progress > self.progress:
            self.progress = progress
            self._advances += 1
            if self._advances >= self._progress_ticks:
                self._advances = 0
                if self._on_progress is not None:
                    self._on_progress()

    def _write_pending(self) -> None:
        pending, self._pending = self._pending, []
        tick = self._newest
        for stream, data, stamp, now, sent in pending:
            log_time, published = (tick, tick) if tick >= 0 else (now, sent or now)
            self._write(stream.channel, data, log_time, stamp if stamp > 0 else published)

    # -- the trial ---------------------------------------------------------------------------------------------------

    @property
    def trial(self) -> Trial | None:
        """Its newest state."""
        return self.account.trial

    def follow(self, trial: Trial) -> None:
        """Take note of the trial's state. A new ``uid`` begins a new account of ticks."""
        if self.account.follow(trial):
            self.progress = self._newest = -1
            self._behind = len(self._gating)
        if trial.under_way and self._newest < 0:
            self._newest = trial.epoch
        self.writer.set_custom_data(trial.custom_data())

    def note_answers(self, uid: int, ticks: int, topics: Iterable[str]) -> None:
        """A node says how many ticks of trial ``uid`` it has answered on the topics that it publishes."""
        self.account.note_answers(uid, ticks, topics)

    def note_lost(self, topic: str, count: int) -> None:
        """The middleware says that it lost so many messages of a topic."""
        self._lost[topic] = self._lost.get(topic, 0) + count

    def note_clock_jump(self, nanoseconds: int) -> None:
        """The machine's clock was set by this [ns]; the bag's times do not follow it."""
        self._clock_jumps.append(nanoseconds)

    def complete(self) -> bool:
        """Whether every per-tick topic has come as far as the trial's last tick."""
        return self.account.complete()

    def ticks_received(self) -> int:
        """How many messages of per-tick topics have come so far."""
        return self.account.received()

    def lost(self) -> int:
        """As :meth:`rig_bag.account.Account.lost`, or what the middleware says that it lost, if that is more."""
        return max(self.account.lost(), sum(self._lost.values()))

    def completeness(self) -> dict[str, str]:
        """The account as a map of strings: ``complete`` (true, false, not checked), ``lost``, and more by topic."""
        result = self.account.strings()
        if self._lost:
            result |= {"complete": "false", "lost": str(self.lost())}
        result |= {f"lost by the middleware {name}": str(count) for name, count in self._lost.items()}
        if self._clock_jumps:
            result["clock jumps [ns]"] = json.dumps(self._clock_jumps)
        result |= {"messages": str(self.writer.messages), "bytes": str(self.writer.bytes)}
        return result | {f"count {name}": str(stream.channel.count) for name, stream in self._streams.items()}

    def close(self, reason: str = "") -> None:
        """Write what was held back, the account and the trial into the bag, and close it. Idempotent.

        Raises
        ------
        BagError: something is not in the bag; it is closed all the same.
        """
        writer = self.writer
        if writer.closed:
            return
        try:
            if writer.error is None:
                self._write_pending()
                account = self.completeness()
                writer.set_custom_data(
                    {"complete": account["complete"], "lost": account["lost"], "closed_because": reason}
                )
                if self.trial is not None:
                    writer.add_metadata("trial", {**writer.custom_data, **self.trial.strings()})
                writer.add_metadata("completeness", account)
        finally:
            writer.close()
