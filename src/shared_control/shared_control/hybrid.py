"""One step of a hybrid task: RK4 from event to event, and its exact discrete derivative.

    x_1 = Phi_q(x_0, u, t_1)  with  g_q(x_1) = 0,   x_2 = Phi_q'(x_1, u, t_2), ...,   t_1 + t_2 + ... = h

A mode q holds while its guard g_q is positive; where it reaches zero the next mode takes over, with the state as it is
(identity reset). The mode goes from step to step beside the state, which alone does not always tell it: guards may
overlap. The event is located by a bracketing secant. A guard that dips below zero and comes back within a step is found
by the turn of its rate. A mode that is entered with its guard at zero and falling is kept to the end of the step, lest
it chatter. No more than ``EVENTS`` events count in a step.

Backwards, w is taken through each segment; at an event with guard gradient n, with sigma = w^T dPhi/dt of the last
segment (which lasts as long as the events leave it),

    w <- w + n (sigma - w^T dPhi_q/dt) / (n^T dPhi_q/dt),

the transpose of the saltation matrix I + (f_plus - f_minus) n^T / (n^T f_minus) with the flows of the discrete steps in
place of the continuous ones: the exact derivative of the located event. Source of the matrix: Aizerman and Gantmacher,
Quarterly Journal of Mechanics and Applied Mathematics 11, 1958.
"""

from __future__ import annotations

from typing import Any

from shared_control import rk4
from shared_control.dispatch import flow, guard, guard_gradient, in_mode, jit, mode, next_mode, partials
from shared_control.tasks.task import Array
from shared_control.tuples import Vector, axpy, dot, take

__all__ = ["step", "step_linearised", "step_pullback", "stride"]

#: Most events that count in one step.
EVENTS = 3
#: A guard at most this [unit of the guard] counts as zero where a mode begins.
ON_GUARD = 1e-9
#: An event is located once the guard is this small [unit of the guard] or its bracket this short [s].
LOCATED = 1e-14
#: Least rate of a guard at its event [unit of the guard / s]: grazing has no finite derivative.
GRAZING = 1e-4
#: Evaluations of the search for an event; far more than it needs.
SEARCH = 100


@jit
def _rate(q: Any, x: Vector, u: Vector) -> float:
    """dg/dt in the mode."""
    return dot(guard_gradient(q, x), flow(q, x, u))


@jit
def _guard_after(q: Any, x: Vector, u: Vector, t: float) -> float:
    return guard(q, rk4.step(q, x, u, t))


@jit
def _locate(q: Any, x: Vector, u: Vector, low: float, high: float, g_low: float, g_high: float) -> float:
    """Time at which the guard is zero, between one where it is positive and one where it is negative."""
    last = 0
    for _ in range(SEARCH):
        t = high - g_high * (high - low) / (g_high - g_low)
        if not low < t < high:
            t = 0.5 * (low + high)
        g = _guard_after(q, x, u, t)
        if abs(g) <= LOCATED or high - low <= LOCATED:
            return t
        # The weight of an end that stays is halved (Illinois), lest the other creep.
        if g > 0.0:
            low, g_low = t, g
            g_high *= 0.5 if last == 1 else 1.0
            last = 1
        else:
            high, g_high = t, g
            g_low *= 0.5 if last == -1 else 1.0
            last = -1
    return high


@jit
def _event(q: Any, x: Vector, u: Vector, h: float, y: Vector) -> float:
    """Time of the first event on the way from x to y = Phi_q(x, u, h); negative if there is none."""
    low, g_low = 0.0, guard(q, x)
    on_guard = g_low <= ON_GUARD
    rate = _rate(q, x, u)
    if on_guard and rate <= 0.0:
        return -1.0
    high, g_high = h, guard(q, y)
    if g_high >= 0.0:
        if rate >= 0.0:
            return -1.0
        turned = _rate(q, y, u)
        if turned <= 0.0:
            return -1.0
        high = h * rate / (rate - turned)
        g_high = _guard_after(q, x, u, high)
        if g_high >= 0.0:
            return -1.0
    if on_guard:
        # The guard rises from zero first: go back until it is seen positive.
        g_low, t = -1.0, high
        for _ in range(SEARCH):
            t *= 0.5
            g_low = _guard_after(q, x, u, t)
            if g_low > 0.0:
                low = t
                break
            high, g_high = t, g_low
        if g_low <= 0.0:
            return -1.0
    if g_high == 0.0:
        return high
    return _locate(q, x, u, low, high, g_low, g_high)


@jit
def _begin(p: Any, before: int, x: Vector, u: Vector) -> int:
    """Mode in which a step begins: the last one's, unless its guard is at zero and falling."""
    now = mode(p, before, x)
    q = in_mode(p, now)
    return next_mode(q) if guard(q, x) <= ON_GUARD and _rate(q, x, u) <= 0.0 else now


@jit
def step(p: Any, before: int, x: Vector, u: Vector, h: float) -> tuple[Vector, int]:
    """State and mode after a step."""
    now = _begin(p, before, x, u)
    left = h
    for _ in range(EVENTS):
        q = in_mode(p, now)
        y = rk4.step(q, x, u, left)
        t = _event(q, x, u, left, y)
        if t < 0.0:
            return y, now
        x = rk4.step(q, x, u, t)
        now = next_mode(q)
        left -= t
    return rk4.step(in_mode(p, now), x, u, left), now


@jit
def stride(p: Any, x: Vector) -> int:
    """How much of the store a step takes.

    That is the number of segments, then for each its mode, its duration, the state at its begin, its derivatives.
    """
    return 1 + (EVENTS + 1) * (2 + len(x) + 4 * len(partials(in_mode(p, 0))))


@jit
def step_linearised(p: Any, before: int, x: Vector, u: Vector, h: float, store: Array, at: int) -> tuple[Vector, int]:
    """State and mode after a step; what :func:`step_pullback` needs goes to ``store[at:]``."""
    n, size = len(x), (stride(p, x) - 1) // (EVENTS + 1)
    now = _begin(p, before, x, u)
    left = h
    y = x
    for segment in range(EVENTS + 1):
        q = in_mode(p, now)
        here = at + 1 + segment * size
        store[at] = segment + 1
        store[here], store[here + 1] = now, left
        for i in range(n):
            store[here + 2 + i] = x[i]
        y = rk4.step_linearised(q, x, u, left, store, here + 2 + n)
        t = _event(q, x, u, left, y) if segment < EVENTS else -1.0
        if t < 0.0:
            break
        store[here + 1] = t
        x = rk4.step_linearised(q, x, u, t, store, here + 2 + n)
        now = next_mode(q)
        left -= t
    return y, now


@jit
def step_pullback(p: Any, store: Array, at: int, u: Vector, w: Vector, h: float) -> tuple[Vector, Vector]:
    """(w^T dx_end/dx, w^T dx_end/du), from what :func:`step_linearised` stored."""
    n, size = len(w), (stride(p, w) - 1) // (EVENTS + 1)
    last = int(store[at]) - 1
    here = at + 1 + last * size
    q = in_mode(p, int(store[here]))
    if last == 0:
        return rk4.step_pullback(q, store, here + 2 + n, u, w, h)
    x = take(w, store, here + 2)
    w, wu, sigma = rk4.step_pullback_duration(q, store, here + 2 + n, x, u, w, store[here + 1])
    for segment in range(last - 1, -1, -1):
        here = at + 1 + segment * size
        q = in_mode(p, int(store[here]))
        normal = guard_gradient(q, x)
        x = take(w, store, here + 2)
        t = store[here + 1]
        wx, du, dt = rk4.step_pullback_duration(q, store, here + 2 + n, x, u, w, t)
        nx, nu, nt = rk4.step_pullback_duration(q, store, here + 2 + n, x, u, normal, t)
        jump = (sigma - dt) / min(nt, -GRAZING)
        # The event comes the later the higher the guard: its time moves by -n^T dx / n^T f.
        w = axpy(jump, nx, wx)
        wu = axpy(1.0, wu, axpy(jump, nu, du))
    return w, wu
