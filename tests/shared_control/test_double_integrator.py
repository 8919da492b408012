"""The task of docs/new-task.md, served by everything without a line elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from shared_control import controllers, tasks
from shared_control.cost import quadratic
from shared_control.filter import Verdict
from shared_control.integrate import Stepper
from shared_control.mig import mig_integral
from shared_control.trial import run_trial

TASK = tasks.get("double_integrator", gain=1.5)


def test_steps_are_exact():
    x = np.array([1.0, -0.3])
    Stepper(TASK, 0.01).advance(x, np.array([2.0]))
    assert x == pytest.approx([1.0 - 0.003 + 0.5 * 3.0 * 1e-4, -0.27], rel=1e-15)


def test_criterion_in_closed_form():
    """Trapezoid of 10 x v t_s-weighted positions and speeds along the free motion, by hand."""
    x, u, h, n = np.array([1.0, -0.3]), 2.0, 0.01, 100
    k = np.arange(1, n + 1)
    share = np.where(k < n, h, 0.5 * h)
    position, speed = x[0] + x[1] * k * h, x[1]
    moved = 1.5 * u * (0.5 * h * h + (k - 1) * h * h)
    expected = np.sum(share * (10.0 * position * moved + 1.0 * speed * 1.5 * u * h))
    assert mig_integral(TASK, quadratic(TASK), x, [u], horizon=n * h, dt=h) == pytest.approx(expected, rel=1e-12)


def test_ilqr_is_the_linear_regulator():
    """Over a long horizon the first control is that of the discrete Riccati equation."""
    h, gain = 0.05, 1.5
    a, b = np.array([[1.0, h], [0.0, 1.0]]), gain * np.array([[0.5 * h * h], [h]])
    q, r = h * np.diag([10.0, 1.0]), h * np.array([[0.1]])
    p = solve_discrete_are(a, b, q, r)
    x = np.array([0.1, 0.05])
    exact = -np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a) @ x
    found = controllers.make("ilqr", TASK, quadratic(TASK), dt=h, horizon=20.0, iterations=20, tolerance=0.0).solve(x)
    assert found.control == pytest.approx(exact, rel=1e-6)


def test_filtered_noise_reaches_the_origin():
    scenario = {"/**": {"ros__parameters": {"task": "double_integrator", "duration": 10.0}}}
    result = run_trial(scenario, 77)
    assert 0.3 < np.mean(result.verdict == Verdict.REPLACED) < 0.7
    assert abs(result.states[-1, 0]) < 0.5
    off = dict(scenario, **{"/**/mig_filter": {"ros__parameters": {"mode": "off"}}})
    assert np.abs(run_trial(off, 77).states[-1]).max() > np.abs(result.states[-1]).max()


def test_the_tutorial_shows_this_file():
    """Every block of code in the tutorial is in the task's file, word for word; only the indentation may differ."""

    def flat(text: str) -> str:
        return "\n".join(line.strip() for line in text.strip().splitlines())

    root = Path(__file__).resolve().parents[2]
    source = (root / "src/shared_control/shared_control/tasks/double_integrator.py").read_text()
    blocks = (root / "docs/new-task.md").read_text().split("```python\n")[1:]
    assert len(blocks) >= 3
    for block in blocks:
        assert flat(block.split("```")[0]) in flat(source)
