"""A subject's session as an append-only log: which trial comes next, and under which name.

Each line of ``session.jsonl`` is one event. A trial's start is on the disk before the trial starts, so that whatever
ends the conductor, the next one knows that this name is used: it goes on with the same trial as another attempt.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any

from rig_study.declared import StudyError
from rig_study.protocol import PlannedTrial, Protocol

__all__ = ["LOG", "Progress", "Session", "events", "is_led"]

LOG = "session.jsonl"


class Progress:
    """What a session's events add up to: which trials have run to their end, and how often each was started."""

    def __init__(self, protocol: Protocol, subject: str) -> None:
        self.protocol, self.subject = protocol, subject
        self.plan = protocol.plan(subject)
        self.attempts: Counter[int] = Counter()
        self.done: set[int] = set()
        self.aborted = 0
        self.last = ""

    def read(self, path: Path) -> None:
        """Take the events of a log.

        Raises
        ------
        StudyError: it is that of another protocol or subject.
        """
        for event in events(path):
            if (event["study"], event["subject"]) != (self.protocol.name, self.subject):
                raise StudyError(
                    f"{path}: is the session of {event['subject']} in {event['study']}, not of {self.subject} in "
                    f"{self.protocol.name}; use another folder, or the protocol as it was"
                )
            self.take(event)

    def take(self, event: dict[str, Any]) -> None:
        """Take one event."""
        what, position = event["event"], event.get("position", 0)
        if what == "started":
            self.attempts[position] = event["attempt"]
        elif what == "finished":
            self.done.add(position)
        elif what == "repeat":
            self.done.discard(position)
        elif what == "aborted":
            self.aborted += 1
        self.last = f"{event['time'][:19].replace('T', ' ')} {what} {event.get('trial', '')}".strip()

    def next(self) -> PlannedTrial | None:
        """The first trial of the plan that has not run to its end, as the attempt that it will be; None after all."""
        for trial in self.plan:
            if trial.position not in self.done:
                return replace(trial, attempt=self.attempts[trial.position] + 1)
        return None

    @property
    def remaining(self) -> float:
        """Trials and breaks that are left [s], without what lies between them."""
        length = self.protocol.study.duration
        return sum(length + trial.break_before for trial in self.plan if trial.position not in self.done)


class Session:
    """One subject's session in a folder of its own. A context manager: one conductor at a time has it.

    Raises
    ------
    StudyError: another conductor has the session, or its log is of another protocol or subject.
    """

    def __init__(self, protocol: Protocol, subject: str, folder: Path) -> None:
        self.folder = folder
        self.progress = Progress(protocol, subject)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / LOG
        self._log = path.open("ab")
        try:
            fcntl.flock(self._log, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.progress.read(path)
        except BlockingIOError:
            self._log.close()
            raise StudyError(f"{folder}: another conductor is running this session") from None
        except BaseException:
            self._log.close()
            raise
        text = path.read_bytes()
        if text and not text.endswith(b"\n"):
            # The machine went down in the middle of a line: what is there stays, and reads as nothing.
            self._log.write(b"\n")
        self.note("opened")

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, trial: PlannedTrial, **more: Any) -> None:
        """To be called before the trial begins; ``more`` is noted with it."""
        self._write("started", trial, seed=trial.seed, mode=trial.mode, **more)

    def finish(self, trial: PlannedTrial, bag: str) -> None:
        """It ran to its end, and its bag is closed."""
        self._write("finished", trial, bag=bag)

    def abort(self, trial: PlannedTrial, reason: str, bag: str = "") -> None:
        """It did not run to its end, and is to be done again."""
        self._write("aborted", trial, reason=reason, bag=bag)

    def repeat(self) -> PlannedTrial | None:
        """Have the newest finished trial done again and return it; None if there is none. The log keeps both."""
        if not self.progress.done:
            return None
        position = max(self.progress.done)
        trial = replace(self.progress.plan[position - 1], attempt=self.progress.attempts[position])
        self._write("repeat", trial)
        return trial

    def note(self, what: str) -> None:
        """Put a word about the session itself into the log, such as ``paused``."""
        self._write(what)

    def close(self) -> None:
        """Idempotent."""
        if not self._log.closed:
            self._write("closed")
            self._log.close()

    def _write(self, what: str, trial: PlannedTrial | None = None, **more: Any) -> None:
        progress = self.progress
        event: dict[str, Any] = {
            "time": datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
            "event": what,
            "study": progress.protocol.name,
            "subject": progress.subject,
        }
        if trial is not None:
            event |= {"position": trial.position, "attempt": trial.attempt, "trial": trial.name}
        event |= more
        self._log.write(json.dumps(event).encode() + b"\n")
        self._log.flush()
        os.fsync(self._log.fileno())
        progress.take(event)


def is_led(folder: Path) -> bool:
    """Whether a conductor has the session in this folder at the moment."""
    try:
        with (folder / LOG).open("rb") as log:
            fcntl.flock(log, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except FileNotFoundError:
        return False
    return False


def events(path: Path) -> Iterator[dict[str, Any]]:
    """The events of a log. A line that a crash cut short is left out: what it would have said had not happened yet."""
    for line in path.read_bytes().splitlines():
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if isinstance(event, dict) and {"time", "event", "study", "subject"} <= event.keys():
            yield event
