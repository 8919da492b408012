"""Pictures of tasks: complete, and where the state says."""

from __future__ import annotations

import math

import pytest

from shared_control import tasks
from shared_control.scene import bars, constant, evaluate, state

#: What each shape needs, as the drawing programs know them.
NEEDS = {
    "cart": {"at", "width", "height"},
    "disc": {"at", "radius"},
    "rod": {"from", "to", "width"},
    "spring": {"from", "to", "rest", "width"},
    "ground": {"height"},
    "level": {"height"},
    "mark": {"x", "height"},
    "stop": {"x", "height"},
    "band": {"bottom", "top"},
    "sector": {"at", "radius", "middle", "half"},
}


def test_coordinates_are_sums_of_terms() -> None:
    coordinate = constant(0.5) + state(1) + state(0, 2.0, "sin") + state(0, -1.0, "cos")
    assert evaluate(coordinate, [0.3, 4.0]) == pytest.approx(0.5 + 4.0 + 2.0 * math.sin(0.3) - math.cos(0.3))


@pytest.mark.parametrize("name", tasks.names())
def test_every_picture_can_be_drawn(name: str) -> None:
    task = tasks.get(name)
    scene = task.scene(task.target)
    assert 0 <= scene["plot"] < task.n
    x = task.initial_state.tolist()
    for point in scene["points"].values():
        assert all(math.isfinite(evaluate(coordinate, x)) for coordinate in point)
    for shape in scene["shapes"]:
        assert NEEDS[shape["shape"]] <= shape.keys() <= NEEDS[shape["shape"]] | {"shape", "role"}
        assert {shape[key] for key in ("at", "from", "to") if key in shape} <= scene["points"].keys()
    assert scene["hand"]["at"] in scene["points"]


def test_the_pendulum_hangs_below_its_cart_at_the_start() -> None:
    task = tasks.get("cart_pendulum", length=1.5)
    points = task.scene(task.target)["points"]
    x = task.initial_state.tolist()
    assert [evaluate(coordinate, x) for coordinate in points["cart"]] == [0.0, 0.0]
    assert [evaluate(coordinate, x) for coordinate in points["bob"]] == pytest.approx([0.0, -1.5])


def test_stops_stand_where_a_track_ends() -> None:
    shapes = tasks.get("cart_pendulum", track=4.0).scene((0.0,) * 4)["shapes"]
    assert [shape["x"] for shape in shapes if shape["shape"] == "stop"] == [-4.0, 4.0]
    assert not [s for s in tasks.get("cart_pendulum").scene((0.0,) * 4)["shapes"] if s["shape"] == "stop"]


def test_a_task_without_a_picture_has_bars() -> None:
    assert bars((1.0, 2.0)) == {"bars": True, "target": [1.0, 2.0], "plot": 0}
