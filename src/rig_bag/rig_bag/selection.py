"""Which topics are meant, by patterns on their full names."""

from __future__ import annotations

import re
from collections.abc import Iterable

from rig_bag.errors import BagError

__all__ = ["Selection"]


class Selection:
    """Takes the topics whose name contains a match of ``regex``, or all; without those that are excluded.

    Raises
    ------
    BagError: something is no regular expression.
    """

    def __init__(
        self,
        *,
        everything: bool = False,
        regex: str = "",
        exclude_regex: str = "",
        exclude: Iterable[str] = (),
        hidden: bool = False,
    ) -> None:
        self._everything = everything
        self._regex, self._exclude_regex = _compiled(regex), _compiled(exclude_regex)
        self._exclude = frozenset(exclude)
        self._hidden = hidden

    @property
    def empty(self) -> bool:
        """Whether no topic can be taken."""
        return not self._everything and self._regex is None

    def takes(self, topic: str) -> bool:
        """Whether it takes this topic (a fully qualified name)."""
        if topic in self._exclude or (not self._hidden and any(part.startswith("_") for part in topic.split("/"))):
            return False
        if self._exclude_regex is not None and self._exclude_regex.search(topic):
            return False
        return self._everything or (self._regex is not None and self._regex.search(topic) is not None)


def _compiled(pattern: str) -> re.Pattern[str] | None:
    try:
        return re.compile(pattern) if pattern else None
    except re.error as error:
        raise BagError(f"{pattern!r} is not a regular expression: {error}") from error
