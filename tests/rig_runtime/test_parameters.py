"""Parameters from dataclasses: described, bounded, read-only unless live, refused with an error that names them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import pytest
import yaml
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python

from rig_runtime.node import RigNode
from shared_control.parameters import ParameterError, parameter


@dataclass(frozen=True)
class Config:
    gain: float = parameter(1.5, "How strongly.", unit="N", ge=0.0, le=10.0, live=True)
    count: int = parameter(3, "How many.", ge=1)
    mode: str = parameter("a", "Which.", choices=("a", "b"), live=True)
    weights: tuple[float, ...] = parameter((1.0, 2.0), "Weights.", length=2, ge=0.0)
    nothing: tuple[float, ...] = parameter((), "Empty unless given.")


def make(graph: Any, *parameters: str) -> RigNode:
    return graph.make(lambda **kwargs: RigNode("node", Config, **kwargs), *parameters)


def test_defaults_and_overrides(single_graph: Any) -> None:
    assert make(single_graph).parameters.get(Config) == Config()


def test_overrides_come_from_the_command_line(single_graph: Any) -> None:
    node = make(single_graph, "gain:=2.0", "weights:=[3.0, 4.0]", "mode:=b", "nothing:=[1.0]")
    assert node.parameters.get(Config) == Config(gain=2.0, weights=(3.0, 4.0), mode="b", nothing=(1.0,))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("gain:=11.0", ["gain", "11.0", "from 0 to 10", "[N]"]),
        ("gain:=high", ["gain", "high", "float"]),
        ("count:=0", ["count", "0", "at least 1"]),
        ("mode:=c", ["mode", "'c'", "one of a, b"]),
        ("weights:=[1.0]", ["weights", "2 elements"]),
        ("weights:=[1.0, -1.0]", ["weights", "at least 0"]),
        ("gian:=1.0", ["gian", "did you mean gain"]),
    ],
)
def test_a_bad_override_is_refused_and_named(single_graph: Any, override: str, words: list[str]) -> None:
    with pytest.raises(ParameterError) as caught:
        make(single_graph, override)
    for word in [*words, "/rig/node"]:
        assert word in str(caught.value)


def test_descriptors_carry_unit_description_and_bounds(single_graph: Any) -> None:
    node = make(single_graph)
    gain = node.describe_parameter("gain")
    assert gain.description == "How strongly. [N]"
    assert (gain.floating_point_range[0].from_value, gain.floating_point_range[0].to_value) == (0.0, 10.0)
    assert not gain.read_only
    count = node.describe_parameter("count")
    assert count.read_only
    assert count.type == ParameterType.PARAMETER_INTEGER
    assert count.integer_range[0].from_value == 1


def test_a_live_parameter_changes_and_is_told(single_graph: Any) -> None:
    node = make(single_graph)
    seen = []
    node.parameters.on_change(lambda: seen.append(node.parameters.get(Config).gain))
    assert node.set_parameters([Parameter("gain", value=4.0)])[0].successful
    assert seen == [4.0]


@pytest.mark.parametrize(("name", "value"), [("gain", -1.0), ("mode", "c"), ("count", 4)])
def test_a_bad_change_is_refused_and_changes_nothing(single_graph: Any, name: str, value: Any) -> None:
    node = make(single_graph)
    result = node.set_parameters([Parameter(name, value=value)])[0]
    assert not result.successful
    assert name in result.reason
    assert node.parameters.get(Config) == Config()


def test_a_change_of_what_is_not_the_rigs_is_none_of_its_business(single_graph: Any) -> None:
    node = make(single_graph)
    assert node.set_parameters([Parameter("use_sim_time", value=False)])[0].successful
    assert node.parameters.get(Config) == Config()


@pytest.mark.parametrize("service", [SetParameters, SetParametersAtomically])
def test_a_value_of_a_type_that_there_is_not_is_refused_and_ends_nothing(single_graph: Any, service: Any) -> None:
    node = make(single_graph)
    name = "set_parameters" + ("_atomically" if service is SetParametersAtomically else "")
    good = Parameter("gain", value=4.0).to_parameter_msg()
    strange = ParameterMessage(name="mode", value=ParameterValue(type=200))
    answer = single_graph.call(service, f"/rig/node/{name}", service.Request(parameters=[good, strange]))
    results = answer.results if service is SetParameters else [answer.result]
    assert len(results) == (2 if service is SetParameters else 1)
    assert not any(result.successful for result in results)
    assert all(result.reason == "'mode': there is no type 200; nothing was changed" for result in results)
    assert node.parameters.get(Config) == Config()
    answer = single_graph.call(service, f"/rig/node/{name}", service.Request(parameters=[good]))
    assert node.parameters.get(Config).gain == 4.0


def test_all_values_come_in_one_answer_and_a_dump_of_them_loads_again(single_graph: Any, tmp_path: Path) -> None:
    node = make(single_graph)
    declared = [field.name for field in fields(Config)]
    answer = single_graph.call(GetParameters, "/rig/node/get_parameters", GetParameters.Request(names=declared))
    values = dict(zip(declared, map(parameter_value_to_python, answer.values), strict=True))
    assert values == {"gain": 1.5, "count": 3, "mode": "a", "weights": [1.0, 2.0], "nothing": []}
    assert answer.values[-1].type == ParameterType.PARAMETER_DOUBLE_ARRAY
    assert not node.set_parameters([Parameter("nothing", value=[1.0])])[0].successful

    dump = tmp_path / "dump.yaml"
    dump.write_text(yaml.dump({"/**": {"ros__parameters": values}}))
    single_graph.remove(node)
    again = single_graph.make(lambda **kwargs: RigNode("node", Config, **kwargs), params_file=dump)
    assert again.parameters.get(Config) == Config()
