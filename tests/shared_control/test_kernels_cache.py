"""The digest that keys compiled kernels."""

from __future__ import annotations

from pathlib import Path

import shared_control
from shared_control import kernels_cache


def test_every_file_with_kernels_is_in_the_digest():
    covered = set(kernels_cache.sources())
    root = Path(shared_control.__file__).parent
    for path in root.rglob("*.py"):
        if "\n@jit" in path.read_text() or "def linearise" in path.read_text():
            assert path in covered


def test_directory_changes_with_the_sources(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert kernels_cache.directory().parent == tmp_path
    digest = kernels_cache.source_digest()
    assert len(digest) == 64
    changed = tmp_path / "more.py"
    changed.write_text("")
    root = Path(shared_control.__file__).parent
    monkeypatch.setattr(kernels_cache, "sources", lambda: sorted(root.glob("tasks/*.py")))
    kernels_cache.source_digest.cache_clear()
    assert kernels_cache.source_digest() != digest
    monkeypatch.undo()
    kernels_cache.source_digest.cache_clear()
    assert kernels_cache.source_digest() == digest
