"""The sessions that an operator may choose from: the protocols that are there, and how far each subject is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rig_study.declared import StudyError
from rig_study.protocol import Protocol, load_protocol
from rig_study.session import LOG, Progress, is_led

__all__ = ["Choice", "Studies", "Subject"]

#: [characters] No longer name of a protocol is offered.
_LONGEST_NAME = 80


@dataclass(frozen=True)
class Subject:
    """A subject of a protocol and how far its session is; or, without a name, a protocol that cannot be used."""

    protocol: str
    title: str = ""
    name: str = ""
    group: str = ""
    done: int = 0
    planned: int = 0
    #: Why it cannot be chosen; empty if it can.
    problem: str = ""


@dataclass(frozen=True)
class Choice:
    """A session that can be led."""

    protocol: Protocol
    subject: str
    folder: Path

    def __str__(self) -> str:
        return f"{self.subject} of {self.protocol.file.path.stem}"


class Studies:
    """Protocols by their names, which are those of their files, and the sessions of their subjects.

    What is on the disk is looked at each time; what has not changed is not read again.

    Parameters
    ----------
    sources: files of protocols, and folders that hold some.
    sessions: where the sessions of a protocol are, a folder for each subject, by the protocol's name.
    """

    def __init__(self, sources: Sequence[Path], sessions: Callable[[str], Path]) -> None:
        self._sources = sources
        self._sessions = sessions
        self._read: dict[Path, tuple[Any, Any]] = {}

    def listing(self) -> tuple[Subject, ...]:
        """Everyone, protocol by protocol in the order of their names, in the order of enrolment."""
        return tuple(subject for name, paths in self._files().items() for subject in self._subjects(name, paths))

    def choose(self, protocol: str, subject: str) -> Choice:
        """The session of a subject, for a conductor to open.

        Raises
        ------
        StudyError: there is no such protocol or subject, or it has done all trials, or another conductor leads it.
        """
        files = self._files()
        if protocol not in files:
            listing = f"there are {', '.join(files)}" if files else "there is none"
            raise StudyError(f"there is no protocol {protocol[:_LONGEST_NAME]!r}; {listing}")
        loaded = self._protocol(protocol, files[protocol])
        folder = self._sessions(protocol) / subject
        planned = len(loaded.plan(subject))
        if self._done(loaded, subject) == planned:
            raise StudyError(f"{subject} of {protocol} has done all {planned} trials")
        if is_led(folder):
            raise StudyError(f"{subject} of {protocol} is being led already, by the conductor that has {folder}")
        return Choice(loaded, subject, folder)

    def _files(self) -> dict[str, list[Path]]:
        paths: set[Path] = set()
        for source in self._sources:
            paths |= {path.resolve() for path in (source.glob("*.yaml") if source.is_dir() else [source])}
        files: dict[str, list[Path]] = {}
        for path in sorted(paths, key=lambda path: (path.stem, path)):
            if path.stem.isprintable() and len(path.stem) <= _LONGEST_NAME:
                files.setdefault(path.stem, []).append(path)
        return files

    def _subjects(self, name: str, paths: list[Path]) -> Iterator[Subject]:
        try:
            protocol = self._protocol(name, paths)
        except StudyError as error:
            yield Subject(name, problem=str(error))
            return
        planned = sum(set_.trials for set_ in protocol.sets.values())
        for subject, group in protocol.subjects.items():
            shared = Subject(name, protocol.study.title, subject, group, planned=planned)
            try:
                done = self._done(protocol, subject)
            except StudyError as error:
                yield replace(shared, problem=str(error))
                continue
            yield replace(shared, done=done, problem="has done all trials" if done == planned else "")

    def _protocol(self, name: str, paths: list[Path]) -> Protocol:
        if len(paths) > 1:
            raise StudyError(f"{len(paths)} files are named {name}: {', '.join(map(str, paths))}; rename all but one")
        return self._unless_read(paths[0], "", lambda: load_protocol(paths[0]))

    def _done(self, protocol: Protocol, subject: str) -> int:
        log = self._sessions(protocol.file.path.stem) / subject / LOG

        def read() -> int:
            progress = Progress(protocol, subject)
            progress.read(log)
            return len(progress.done)

        return self._unless_read(log, protocol.name, read) if log.exists() else 0

    def _unless_read(self, path: Path, with_: str, read: Callable[[], Any]) -> Any:
        """What was read of a file, or why it could not be; from before if the file is the same."""
        try:
            there = path.stat()
            key = (there.st_mtime_ns, there.st_size, with_)
            if path not in self._read or self._read[path][0] != key:
                try:
                    self._read[path] = (key, read())
                except StudyError as error:
                    self._read[path] = (key, error)
        except OSError as error:
            raise StudyError(f"{path}: cannot be read: {error.strerror or error}") from None
        found = self._read[path][1]
        if isinstance(found, StudyError):
            raise StudyError(str(found))
        return found
