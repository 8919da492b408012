"""The pieces of `bench/c`, compiled when they are needed with the compiler that is there (`$CC`, else cc or gcc)."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rows import BenchError

_SOURCES = Path(__file__).parent / "c"

#: The kernels have the pieces of a step taken in, so the C versions must have them too: left to itself gcc calls them.
_LIMITS = ("max-inline-insns-auto", "max-inline-insns-single", "inline-unit-growth", "large-function-growth")
_OPTIONS = ("-O3", "-march=native", *(f"--param={limit}=3000" for limit in _LIMITS))


@contextmanager
def library(name: str) -> Iterator[ctypes.CDLL]:
    """A source of `bench/c` as a library."""
    with _compiled(name, "-shared", "-fPIC") as path:
        yield ctypes.CDLL(str(path))


@contextmanager
def program(name: str) -> Iterator[Path]:
    """A source of `bench/c` as a program."""
    with _compiled(name) as path:
        yield path


@contextmanager
def _compiled(name: str, *options: str) -> Iterator[Path]:
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        raise BenchError("no C compiler found: install gcc or set CC")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        command = [compiler, *_OPTIONS, *options, "-o", str(path), str(_SOURCES / f"{name}.c"), "-lm"]
        try:
            result = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise BenchError(f"the C compiler {compiler} cannot be run: {error.strerror}; set CC") from None
        if result.returncode != 0:
            raise BenchError(f"{compiler} cannot compile {name}.c: {result.stderr.strip()}")
        yield path
