"""Wrapping and the objective."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared_control import cost, tasks
from shared_control.parameters import ParameterError

TASK = tasks.get("cart_pendulum")


@given(st.floats(-1e6, 1e6))
def test_wrap(angle):
    wrapped = cost.wrap(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_wrap_of_anything_finite(angle):
    assert -math.pi < cost.wrap(angle) <= math.pi


@given(st.floats(-1e6, 1e6))
def test_wrap_is_odd(angle):
    if abs(cost.wrap(angle)) != math.pi:
        assert cost.wrap(-angle) == -cost.wrap(angle)


def test_wrap_at_the_ends():
    assert cost.wrap(math.pi) == math.pi
    assert cost.wrap(-math.pi) == math.pi
    assert cost.wrap(math.nextafter(-math.pi, 0.0)) < 0.0
    assert cost.wrap(math.nextafter(math.pi, 4.0)) == pytest.approx(-math.pi)
    assert math.isnan(cost.wrap(math.nan))
    assert math.isnan(cost.wrap(math.inf))


def test_value_and_gradient_by_hand():
    c = cost.quadratic(TASK, (2.0, 3.0, 4.0, 5.0), (6.0,), (1.0, 0.0, 0.0, 0.0), (0.5, 0.0, 1.0, 0.0))
    x = (0.5 + 2.0 * math.pi + 0.1, 2.0, 3.0, -1.0)
    assert cost.running(c, x) == pytest.approx(0.5 * (2 * 0.01 + 3 * 4 + 4 * 4 + 5))
    assert cost.running_gradient(c, x) == pytest.approx((0.2, 6.0, 8.0, -5.0))
    assert cost.effort(c, (2.0,)) == 12.0
    assert cost.terminal(c, x) == pytest.approx(0.005)
    assert cost.terminal_gradient(c, x) == pytest.approx((0.1, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("state_weights", (1.0, 2.0)),
        ("state_weights", (1.0, 2.0, -3.0, 4.0)),
        ("control_weights", (math.nan,)),
        ("target", (math.inf, 0.0, 0.0, 0.0)),
    ],
)
def test_refused(name, values):
    with pytest.raises(ParameterError, match=name):
        cost.quadratic(TASK, **{name: values})
