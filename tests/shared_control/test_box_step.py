"""The box-constrained quadratic step with several inputs, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from shared_control.controllers.ilqr_kernels import _box_step, _solve_free


@pytest.mark.parametrize("seed", range(10))
def test_two_inputs(seed):
    random = np.random.default_rng(seed)
    root = random.normal(size=(2, 2))
    quu, qu = root @ root.T + 0.5 * np.eye(2), 3.0 * random.normal(size=2)
    low, high = -random.uniform(0.1, 2.0, 2), random.uniform(0.1, 2.0, 2)
    du, free = np.empty(2), np.empty(2, bool)
    _box_step(quu, qu, low, high, du, free)
    best = minimize(
        lambda d: 0.5 * d @ quu @ d + qu @ d, np.zeros(2), jac=lambda d: quu @ d + qu,
        bounds=list(zip(low, high, strict=True)), method="L-BFGS-B", options={"ftol": 1e-16, "gtol": 1e-12},
    )  # fmt: skip
    np.testing.assert_allclose(du, best.x, atol=1e-5)
    gains = random.normal(size=(2, 4))
    wanted = np.zeros((2, 4))
    inner = np.flatnonzero(free)
    if len(inner):
        wanted[inner] = -np.linalg.solve(quu[np.ix_(inner, inner)], gains[inner])
    _solve_free(quu, free, np.empty((2, 2)), gains)
    np.testing.assert_allclose(gains, wanted, atol=1e-12)
