"""The criterion of the cart-pendulum in Python scalars, by hand: the arithmetic of `bench/c/cart_pendulum.c`."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, remainder, sin

Four = tuple[float, float, float, float]
Partials = tuple[float, float]


def criterion(
    physics: Sequence[float],
    q: Sequence[float],
    target: Sequence[float],
    start: Four,
    user: float,
    h: float,
    steps: int,
) -> float:
    """As in C, argument by argument."""
    pull, lever = physics[2] / physics[3], 1.0 / physics[3]
    friction = physics[1] / (physics[0] * physics[3] * physics[3])

    def stage(x: Four, u: float) -> tuple[Four, Partials]:
        s, c, push = sin(x[0]), cos(x[0]), u * lever
        f = (x[1], pull * s - push * c - friction * x[1], x[3], u)
        return f, (pull * c + push * s, -c * lever)

    def back(d: Partials, w: Four) -> tuple[Four, float]:
        return (d[0] * w[1], w[0] - friction * w[1], 0.0, w[2]), d[1] * w[1] + w[3]

    def slope(x: Four, share: float) -> Four:
        e = (remainder(x[0] - target[0], 2.0 * pi), x[1] - target[1], x[2] - target[2], x[3] - target[3])
        return (share * q[0] * e[0], share * q[1] * e[1], share * q[2] * e[2], share * q[3] * e[3])

    x = start
    nodes, partials = [], []
    for _ in range(steps):
        nodes.append(x)
        k1, d1 = stage(x, 0.0)
        k2, d2 = stage(_along(x, 0.5 * h, k1), 0.0)
        k3, d3 = stage(_along(x, 0.5 * h, k2), 0.0)
        k4, d4 = stage(_along(x, h, k3), 0.0)
        partials.append((d1, d2, d3, d4))
        x = _along(_along(_along(_along(x, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
    rho, along_u = slope(x, 0.5 * h), 0.0
    for t in range(steps - 1, -1, -1):
        d1, d2, d3, d4 = partials[t]
        w = _times(h / 6.0, rho)
        s4, u4 = back(d4, w)
        s3, u3 = back(d3, _along(_times(h / 3.0, rho), h, s4))
        s2, u2 = back(d2, _along(_times(h / 3.0, rho), 0.5 * h, s3))
        s1, u1 = back(d1, _along(w, 0.5 * h, s2))
        along_u = u1 + u2 + u3 + u4
        rho = _along(_along(_along(_along(rho, 1.0, s1), 1.0, s2), 1.0, s3), 1.0, s4)
        if t > 0:
            rho = _along(rho, 1.0, slope(nodes[t], h))
    return along_u * user


def _along(x: Four, h: float, f: Four) -> Four:
    return (x[0] + h * f[0], x[1] + h * f[1], x[2] + h * f[2], x[3] + h * f[3])


def _times(h: float, x: Four) -> Four:
    return (h * x[0], h * x[1], h * x[2], h * x[3])
