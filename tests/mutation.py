"""`./rig run python tests/mutation.py`: is every line of the criterion, the filter and the measures held by a test?

So too what is fail-safe in the runtime. Each mutant differs from the source in one place: a comparison, a sign, a
number; a call, an assignment, a return or a keyword argument left out. Its tests run in a process that was forked when
numba was loaded. A mutant that no test kills is printed; a test has to be written, or it stands in EQUIVALENT with the
reason why nothing can tell it from the source.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import importlib.abc
import importlib.machinery
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Target:
    """A module, and the tests that hold it: those that kill most in the least time first."""

    package: str
    tests: tuple[str, ...]
    #: numba keeps kernels under their own code and not under the constants that they read: a mutant of a kernel runs as
    #: the Python that it is.
    compiled: bool = True
    #: Loaded before the fork: what costs seconds and loads no target.
    heavy: tuple[str, ...] = ("numba", "numpy", "scipy.stats", "pytest", "hypothesis")


_OF_ROS = ("numpy", "pytest", "hypothesis", "rclpy.executors", "mig_interfaces.msg", "geometry_msgs.msg")

TARGETS = {
    "mig": Target(
        "shared_control",
        (
            "test_mig.py::test_with_what_follows_against_complex_steps",
            "test_mig.py::test_kink_while_the_cart_moves",
            "test_mig.py",
            "test_slip_twin.py",
            "test_slip.py::test_the_mode_is_part_of_what_is_judged",
        ),
        compiled=False,
        heavy=("numba", "numpy", "scipy.integrate", "pytest", "hypothesis", "shared_control.cost"),
    ),
    "filter": Target("shared_control", ("test_filter.py", "test_judges.py", "test_loop.py", "test_trial.py")),
    "decision": Target("shared_control", ("test_decision.py", "test_filter.py")),
    "measures": Target("shared_control", ("test_measures.py", "test_trial.py")),
    "faults": Target("rig_runtime", ("test_faults.py",), heavy=_OF_ROS),
    "ticks": Target("rig_runtime", ("test_ticks.py",), heavy=_OF_ROS),
}

#: (module, mutant as it is printed, its function in front or not): why nothing can tell it from the source.
EQUIVALENT = {
    ("mig", "abs(e[i]) >= math.pi - KINK  ->  abs(e[i]) > math.pi - KINK"): "the limit itself is no angle that matters",
    (
        "mig",
        "_forward: c.angles[i] and abs(e[i]) >= math.pi - KINK  ->  c.angles[i] or abs(e[i]) >= math.pi - KINK",
    ): "without a kink the one-sided sum is the same slope, and only slower",
    (
        "mig",
        "_forward: kink = False  ->  kink = True",
    ): "without a kink the one-sided sum is the same slope, and only slower",
    ("filter", "task.m > 1  ->  task.m >= 1"): "one input is judged the same way jointly and by itself",
    ("faults", "self._received = 0  ->  pass"): "it is read only once a message has set it",
    ("faults", "self._received = 0  ->  self._received = 1"): "it is read only once a message has set it",
    ("faults", "1000000000.0 * _PAUSE  ->  1000000001.0 * _PAUSE"): "rounded to the same nanosecond",
    (
        "faults",
        "self._since = self._until = 0  ->  self._since = self._until = 1",
    ): "read only once a loss has set them",
    ("ticks", "-1  ->  -2"): "no stamp is below zero: any number below it stands for none",
    ("ticks", "overtaken <= newest  ->  overtaken < newest"): "the newest has been handed out by then",
}

#: A mutant whose tests take so many times as long as those of the source, and a minute besides, never ends.
LIMIT = 3.0

_SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And, ast.Pow: ast.Mult,
    ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
}  # fmt: skip


def mutants(tree: ast.Module) -> Iterator[tuple[str, ast.Module]]:
    """Each mutant of a module: where and what, and the module."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    for place, (node, name, index) in enumerate(_places(tree)):
        changed = copy.deepcopy(tree)
        twin, _, _ = list(_places(changed))[place]
        before = ast.unparse(node)
        old = getattr(twin, name) if index is None else getattr(twin, name)[index]
        new = _mutated(old)
        if index is None:
            setattr(twin, name, new)
        elif isinstance(new, ast.Delete):
            del getattr(twin, name)[index]
        else:
            getattr(twin, name)[index] = new
        line = getattr(old, "lineno", getattr(node, "lineno", 0))
        after = ast.unparse(ast.fix_missing_locations(twin))
        if isinstance(old, ast.stmt):
            before, after = ast.unparse(old), ast.unparse(new)
        where = [f.name for f in functions if f.lineno <= line <= (f.end_lineno or line)]
        yield f"line {line}, {where[-1] if where else 'module'}: {before}  ->  {after}", changed


def _places(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Parent, field and index of everything that a mutant changes."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "bases", "exc"):
            continue  # declarations and sentences
        if name == "keywords" and isinstance(node, ast.ClassDef):
            continue
        children = [(value, None)] if isinstance(value, ast.AST) else []
        if isinstance(value, list):
            children = [(child, index) for index, child in enumerate(value) if isinstance(child, ast.AST)]
        for child, index in children:
            if isinstance(child, (ast.Assert, ast.Import, ast.ImportFrom)) or _declares(child):
                continue
            if _mutated(child) is not None:
                yield node, name, index
            yield from _places(child)


def _declares(node: ast.AST) -> bool:
    if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Call):
        return ast.unparse(node.value.func) == "parameter"
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _mutated(node: ast.AST) -> ast.AST | None:
    if type(node) in _SWAPS:
        return _SWAPS[type(node)]()
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        return ast.Constant(not node.value)
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return ast.Constant(node.value + 1)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
        return node.operand
    if isinstance(node, ast.keyword) and node.arg is not None:
        return ast.Delete([])  # leaves it out
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        return ast.Pass()
    if isinstance(node, (ast.Assign, ast.AugAssign, ast.Return)):
        return None if ast.unparse(node).startswith("__all__") else ast.Pass()
    if isinstance(node, ast.IfExp):
        return node.body
    return None


class _Instead(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module, whose code is a mutant's."""

    def __init__(self, name: str, path: Path, tree: ast.Module) -> None:
        self._name, self._path, self._tree = name, path, tree

    def find_spec(self, fullname: str, *_: object) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._name:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, origin=str(self._path))

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._path)
        exec(compile(ast.fix_missing_locations(self._tree), str(self._path), "exec"), module.__dict__)  # noqa: S102


def survives(target: str, tree: ast.Module, limit: float | None = None) -> bool:
    """Whether the tests of a module pass with this in its place."""
    child = os.fork()
    if child == 0:
        _be_mutant(target, tree)
    watched = os.pidfd_open(child)
    try:
        ended, _, _ = select.select([watched], [], [], limit)
    finally:
        os.close(watched)
    if not ended:
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return status == 0


def _be_mutant(target: str, tree: ast.Module) -> None:
    import pytest

    kind = TARGETS[target]
    name = f"{kind.package}.{target}"
    assert name not in sys.modules, f"{name} was loaded before the fork"
    sys.meta_path.insert(0, _Instead(name, source(target), tree))
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    tests = [str(ROOT / "tests" / kind.package / file) for file in kind.tests]
    code = 1
    try:
        code = int(pytest.main(["-x", "-q", "--rootdir", str(ROOT), *tests]))
    finally:
        os._exit(code)


def source(target: str) -> Path:
    """The file of a target."""
    package = TARGETS[target].package
    return ROOT / "src" / package / package / f"{target}.py"


def main(argv: Sequence[str] | None = None) -> int:
    """0 if every mutant is killed or explained."""
    parser = argparse.ArgumentParser(prog="./rig run python tests/mutation.py", description=__doc__)
    parser.add_argument("target", nargs="*", choices=[[], *TARGETS], help=f"only these: {', '.join(TARGETS)}")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every Nth mutant")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="the first of these (default: %(default)s)")
    options = parser.parse_args(argv)
    if len(options.target) == 1:
        return _try(options.target[0], slice(options.first, None, options.every))
    # Each in a process of its own: what one loads before the fork is another's target.
    code, pieces = 0, ["--every", str(options.every), "--first", str(options.first)]
    for target in options.target or TARGETS:
        code |= subprocess.run([sys.executable, __file__, target, *pieces], check=False).returncode
    return code


def _try(target: str, piece: slice) -> int:
    if not TARGETS[target].compiled and os.environ.get("NUMBA_DISABLE_JIT") != "1":
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "NUMBA_DISABLE_JIT": "1"})
    sys.path.insert(0, str(ROOT / "tests"))
    os.chdir(ROOT)
    for name in TARGETS[target].heavy:
        importlib.import_module(name)
    tree = ast.parse(source(target).read_text(encoding="utf-8"))
    begin = time.monotonic()
    assert survives(target, copy.deepcopy(tree)), f"the tests of {target} fail without a mutant"
    limit = 60.0 + LIMIT * (time.monotonic() - begin)
    found = list(mutants(tree))[piece]
    begin, alive, explained = time.monotonic(), 0, 0
    for what, mutant in found:
        if {(target, what.partition(": ")[2]), (target, what.partition(", ")[2])} & EQUIVALENT.keys():
            explained += 1
        elif survives(target, mutant, limit):
            alive += 1
            print(f"{target}.py, {what}", flush=True)
    seconds, killed = time.monotonic() - begin, len(found) - alive - explained
    print(f"{target}: {len(found)} mutants, {killed} killed, {explained} equivalent, {alive} alive; {seconds:.0f} s")
    return int(alive > 0)


if __name__ == "__main__":
    sys.exit(main())
