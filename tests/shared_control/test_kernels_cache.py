"""The digest that keys compiled kernels."""

from __future__ import annotations

from pathlib import Path

import shared_control
from shared_control import controllers, dispatch, integrate, kernels_cache, mig, tasks, warm_up
from shared_control.controllers import ilqr_kernels, rollout_kernels, sac_kernels
from shared_control.filter import FilterConfig, MigFilter


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


def test_without_a_place_of_its_own_it_lies_in_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert kernels_cache.directory().parent == tmp_path / "shared_control" / "numba"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert kernels_cache.directory().parent == tmp_path / ".cache" / "shared_control" / "numba"


def test_where_nothing_can_be_written_nothing_is_kept(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert dispatch._usable_cache() is None
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "folder"))
    assert dispatch._usable_cache() == str(kernels_cache.directory())


def test_what_set_up_compiles_is_all_that_a_filter_runs(capsys):
    def compiled():
        modules = (mig, integrate, ilqr_kernels, rollout_kernels, sac_kernels)
        return {(m.__name__, name): dispatch.compiled(kernel) for m in modules for name, kernel in vars(m).items()}

    warm_up.compile_task("cart_pendulum")
    titles = capsys.readouterr().out
    assert all(f"cart_pendulum: controller {name} " in titles for name in controllers.names())
    before = compiled()
    task = tasks.get("cart_pendulum")
    for name in controllers.names():
        filter_ = MigFilter(task, FilterConfig(controller=name, contraction=0.1))
        filter_.warm_up()
        filter_.decide(task.initial_state, 1e3 * task.initial_state[:1])
    assert compiled() == before
