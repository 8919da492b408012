"""Random streams: one for each role of a trial, all derived from its seed, none depending on another."""

from __future__ import annotations

import zlib

import numpy as np

__all__ = ["stream"]


def stream(seed: int, role: str) -> np.random.Generator:
    """The random stream of a role ("user", "plant", ...) in the trial with this seed: the same in any process."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, zlib.crc32(role.encode())])))
