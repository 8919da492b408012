"""Writing a bag: a directory ``NAME/`` with ``metadata.yaml`` and ``NAME_0.mcap`` (if it is split, ``NAME_1.mcap`` and
so on), as rosbag2 lays it out.

Source: rosbag2 for Jazzy (``metadata.yaml`` version 9, MCAP profile ``ros2``, schemas ``ros2msg``, messages ``cdr``).
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from rig_bag import definitions
from rig_bag.errors import BagError
from rig_bag.mcap_file import Channel, McapFile
from rig_bag.metadata import EMPTY_START, BagMetadata, FileEntry, TopicEntry
from rig_bag.qos import Qos, profiles_text

__all__ = ["BagWriter"]


class _DiskSync:
    """Puts the file on the disk from a thread of its own, so that nobody waits for the disk."""

    def __init__(self, file: McapFile) -> None:
        self._file = file
        self._finished: list[McapFile] = []
        self._wanted = threading.Event()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="bag-sync", daemon=True)
        self._thread.start()

    def request(self) -> None:
        self._wanted.set()

    def go_on(self, file: McapFile) -> None:
        """The file is finished, and this one comes after it."""
        self._finished.append(self._file)
        self._file = file
        self._wanted.set()

    def stop(self) -> None:
        self._stopped = True
        self._wanted.set()
        self._thread.join()
        for file in self._finished:
            file.close()

    def _run(self) -> None:
        while True:
            self._wanted.wait()
            self._wanted.clear()
            stopped = self._stopped
            try:
                while self._finished:
                    self._finished[0].sync()
                    self._finished.pop(0).close()
                if stopped:
                    return
                self._file.sync()
            except OSError:
                # The next write or the close meets the same fault and reports it.
                return


class BagWriter:
    """Writes one bag. A context manager; :meth:`close` is idempotent and leaves a valid bag whatever happened before.

    Parameters
    ----------
    uri: directory of the bag; it must not exist yet. Missing parents are made.
    custom_data: what ``metadata.yaml`` carries under ``custom_data``.
    chunk_size: [B] uncompressed size at which a chunk is closed.
    level: of zstd.
    max_size: [B] a file that has reached this is followed by another; looked at when a chunk is closed. 0: no limit.
    max_duration: [ns] of log time; a message that is as far as this from the file's first begins another. 0: no limit.

    Raises
    ------
    BagError: the directory exists or cannot be made, or the file cannot be written.
    """

    def __init__(
        self,
        uri: str | os.PathLike[str],
        *,
        custom_data: Mapping[str, str] | None = None,
        chunk_size: int = 64 * 1024,
        level: int = 1,
        max_size: int = 0,
        max_duration: int = 0,
    ) -> None:
        self.path = Path(uri).absolute()
        self.error: BagError | None = None
        self.messages = 0
        self.bytes = 0
        self._splits = max_size > 0 or max_duration > 0
        self._max_size, self._max_duration = max_size or 2**63, max_duration or 2**63
        self._options: dict[str, Any] = {"chunk_size": chunk_size, "level": level}
        #: Of the files before this one: what metadata.yaml says of each, and their messages by topic.
        self._before: list[FileEntry] = []
        self._counts_before: dict[str, int] = {}
        #: Log time of this file's first message; -1 before it.
        self._first = -1
        self._custom = {str(key): str(value) for key, value in (custom_data or {}).items()}
        self._topics: dict[str, tuple[str, tuple[Qos, ...], str, Channel]] = {}
        self._schemas: dict[str, int] = {}
        self._closed = False
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.mkdir()
        except FileExistsError:
            raise BagError(f"{self.path} exists already; a bag is never overwritten, choose another name") from None
        except OSError as error:
            raise BagError(f"cannot make the bag {self.path}: {error.strerror}") from error
        self.file = self._name(0)
        try:
            self._mcap = McapFile(self.file, **self._options)
        except OSError as error:
            self.file.unlink(missing_ok=True)
            self.path.rmdir()
            raise BagError(f"cannot write {self.file}: {error.strerror}") from error
        self._sync = _DiskSync(self._mcap)

    def _name(self, number: int) -> Path:
        return self.path / f"{self.path.name}_{number}.mcap"

    @property
    def closed(self) -> bool:
        return self._closed

    def topics(self) -> tuple[str, ...]:
        return tuple(self._topics)

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Iterable[Qos] = (),
        type_hash: str | None = None,
        definition: str | None = None,
    ) -> Channel:
        """Declare a topic; declaring it again with the same type returns the same channel.

        Parameters
        ----------
        name: fully qualified.
        type_name: such as ``std_msgs/msg/String``.
        qos: what its publishers offer.
        type_hash: from the publisher; by default that of the installed type.
        definition: full text of the type; by default that of the installed one.

        Raises
        ------
        BagError: the type is not installed, or the topic has another type already.
        """
        known = self._topics.get(name)
        if known is not None:
            if known[0] != type_name:
                raise BagError(f"topic {name} has the type {known[0]} in {self.path}; it cannot take a {type_name} too")
            return known[3]
        self._check_open()
        if type_name not in self._schemas:
            text = definitions.full_definition(type_name) if definition is None else definition
            self._schemas[type_name] = self._mcap.add_schema(type_name, "ros2msg", text.encode("utf-8"))
        if type_hash is None:
            type_hash = definitions.type_hash(type_name)
        profiles = tuple(qos)
        channel = self._mcap.add_channel(
            name,
            self._schemas[type_name],
            "cdr",
            {"offered_qos_profiles": profiles_text(profiles), "topic_type_hash": type_hash},
        )
        self._topics[name] = (type_name, profiles, type_hash, channel)
        return channel

    def write(self, channel: Channel, data: bytes, log_time: int, publish_time: int) -> None:
        """Append one serialised message. Times in nanoseconds since the epoch.

        Raises
        ------
        BagError: the disk refused (now or before), or the bag is closed. The bag should then be closed.
        """
        if self._closed or self.error is not None:
            self._check_open()
        try:
            if self._splits:
                self._make_room(log_time)
            self._mcap.write(channel, data, log_time, publish_time)
        except OSError as error:
            raise self._failed(error) from error
        self.messages += 1
        self.bytes += len(data)

    def _make_room(self, log_time: int) -> None:
        """Go on to another file if this one is as large, or as long, as it may become."""
        if self._first < 0:
            self._first = log_time
        elif self._mcap.size >= self._max_size or log_time - self._first >= self._max_duration:
            self._mcap.flush()
            file = self._name(len(self._before) + 1)
            following = McapFile(file, **self._options, declared=self._mcap.declared)
            try:
                self._finish_file()
            except OSError:
                following.close()
                file.unlink()
                raise
            self._before.append(self._entry())
            self._counts_before = self._counts()
            self._sync.go_on(following)
            self._mcap, self.file, self._first = following, file, log_time

    @property
    def custom_data(self) -> Mapping[str, str]:
        """What ``custom_data`` will say."""
        return self._custom

    def set_custom_data(self, values: Mapping[str, str]) -> None:
        """Add to what ``custom_data`` will say when the bag is closed."""
        self._custom.update({str(key): str(value) for key, value in values.items()})

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record of this name into the MCAP file. Raises BagError as :meth:`write` does."""
        self._check_open()
        try:
            self._mcap.add_metadata(name, {str(key): str(value) for key, value in values.items()})
        except OSError as error:
            raise self._failed(error) from error

    def attach(
        self, name: str, data: bytes, media_type: str = "application/octet-stream", create_time: int = 0
    ) -> None:
        """Write a file (a scenario, say) into the MCAP file. Raises BagError as :meth:`write` does."""
        self._check_open()
        try:
            self._mcap.add_attachment(name, media_type, data, time.time_ns(), create_time)
        except OSError as error:
            raise self._failed(error) from error

    def flush(self) -> None:
        """Hand everything to the operating system at once, and to the disk in the background."""
        self._check_open()
        try:
            self._mcap.flush()
        except OSError as error:
            raise self._failed(error) from error
        self._sync.request()

    def metadata(self) -> BagMetadata:
        """What is in the bag now (what is buffered is not)."""
        files = [*self._before, self._entry()]
        begun = [file for file in files if file.messages]
        start = min((file.start for file in begun), default=EMPTY_START)
        counts = self._counts()
        return BagMetadata(
            files=tuple(file.path for file in files),
            parts=tuple(files),
            start=start,
            duration=max((file.start + file.duration for file in begun), default=start) - start,
            topics=tuple(
                TopicEntry(name, type_name, counts[name], qos, type_hash)
                for name, (type_name, qos, type_hash, _) in self._topics.items()
            ),
            custom_data=self._custom,
            ros_distro=os.environ.get("ROS_DISTRO") or "jazzy",
        )

    def _entry(self) -> FileEntry:
        """What metadata.yaml says of the file that is written now."""
        messages = sum(self._mcap.counts().values())
        start, end = self._mcap.times() if messages else (EMPTY_START, EMPTY_START)
        return FileEntry(self.file.name, start, end - start, messages)

    def _counts(self) -> dict[str, int]:
        return {name: self._counts_before.get(name, 0) + count for name, count in self._mcap.counts().items()}

    def close(self) -> None:
        """Write what is buffered, the summary and ``metadata.yaml``, and put all of it on the disk.

        Where space runs out, the last chunks give way until the rest is a valid bag.

        Raises
        ------
        BagError: something that :meth:`write` had taken is not in the bag. The bag is closed and as complete as
            possible.
        """
        if self._closed:
            return
        self._closed = True
        self._sync.stop()
        before = self.error
        try:
            if self.error is None:
                try:
                    self._mcap.flush()
                except OSError as error:
                    self._failed(error)
            self._finish()
        finally:
            self._mcap.close()
        if self.error is not before:
            assert self.error is not None
            raise self.error

    def _finish(self) -> None:
        while True:
            try:
                self._write_yaml(self._finish_file())
                self._mcap.sync()
                return
            except OSError as error:
                self._failed(error)
                if error.errno not in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT) or not self._mcap.drop():
                    return

    def _finish_file(self) -> BagMetadata:
        """Give this file its end, and what the bag holds up to it."""
        metadata = self.metadata()
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": metadata.text()})
        self._mcap.finish()
        return metadata

    def _write_yaml(self, metadata: BagMetadata) -> None:
        partial = self.path / "metadata.yaml.part"
        try:
            with partial.open("w", encoding="utf-8") as stream:
                stream.write(metadata.file_text())
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(self.path / "metadata.yaml")
        except OSError:
            partial.unlink(missing_ok=True)
            raise

    def _failed(self, error: OSError) -> BagError:
        if self.error is None:
            self.error = BagError(f"cannot write {self.file}: {error.strerror} (after {self.messages} messages)")
        return self.error

    def _check_open(self) -> None:
        if self.error is not None:
            raise self.error
        if self._closed:
            raise BagError(f"{self.path} is closed")

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except BagError:
            # An error that is already on its way says more than that of the close.
            if value is None:
                raise
