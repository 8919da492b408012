"""What the sources never do with what comes from a disk or a network: run it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "src"

#: Modules that turn bytes into code or into objects of any class.
_MODULES = {
    "pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "jsonpickle", "dask", "distributed",
}  # fmt: skip
_CALLS = {"eval", "exec", "compile", "__import__"}

#: (file, what) that is allowed, and why.
_ALLOWED = {
    # Writes out functions from texts that stand in this file.
    ("shared_control/shared_control/dispatch.py", "eval"),
    # Compiled kernels on the disk, which numba pickles: who may write there is who runs the rig.
    ("shared_control/shared_control/dispatch.py", "cache="),
    # A Dask scheduler: of this machine, with TLS, or in a network that the command line says to trust.
    ("rig_study/rig_study/cluster.py", "distributed"),
    ("rig_study/rig_study/cluster.py", "distributed.security"),
}


def suspicious(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and name of each import or call that could run what was read."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, name.name) for name in node.names if name.name.partition(".")[0] in _MODULES)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in _MODULES:
            yield node.lineno, str(node.module)
        elif isinstance(node, ast.Call):
            yield from _call(node)


def _call(node: ast.Call) -> Iterator[tuple[int, str]]:
    name = ast.unparse(node.func)
    keywords = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
    if name in _CALLS or name in ("os.system", "os.popen"):
        yield node.lineno, name
    elif keywords.get("shell") == "True":
        yield node.lineno, "shell"
    elif keywords.get("cache", "False") != "False":
        yield node.lineno, "cache="
    elif name.endswith(("np.load", "numpy.load", "read_pickle")) and keywords.get("allow_pickle") != "False":
        yield node.lineno, f"{name} without allow_pickle=False"
    elif (name.startswith("yaml.") and name.endswith(("unsafe_load", "full_load", "load_all"))) or (
        name == "yaml.load" and "Safe" not in keywords.get("Loader", "") and keywords.get("Loader") != "_Loader"
    ):
        yield node.lineno, name


def test_nothing_that_is_read_is_run() -> None:
    found = set()
    files = sorted(SOURCES.rglob("*.py"))
    assert len(files) > 150
    for path in files:
        relative = path.relative_to(SOURCES).as_posix()
        for line, what in suspicious(ast.parse(path.read_text(encoding="utf-8"))):
            found.add((relative, what))
            assert (relative, what) in _ALLOWED, f"{relative}, line {line}: {what}"
    assert found == _ALLOWED, "an exception that nothing needs any more"


def test_the_loader_of_bags_is_a_safe_one() -> None:
    import yaml

    from rig_bag import metadata

    assert metadata._Loader in (yaml.SafeLoader, yaml.CSafeLoader)


@pytest.mark.parametrize(
    "text",
    ["import pickle", "from dill import loads", "eval(x)", "exec(x)", "np.load(path)", "np.load(p, allow_pickle=True)",
     "yaml.load(x)", "yaml.load(x, Loader=yaml.Loader)", "yaml.full_load(x)", "subprocess.run(x, shell=True)",
     "os.system(x)", "pd.read_pickle(x)", "from distributed import Client", "njit(cache=True)"],
)  # fmt: skip
def test_each_of_them_would_be_found(text: str) -> None:
    assert list(suspicious(ast.parse(text)))


@pytest.mark.parametrize("text", ["json.loads(x)", "np.load(p, allow_pickle=False)", "re.compile(x)"])
def test_what_is_harmless_is_not(text: str) -> None:
    assert not list(suspicious(ast.parse(text)))
