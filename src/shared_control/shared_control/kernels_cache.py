"""Where compiled kernels are kept: in a directory of their own for each state of the sources that they are made of.

numba notices a change of the file that a kernel is written in, but not of the files that it calls; keyed by a digest of
all of them, a stale kernel cannot be loaded.
"""

from __future__ import annotations

import functools
import hashlib
import os
from pathlib import Path

__all__ = ["directory", "source_digest", "sources"]

#: The modules whose code ends up in kernels. One that compiles anything and is not here fails a test.
_PATTERNS = (
    "tasks/*.py",
    "controllers/*_kernels.py",
    "cost.py",
    "dispatch.py",
    "hybrid.py",
    "integrate.py",
    "mig.py",
    "rk4.py",
    "tuples.py",
)


def sources() -> list[Path]:
    """The source files that kernels are made of."""
    root = Path(__file__).parent
    return sorted(path for pattern in _PATTERNS for path in root.glob(pattern))


@functools.cache
def source_digest() -> str:
    """SHA-256 over the names and the contents of the kernels' sources, in hexadecimal."""
    root = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.relative_to(root).as_posix().encode() + b"\0")
        digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()


def directory() -> Path:
    """Directory of the kernels of these sources: below ``NUMBA_CACHE_DIR``, else below the user's cache directory."""
    base = os.environ.get("NUMBA_CACHE_DIR")
    if not base:
        home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
        base = os.path.join(home, "shared_control", "numba")
    return Path(base) / source_digest()[:16]
