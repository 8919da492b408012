"""An oracle for the cart-pendulum that shares no code with the package: the equations of the paper, once more.

It works element by element on numpy arrays of any number type: many states side by side, extended precision for
differences, complex numbers for exact derivatives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest


class Oracle:
    """Pendulum of length h, mass m, damping B; weights of the objective."""

    g, h, m, b = 9.81, 2.0, 0.1, 0.1
    q = (200.0, 0.0, 20.0, 1.0)
    r = 0.3
    p = (0.0, 0.0, 0.0, 0.0)

    def flow(self, x: Any, u: Any) -> Any:
        theta, omega, _, v = x
        alpha = self.g / self.h * np.sin(theta) - self.b / (self.m * self.h**2) * omega - u / self.h * np.cos(theta)
        return np.stack([omega, alpha, v, u + 0 * theta])

    def step(self, x: Any, u: Any, dt: float) -> Any:
        a = self.flow(x, u)
        b = self.flow(x + a * (dt / 2), u)
        c = self.flow(x + b * (dt / 2), u)
        d = self.flow(x + c * dt, u)
        return x + (a + 2 * b + 2 * c + d) * (dt / 6)

    def simulate(self, x: Any, controls: Any, dt: float) -> Any:
        """Nodes (N+1, 4, ...) under N controls."""
        nodes = [x]
        for u in controls:
            nodes.append(self.step(nodes[-1], u, dt))
        return np.stack(nodes)

    def turns(self, nodes: Any) -> Any:
        return np.round(np.real(nodes[:, 0]) / (2 * np.pi))

    def cost(self, x: Any, controls: Any, dt: float, effort: bool = True) -> Any:
        """1/2 int x'Qx + u'Ru dt + 1/2 x'Px, trapezoid rule for the state, with theta to the nearest turn."""
        nodes = self.simulate(x, controls, dt)
        error = nodes.copy()
        error[:, 0] = nodes[:, 0] - self.turns(nodes) * (2 * np.pi)
        running = sum(self.q[i] * error[:, i] ** 2 for i in range(4)) / 2
        total = dt * (np.sum(running, axis=0) - running[0] / 2 - running[-1] / 2)
        total = total + sum(self.p[i] * error[-1, i] ** 2 for i in range(4)) / 2
        if effort:
            total = total + sum(dt * self.r * u * u / 2 for u in controls)
        return total


@pytest.fixture
def oracle() -> Oracle:
    return Oracle()


@pytest.fixture(scope="session")
def scenario() -> Any:
    """Noise and assistance, short, as shipped otherwise."""
    from shared_control.scenario import load

    return load({"/**": {"ros__parameters": {"duration": 1.0}}})


def random_states(count: int, seed: int) -> np.ndarray:
    """States (4, count) of every kind: hanging, swinging, turning over, upright, far along the track."""
    spread = np.array([3.5, 4.0, 3.0, 3.0])[:, None]
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (4, count)) * spread


@pytest.fixture
def states() -> Any:
    return random_states
