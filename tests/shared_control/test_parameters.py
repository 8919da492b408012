"""Declared parameters: types, bounds, messages."""

from __future__ import annotations

import dataclasses

import pytest

from shared_control.admittance import AdmittanceConfig
from shared_control.filter import FilterConfig
from shared_control.parameters import ParameterError, build, declarations, parameter, shown
from shared_control.scenario import LoopConfig, TaskConfig
from shared_control.users import UserConfig

CONFIGS = (LoopConfig, FilterConfig, AdmittanceConfig, UserConfig, TaskConfig)


@dataclasses.dataclass(frozen=True)
class Example:
    ratio: float = parameter(0.5, "A ratio.", ge=0.0, le=1.0)
    count: int = parameter(3, "A count.", ge=1, unit="1")
    name: str = parameter("a", "A name.", choices=("a", "b"), live=True)
    on: bool = parameter(False, "A switch.")
    most: float = parameter(1.0, "At most one.", le=1.0, unit="m")
    weights: tuple[float, ...] = parameter([1.0, 2.0], "Weights.", ge=0.0, length=2)


def test_build():
    assert build(Example, {}) == Example()
    built = build(Example, {"ratio": 1, "weights": [3, 4.5], "on": True, "name": "b"})
    assert built == Example(ratio=1.0, weights=(3.0, 4.5), on=True, name="b")
    assert isinstance(built.ratio, float)
    assert isinstance(built.weights[0], float)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("ratio", 1.5),
        ("ratio", float("nan")),
        ("ratio", "0.5"),
        ("ratio", True),
        ("count", 0),
        ("count", 2.0),
        ("count", False),
        ("name", "c"),
        ("on", 1),
        ("weights", [1.0]),
        ("weights", [1.0, -1.0]),
        ("weights", 1.0),
        ("weights", "ab"),
        ("most", 2.0),
        ("most", 10**400),
    ],
)
def test_refused_by_name_value_and_range(key, value):
    with pytest.raises(ParameterError) as caught:
        build(Example, {key: value}, "here")
    message = str(caught.value)
    assert message.startswith(f"here: {key}: ")
    assert shown(value) in message
    assert next(d for d in declarations(Example) if d.name == key).allowed() in message


def test_unknown_with_nearest():
    with pytest.raises(ParameterError, match=r"here: unknown parameter rato = 1; did you mean ratio\?"):
        build(Example, {"rato": 1}, "here")
    with pytest.raises(ParameterError, match="known here: ratio, count, name"):
        build(Example, {"zzz": 1})


@pytest.mark.parametrize("cls", CONFIGS)
def test_every_default_is_allowed_and_described(cls):
    for declaration in declarations(cls):
        assert declaration.check(declaration.default) == declaration.default
        assert declaration.description.endswith(".")


def test_own_keys_never_coincide_with_shared_ones():
    shared = {declaration.name for declaration in declarations(LoopConfig)}
    for cls in CONFIGS[1:]:
        assert not shared & {declaration.name for declaration in declarations(cls)}


def test_a_value_is_shown_shortened() -> None:
    assert shown("word") == "'word'"
    assert shown([1.0, 2.0]) == "[1.0, 2.0]"
    assert len(shown("x" * 10_000)) < 200
    assert shown(1 << 40_000) == "a number of more digits than Python writes"
    assert len(str(ParameterError("y" * 5000))) < 1200
