"""What is fuzzed: a boundary takes one input at a time and says what became of it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

from fuzz.garbage import Garbage

__all__ = ["ACCEPTED", "LONGEST", "REFUSED", "Boundary", "UnclearError", "refusal"]

ACCEPTED, REFUSED = "accepted", "refused"

#: [characters] A sentence for a person is no longer than this, whatever was put in.
LONGEST = 1500


class UnclearError(AssertionError):
    """An input was refused, but nobody could tell from the message what is wrong and where."""


class Boundary:
    """One boundary. :meth:`send` raises whatever must not happen: a crash, an unclear error, a wrong answer."""

    name = ""
    #: Share of all inputs that it gets, against the others'.
    share = 1.0

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def send(self, garbage: Garbage) -> str:
        """Give it one input; ACCEPTED or REFUSED."""
        raise NotImplementedError

    def finish(self) -> None:
        """Whether it still does what it is for, after everything; and let go of what it holds."""


def refusal(call: Callable[[], object], errors: type[Exception], words: Collection[str] = ()) -> str:
    """What became of a call that may raise `errors`, with all of `words` in a sentence that is not too long."""
    try:
        call()
    except errors as error:
        text = str(error)
        if not text.strip() or len(text) > LONGEST:
            raise UnclearError(f"{len(text)} characters: {text[:300]!r}") from error
        missing = [word for word in words if word not in text]
        if missing:
            raise UnclearError(f"{text[:300]!r} does not name {missing}") from error
        return REFUSED
    return ACCEPTED
