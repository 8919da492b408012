"""Deciding again what a bag holds: the same to the last bit, or the first difference; and another filter's view."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from whole_graph import sections

import rig_bag
from mig_interfaces.msg import FilterDecision
from rig_bag import BagWriter
from rig_bag.definitions import full_definition
from rig_bag.verify import verify
from rig_bringup.__main__ import main as command
from rig_bringup.scenario import Checked
from rig_study.recorded import TrialError, load, measured, scenario_of
from rig_study.recorded_inputs import load_inputs, user_forces
from rig_study.rederive import rederive, simulate
from rig_study.rederive_cli import main
from rig_study.tables import read
from shared_control import scenario as science
from shared_control import tasks
from shared_control.trial import run_trial

DECISION = "/rig/mig_filter/decision"


def copy(
    source: Path,
    target: Path,
    change: Callable[[str, int, bytes], bytes | None],
    attachment: bytes = b"",
    definitions: Mapping[str, str] | None = None,
) -> Path:
    """A bag with the messages of another; ``change`` gets topic, number and data, and returns the data or None.

    ``definitions`` are the texts of types that are not as installed.
    """
    counts: dict[str, int] = {}
    with BagWriter(target) as writer:
        if attachment:
            writer.attach("scenario.yaml", attachment, "application/yaml")
        for message in rig_bag.messages(source):
            number = counts.get(message.topic, 0)
            counts[message.topic] = number + 1
            data = change(message.topic, number, message.data)
            if data is not None:
                text = (definitions or {}).get(message.type)
                channel = writer.add_topic(message.topic, message.type, definition=text)
                writer.write(channel, data, message.log_time, message.publish_time)
    return target


def scenario_text(folder: Path) -> bytes:
    """The scenario of `whole_graph`, as `up` attaches it."""
    content = {key: value for key, value in sections(folder).items() if key not in ("/**/recorder", "/**/task_sim")}
    return Checked(science.load(content), {}).text().encode()


def write(folder: Path, content: dict[str, Any]) -> str:
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(content))
    return str(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bags")


@pytest.fixture
def bag(folder: Path, request: pytest.FixtureRequest) -> Path:
    """Two seconds of the graph in lockstep, with the scenario attached; recorded once."""
    path = folder / "bag"
    if not path.exists():
        recorded = request.getfixturevalue("run_composed")("recorded")
        copy(recorded, path, lambda topic, number, data: data, scenario_text(folder))
    return path


def test_unchanged_it_is_identical(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    derived = rederive(load_inputs(bag))
    assert derived.difference() is None
    assert len(derived.decisions) == 200
    assert set(derived.decisions["verdict"].tolist()) == {0, 2}
    assert np.trace(derived.confusion()) == 200
    assert main([str(bag)]) == 0
    assert "identical: 200 decisions" in capsys.readouterr().out


def test_a_hybrid_task_is_decided_in_its_mode(run_composed: Callable[..., Path], tmp_path: Path) -> None:
    loop = {"task": "slip", "robot_mass": 0.01, "robot_damping": 40.0, "seed": 3}
    recorded = run_composed("slip", **loop)
    content = {key: value for key, value in sections(tmp_path, **loop).items() if key.endswith(("**", "filter"))}
    inputs = load_inputs(recorded, write(tmp_path, content))
    headless = run_trial(content, 3)
    np.testing.assert_array_equal(inputs.states, headless.states[:-1])
    np.testing.assert_array_equal(inputs.task_modes, headless.task_modes[:-1])
    # Somewhere the state alone would have told another mode.
    task = tasks.get("slip")
    assert any(task.mode(x) != mode for x, mode in zip(inputs.states, inputs.task_modes, strict=True))
    assert rederive(inputs).difference() is None


def test_a_fall_is_judged_by_the_parameters_of_its_trial(run_composed: Callable[..., Path], tmp_path: Path) -> None:
    loop = {"task": "slip", "robot_mass": 0.01, "robot_damping": 40.0, "seed": 3}
    loop["task_parameters"] = ["fall_height=0.9"]
    content = {key: value for key, value in sections(tmp_path, **loop).items() if key.endswith(("**", "filter"))}
    recorded = run_composed("slip", **loop)
    with pytest.raises(TrialError, match="0 scenarios attached"):
        measured(load(recorded))
    attached = copy(recorded, tmp_path / "attached", lambda topic, number, data: data, yaml.safe_dump(content).encode())
    found, headless = measured(load(attached)), run_trial(content, 3).measures
    assert found is not None
    assert found.fell
    assert repr(found) == repr(headless)


def test_a_bag_from_before_attempts_were_counted_is_read(bag: Path, tmp_path: Path) -> None:
    kind = "mig_interfaces/msg/TrialState"
    now = full_definition(kind)
    then = "\n".join(line for line in now.splitlines() if not line.startswith("uint32 attempt"))
    new, old = (get_typestore(Stores.ROS2_JAZZY) for _ in range(2))
    new.register({name: value for name, value in get_types_from_msg(now, kind).items() if name not in new.fielddefs})
    old.register({name: value for name, value in get_types_from_msg(then, kind).items() if name not in old.fielddefs})

    def older(topic: str, number: int, data: bytes) -> bytes:
        if topic != "/rig/trial/state":
            return data
        values = dict(vars(new.deserialize_cdr(data, kind)))
        del values["attempt"]
        values.pop("__msgtype__", None)
        return bytes(old.serialize_cdr(old.types[kind](**values), kind))

    changed = copy(bag, tmp_path / "older_a3", older, scenario_text(tmp_path), {kind: then})
    assert [check.name for check in verify(changed).checks if check.result == "failed"] == ["definitions"]
    found = read([changed])
    assert not found.left_out
    assert list(found.trials["attempt"]) == [3]
    assert rederive(load_inputs(changed)).difference() is None


def test_the_first_difference_is_shown(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change(topic: str, number: int, data: bytes) -> bytes:
        if topic != DECISION or number not in (120, 150):
            return data
        decision = deserialize_message(data, FilterDecision)
        decision.criterion = float(np.nextafter(decision.criterion, np.inf))
        return bytes(serialize_message(decision))

    other = copy(bag, tmp_path / "other", change, scenario_text(tmp_path))
    difference = rederive(load_inputs(other)).difference()
    assert difference is not None
    assert (difference.tick, difference.fields) == (120, ("criterion",))
    assert main([str(other)]) == 1
    said = capsys.readouterr().out
    assert "first difference is at tick 120" in said
    assert f"{difference.recorded['criterion']!r}".removeprefix("np.float64(").removesuffix(")") in said


def test_another_filter_is_a_counterfactual(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plot = tmp_path / "plot.svg"
    assert main([str(bag), "--set", "mig_filter.mode=off", "--plot", str(plot)]) == 0
    said = capsys.readouterr().out
    assert "counterfactual" in said
    recorded = rig_bag.read(bag, [DECISION])[DECISION]
    replaced = int(np.count_nonzero(recorded["verdict"] == 2))
    assert f"{replaced} of 200 verdicts" in said
    assert "accepted      " in said
    assert "counterfactual" in plot.read_text()
    changed = load_inputs(bag)
    off = rederive(changed, science.load({"/**/mig_filter": {"ros__parameters": {"mode": "off"}}}))
    np.testing.assert_array_equal(off.confusion(), [[200 - replaced, 0, 0], [0, 0, 0], [replaced, 0, 0]])


def test_closed_loop_with_the_same_filter_is_the_recorded_trial(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inputs = load_inputs(bag)
    again = simulate(inputs, user_forces(bag))
    np.testing.assert_array_equal(again.states[:-1], inputs.states)
    assert main([str(bag), "--closed-loop"]) == 0
    assert "all 200 states are the same" in capsys.readouterr().out
    assert main([str(bag), "--closed-loop", "--set", "mig_filter.mode=off"]) == 0
    assert "others from then on" in capsys.readouterr().out


def test_a_mode_that_was_changed_is_followed(folder: Path, bag: Path) -> None:
    """The decisions of another mode, as a live change leaves them, are re-derived in that mode."""
    inputs = load_inputs(bag)
    half = rederive(inputs, science.load({"/**/mig_filter": {"ros__parameters": {"mode": "off"}}})).decisions[100:]

    def change(topic: str, number: int, data: bytes) -> bytes:
        if topic != DECISION or number < 100:
            return data
        decision, other = deserialize_message(data, FilterDecision), half[number - 100]
        decision.mode, decision.verdict, decision.reason = map(int, other[["mode", "verdict", "reason"]])
        decision.criterion = float(other["criterion"])
        decision.applied_control = other["applied_control"].tolist()
        for name in ("admitted_force", "added_force"):
            vector = getattr(decision, name)
            vector.x, vector.y, vector.z = other[name].tolist()
        return bytes(serialize_message(decision))

    changed = copy(bag, folder / "changed", change, scenario_text(folder))
    assert rederive(load_inputs(changed)).difference() is None


def test_what_is_missing_is_said(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(name: str, numbers: range) -> Callable[[str, int, bytes], bytes | None]:
        return lambda topic, number, data: None if topic.endswith(name) and number in numbers else data

    bare = copy(bag, tmp_path / "bare", without("", range(0)))
    assert main([str(bare)]) == 2
    assert "--scenario" in capsys.readouterr().err
    gap = copy(bag, tmp_path / "gap", without("task/state", range(50, 51)), scenario_text(tmp_path))
    assert main([str(gap)]) == 2
    assert "the state or the wrench of tick 50 is missing" in capsys.readouterr().err
    cut = copy(bag, tmp_path / "cut", without("force_sensor/wrench", range(198, 200)), scenario_text(tmp_path))
    assert main([str(cut)]) == 0
    said = capsys.readouterr().out
    assert "2 decisions at the end are left out" in said
    assert "identical: 198" in said
    for change, says in (
        ("horizon=1", "NODE.KEY=VALUE"),
        ("mig_filter.horizn=1", "did you mean horizon"),
        ("mig_filter.horizon=-1", "horizon: -1"),
        ("task_sim.initial_sd=[0.1]", "--closed-loop"),
    ):
        assert main([str(bag), "--set", change]) == 2
        assert says in capsys.readouterr().err
    shutil.rmtree(gap)
    monkeypatch.setattr("sys.argv", ["rig", "rederive", str(gap)])
    assert command() == 2
    assert "there is no bag" in capsys.readouterr().err


def test_the_attached_scenario_is_the_one_that_ran(bag: Path) -> None:
    scenario: Any = scenario_of(bag)
    assert (scenario.loop.seed, scenario.loop.pacing, scenario.loop.duration) == (7, "lockstep", 2.0)
