"""`ros2 topic echo --filter`: Python's own answer where an expression is allowed, and nothing else that is run."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from hypothesis import example, given
from hypothesis import strategies as st

from ros2_fallback.command import CommandError
from ros2_fallback.filter_expression import message_test

MESSAGE = SimpleNamespace(
    tick=7, name="rig", state=[0.5, -2.0, 3.0], wrench=SimpleNamespace(force=SimpleNamespace(x=1.5, y=-4.0)), on=True
)


@pytest.mark.parametrize(
    "expression",
    ["m.tick > 5", "m.tick > 5 and abs(m.wrench.force.y) < 4", "not m.on", "m.name == 'rig'", "'i' in m.name",
     "0 < m.tick <= 7 < 9", "9 < m.tick < m.nothing", "m.state[0] + m.state[-1] == 3.5", "len(m.state[1:]) == 2",
     "max(m.state) - min(m.state) > 4", "any(x < -1 for x in m.state)", "all([x < 3 for x in m.state if x < 2])",
     "m.tick % 2 == 1 or m.nothing", "m.tick // 2", "-m.tick ** 2 < 0", "m.tick & 1 | 8 ^ 2", "~m.tick", "+m.tick",
     "(m.tick, m.name) == (7, 'rig')", "m.tick in (1, 7)", "m.tick not in [1, 7]", "m.on is True", "m.on is not True",
     "0.0 if m.on else 1.0", "m.state[m.tick - 6]", "round(m.wrench.force.x) != 2", "sum(m.state) / 3 >= 0.5",
     " m.on ", "m.state[::2] == [0.5, 3.0]"],
)  # fmt: skip
def test_it_is_what_python_says(expression: str) -> None:
    assert message_test(expression)(MESSAGE) == bool(eval(expression.strip(), {"m": MESSAGE}))  # noqa: S307


_NUMBERS = st.recursive(
    st.sampled_from(["m.tick", "m.state[1]", "2", "0.5", "-3", "m.on"]),
    lambda inner: (
        st.tuples(inner, st.sampled_from(["+", "-", "*", "<", "<=", ">", ">=", "==", "!=", "and", "or"]), inner).map(
            lambda parts: f"({' '.join(parts)})"
        )
        | inner.map(lambda part: f"(not {part})")
        | inner.map(lambda part: f"abs({part})")
        | st.tuples(inner, inner, inner).map(lambda parts: f"({parts[0]} if {parts[1]} else {parts[2]})")
    ),
    max_leaves=12,
)


@given(_NUMBERS)
def test_any_arithmetic_is_what_python_says(expression: str) -> None:
    assert message_test(expression)(MESSAGE) == bool(eval(expression, {"m": MESSAGE}))  # noqa: S307


@pytest.mark.parametrize(
    "expression",
    ["__import__('os').system('id')", "m.__class__", "open('/etc/passwd')", "eval('1')", "m.name.upper()", "print(m)",
     "(lambda: 1)()", "[abs(1) for abs in [m.name.upper]]", "[m for m in m.state]", "f'{m}'", "(x := 1)",
     "max(*m.state)", "max(m.state, key=abs)", "{1: 2}", "nothing", "[x for x in m.state for y in m.state]",
     "import os", "m.", "", "[x async for x in m.state]", "yield 1", "a\0b"],
)  # fmt: skip
def test_what_is_not_allowed_is_refused_before_a_message_comes(expression: str) -> None:
    with pytest.raises(CommandError, match="--filter"):
        message_test(expression)


@given(st.text(max_size=60))
@example("[" * 5000)
@example("-" * 5000 + "1")
@example("m" + ".a" * 5000)
def test_any_text_is_a_test_or_a_clear_refusal(expression: str) -> None:
    with contextlib.suppress(CommandError):
        message_test(expression)(WrenchStamped())


def test_without_an_expression_everything_passes() -> None:
    anything: Any = object()
    assert message_test(None)(anything)


def test_what_fails_on_a_message_says_why() -> None:
    with pytest.raises(CommandError, match=r"--filter 'm\.nothing'.*nothing"):
        message_test("m.nothing")(MESSAGE)
