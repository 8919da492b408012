"""The one error of this package."""

from __future__ import annotations

__all__ = ["BagError"]


class BagError(Exception):
    """A bag cannot be written or read. The message says what happened, where, and what to do if that is known."""
