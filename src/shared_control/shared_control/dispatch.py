"""How kernels reach a task's mathematics: by the type of its NamedTuple of parameters.

A kernel is written once, in terms of :func:`flow`, :func:`linearise`, :func:`pullback` of parameters ``p`` (of a hybrid
task also of :func:`guard` and its kin) and of the cost functions of a cost ``c``. For each type of ``p`` and ``c`` the
compiler finds the functions of the same names in the module that defines the type, and makes a specialised kernel of
them: inlined, cached on disk, and without a line per task here. Called from Python, the same names do the same.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.extending import overload

from shared_control import cost, kernels_cache, tuples
from shared_control.tuples import Vector

__all__ = ["bound", "compiled", "effort", "flow", "guard", "guard_gradient", "in_mode", "is_hybrid", "jit"]
__all__ += ["jit_inlined", "linearise", "mode", "next_mode", "partials", "plain", "pullback", "replaced_by"]
__all__ += ["running", "running_gradient", "terminal", "terminal_gradient"]

F = TypeVar("F", bound=Callable[..., Any])

#: Division as in IEEE 754 (a singular state gives infinity, which is reported) instead of an exception inside a kernel.
_OPTIONS = {"error_model": "numpy"}


def _usable_cache() -> str | None:
    path = kernels_cache.directory()
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return str(path) if os.access(path, os.W_OK) else None


_CACHE = _usable_cache()


#: Left to itself the compiler calls the pieces of a step, and each call passes tuples through memory.
_INLINED = {**_OPTIONS, "forceinline": True}


def jit(function: F) -> F:
    """Compile at the first call for each combination of types, and keep the result on disk where that is possible."""
    return _compile_with(_OPTIONS, function)


def jit_inlined(function: F) -> F:
    """As :func:`jit`, for what runs at every step of a horizon: it becomes part of the kernels that call it."""
    return _compile_with(_INLINED, function)


def _compile_with(options: dict[str, Any], function: F) -> F:
    before = numba.config.CACHE_DIR
    try:
        numba.config.CACHE_DIR = _CACHE or before
        return cast(F, numba.njit(cache=_CACHE is not None, **options)(function))
    finally:
        numba.config.CACHE_DIR = before


def bound(kernel: F) -> F:
    """A kernel for the types of the arguments that it is called with first, which must be those of every call.

    Looking at the types of all arguments at each call takes longer than handing them over.
    """
    # Where the compiler is switched off (NUMBA_DISABLE_JIT) a kernel is the function that was written.
    entry: Callable[..., Any] | None = None if hasattr(kernel, "compile") else kernel

    def call(*arguments: Any) -> Any:
        nonlocal entry
        if entry is None:
            entry = cast(Any, kernel).compile(tuple(map(numba.typeof, arguments)))
        return entry(*arguments)

    return cast(F, call)


def plain(kernel: F) -> F:
    """The function that was written, behind its kernel."""
    return cast(F, getattr(kernel, "py_func", kernel))


def compiled(function: Any) -> int:
    """For how many combinations of types a kernel has been compiled or loaded in this process."""
    return len(getattr(function, "signatures", ()))


def _home(p: Any) -> Any:
    """The module that defines the type of a value or, for the compiler, the type that a value will have."""
    return sys.modules[getattr(p, "instance_class", type(p)).__module__]


def is_hybrid(p: Any) -> bool:
    """Whether the task with parameters ``p`` has guards."""
    return hasattr(_home(p), "guard")


def flow(p: Any, x: Vector, u: Vector) -> Vector:
    """f(x, u) of the task with parameters ``p``."""
    return cast(Vector, _home(p).flow(p, x, u))


def linearise(p: Any, x: Vector, u: Vector) -> tuple[Vector, Vector]:
    """f(x, u) and the partial derivatives ``d`` there."""
    return cast("tuple[Vector, Vector]", _home(p).linearise(p, x, u))


def pullback(p: Any, d: Vector, w: Vector) -> tuple[Vector, Vector]:
    """(w^T df/dx, w^T df/du)."""
    return cast("tuple[Vector, Vector]", _home(p).pullback(p, d, w))


def partials(p: Any) -> Vector:
    """As many zeros as :func:`linearise` gives partial derivatives."""
    return cast(Vector, _home(p).partials(p))


def mode(p: Any, before: int, x: Vector) -> int:
    """Mode in force at a state of a hybrid task that was in mode ``before`` (negative: unknown)."""
    return cast(int, _home(p).mode(p, before, x))


def in_mode(p: Any, mode: int) -> Any:
    """The parameters of a hybrid task in a mode: what its flow and its guard take."""
    return _home(p).in_mode(p, mode)


def next_mode(q: Any) -> int:
    """Mode that takes over where the guard of this one is zero."""
    return cast(int, _home(q).next_mode(q))


def guard(q: Any, x: Vector) -> float:
    """Positive while the mode holds."""
    return cast(float, _home(q).guard(q, x))


def guard_gradient(q: Any, x: Vector) -> Vector:
    """Gradient of :func:`guard`."""
    return cast(Vector, _home(q).guard_gradient(q, x))


def running(c: Any, x: Vector) -> float:
    """State's part of the running cost."""
    return cast(float, _home(c).running(c, x))


def running_gradient(c: Any, x: Vector) -> Vector:
    """Gradient of :func:`running`."""
    return cast(Vector, _home(c).running_gradient(c, x))


def effort(c: Any, u: Vector) -> float:
    """Control's part of the running cost."""
    return cast(float, _home(c).effort(c, u))


def terminal(c: Any, x: Vector) -> float:
    """Terminal cost."""
    return cast(float, _home(c).terminal(c, x))


def terminal_gradient(c: Any, x: Vector) -> Vector:
    """Gradient of :func:`terminal`."""
    return cast(Vector, _home(c).terminal_gradient(c, x))


def _by_type(stub: Callable[..., Any]) -> Callable[..., Any]:
    """What the compiler puts in place of ``stub``: the function of that name beside the type of the first argument."""
    name = stub.__name__

    def find(first: Any) -> Callable[..., Any] | None:
        return getattr(_home(first), name, None) if hasattr(first, "instance_class") else None

    return find


#: ``replaced_by(stub)(find)``: in a kernel, what ``find`` returns for the types of the arguments stands for ``stub``.
#: Not strict: the implementations carry annotations of their own, which are none of the compiler's business.
replaced_by = functools.partial(overload, jit_options=_INLINED, strict=False)


def _register() -> None:
    def three(find: Callable[[Any], Any]) -> Callable[..., Any]:
        return lambda p, x, u: find(p)

    def two(find: Callable[[Any], Any]) -> Callable[..., Any]:
        return lambda c, x: find(c)

    def one(find: Callable[[Any], Any]) -> Callable[..., Any]:
        return lambda p: find(p)

    stubs: list[Callable[..., Any]]
    stubs = [running, running_gradient, effort, terminal, terminal_gradient, in_mode, guard, guard_gradient]
    for stub in stubs:
        replaced_by(stub)(two(_by_type(stub)))
    stubs = [flow, linearise, pullback]
    for stub in stubs:
        replaced_by(stub)(three(_by_type(stub)))
    stubs = [partials, next_mode]
    for stub in stubs:
        replaced_by(stub)(one(_by_type(stub)))
    find_mode = _by_type(mode)
    replaced_by(mode)(lambda p, before, x: find_mode(p))
    replaced_by(cost.wrap)(lambda angle: cost.wrap)


_register()


def _elementwise(stub: Callable[..., Any], arguments: str, element: str, length_of: str) -> None:
    """Give the compiler, for each length, ``stub`` written out element by element."""

    def write_out(*types_: Any) -> Any:
        length = len(types_[arguments.replace(" ", "").split(",").index(length_of)])
        items = ", ".join(element.format(i=i) for i in range(length))
        return eval(f"lambda {arguments}: ({items},)", {"wrap": cost.wrap})

    # The compiler wants a function with the stub's own arguments.
    replaced_by(stub)(eval(f"lambda {arguments}: write_out({arguments})", {"write_out": write_out}))


_elementwise(tuples.axpy, "a, x, y", "y[{i}] + a * x[{i}]", "x")
_elementwise(tuples.times, "a, b", "a[{i}] * b[{i}]", "a")
_elementwise(tuples.zeros, "like", "0.0", "like")
_elementwise(tuples.unit, "like, i", "1.0 if i == {i} else 0.0", "like")
_elementwise(tuples.take, "like, array, start", "array[start + {i}]", "like")
_elementwise(
    cost.errors, "x, target, angles", "wrap(x[{i}] - target[{i}]) if angles[{i}] else x[{i}] - target[{i}]", "x"
)


def _dot(a: Any, b: Any) -> Any:
    terms = " + ".join(f"a[{i}] * b[{i}]" for i in range(len(a)))
    return eval(f"lambda a, b: {terms}")


replaced_by(tuples.dot)(_dot)
