"""Arithmetic on tuples of numbers: the vectors of the kernels.

Inside a compiled kernel a tuple lives in registers, an array in memory; on chains of small steps that decides the
speed. The functions here are ordinary Python; :mod:`shared_control.dispatch` gives the compiler a version of each for
every length.
"""

from __future__ import annotations

from typing import Any

Vector = tuple[float, ...]


def axpy(a: float, x: Vector, y: Vector) -> Vector:
    """a x + y."""
    return tuple(y[i] + a * x[i] for i in range(len(x)))


def times(a: Vector, b: Vector) -> Vector:
    """a_i b_i, element by element."""
    return tuple(a[i] * b[i] for i in range(len(a)))


def dot(a: Vector, b: Vector) -> float:
    """a^T b."""
    return sum(a[i] * b[i] for i in range(len(a)))


def zeros(like: Vector) -> Vector:
    """A zero vector as long as ``like``."""
    return tuple(0.0 for _ in like)


def unit(like: Vector, i: int) -> Vector:
    """The i-th unit vector as long as ``like``."""
    return tuple(1.0 if j == i else 0.0 for j in range(len(like)))


def take(like: Vector, array: Any, start: int) -> Vector:
    """Elements ``start, start + 1, ...`` of a one-dimensional array, as many as ``like`` has."""
    return tuple(float(array[start + i]) for i in range(len(like)))
