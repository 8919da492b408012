"""Scenario files: what is shipped loads, what is wrong is told in a sentence."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from shared_control import scenario, tasks
from shared_control.scenario import ScenarioError
from shared_control.users import presets

CONFIG = Path(scenario.__file__).resolve().parents[3] / "config"
SHIPPED = sorted(path for task in tasks.names() for path in CONFIG.glob(f"{task}_*.yaml"))


def write(tmp_path, text):
    path = tmp_path / "trial.yaml"
    path.write_text(text)
    return path


def section(name, **values):
    return {name: {"ros__parameters": values}}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped(path):
    loaded = scenario.load(path)
    assert loaded.name == path.stem
    assert loaded.text_hash == hashlib.sha256(path.read_bytes()).hexdigest()
    if path.stem != "cart_pendulum_study":  # a study's protocol sets the user and the mode, trial by trial
        user = loaded.user.preset or loaded.user.user
        assert path.stem == f"{loaded.loop.task}_{user}_{loaded.filter.mode}"
    assert loaded.loop.ticks == 3000
    assert scenario.load(path.stem) == scenario.load(path.name) == loaded


def test_shipped_exist():
    modes, others = ("assistance", "training", "off"), ("low_skill", "skilled")
    wanted = {f"{task}_noise_{mode}" for task in ("cart_pendulum", "slip") for mode in modes}
    wanted |= {f"cart_pendulum_{user}_{mode}" for user in presets.SKILLED for mode in modes}
    wanted |= {f"slip_{user}_{mode}" for user in others for mode in ("assistance", "off")}
    assert wanted <= {p.stem for p in SHIPPED}


def test_mapping_and_defaults():
    empty = scenario.load({})
    assert empty.loop == scenario.LoopConfig()
    assert scenario.load(empty) is empty
    loaded = scenario.load(section("/**", seed=4) | section("/**/mig_filter", horizon=2) | section("/**/recorder", x=1))
    assert (loaded.loop.seed, loaded.filter.horizon) == (4, 2.0)
    assert loaded.text_hash != empty.text_hash
    assert (
        scenario.load(section("mig_filter", horizon=2)).filter
        == scenario.load(section("/x/mig_filter", horizon=2)).filter
    )


def test_ros_own_parameters_are_none_of_ours():
    assert scenario.load(section("/**", use_sim_time=False)).loop == scenario.LoopConfig()


def test_task_parameters_reach_the_task():
    task = scenario.load(section("/**", task_parameters=["length=1.5", "damping = 0"])).loop.make_task()
    assert (task.parameters.length, task.parameters.damping, task.parameters.mass) == (1.5, 0.0, 0.1)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (section("/**", sed=1), ["mapping", "/**", "sed", "1", "did you mean seed?"]),
        (section("/**", seed=-1), ["seed", "-1", "from 0 to"]),
        (section("/**", duration="long"), ["duration", "'long'", "float", "[s]"]),
        (section("/**", task="cart_pendulun"), ["task", "'cart_pendulun'", "one of cart_pendulum"]),
        (section("/**", task_parameters=["lenght=1"]), ["lenght", "did you mean length?"]),
        (section("/**", task_parameters=["length=-1"]), ["length", "-1.0", "greater than 0", "[m]"]),
        (section("/**", task_parameters=["length"]), ["task_parameters", "'length'", "name=number"]),
        (section("/**/task_sim", plant_parameters=["lenght=1"]), ["plant_parameters", "did you mean length?"]),
        (section("/**/task_sim", plant_parameters=["length"]), ["plant_parameters: 'length'", "name=number"]),
        (section("/**/mig_filter", mode="helpful"), ["mode", "'helpful'", "off, training, assistance"]),
        (section("/**/mig_filter", mode=False), ["mode", "False", "in quotes"]),
        (section("/**/mig_filter", horizon=0.0), ["horizon", "0.0", "from 0.001 to 60"]),
        (section("/**/mig_filter", state_weights=[1.0]), ["state_weights", "[1.0]", "4 elements"]),
        (section("/**/mig_filter", control_limits=[0.0]), ["control_limits", "positive"]),
        (section("/**/mig_fliter", mode="off"), ["unknown section /**/mig_fliter", "did you mean /**/mig_filter?"]),
        (section("/**/user_sim", noise_sd=[1.0, 2.0]), ["noise_sd", "1 controls"]),
        (section("/**/task_sim", initial_state=[1.0]), ["initial_state", "4 states"]),
        ({"/**": {"seed": 1}}, ["/**", "ros__parameters"]),
        ({"/**": {"ros__parameters": [1]}}, ["ros__parameters must be a mapping"]),
        (section("/**/mig_filter") | section("/mig_filter"), ["twice"]),
        (section("/**/mig_filter", horizon=0.004), ["horizon: 0.004", "one sample_time"]),
        (section("/**/mig_filter", controller_horizon=0.004), ["controller_horizon: 0.004", "one sample_time"]),
    ],
)
def test_refused(content, words):
    with pytest.raises(ScenarioError) as caught:
        scenario.load(content)
    for word in words:
        assert word in str(caught.value)


def test_refused_file_is_named(tmp_path):
    path = write(tmp_path, "/**:\n  ros__parameters:\n    seeds: 1\n")
    with pytest.raises(
        ScenarioError, match=r"trial\.yaml: section /\*\*: unknown parameter seeds = 1; did you mean seed"
    ):
        scenario.load(path)


def test_syntax_error_says_the_line(tmp_path):
    with pytest.raises(ScenarioError, match=r"trial\.yaml, line 2, column 4: not valid YAML"):
        scenario.load(write(tmp_path, "a: 1\nb: }\n"))


@pytest.mark.parametrize("text", ["just words\n", "- a\n- b\n"])
def test_not_a_mapping(tmp_path, text):
    with pytest.raises(ScenarioError, match="mapping of sections"):
        scenario.load(write(tmp_path, text))


def test_empty_file_is_all_defaults(tmp_path):
    assert scenario.load(write(tmp_path, "")).filter == scenario.FilterConfig()


def test_not_text(tmp_path):
    path = tmp_path / "trial.yaml"
    path.write_bytes(b"\xff\xfe\x00\x01\x02")
    with pytest.raises(ScenarioError, match=r"trial\.yaml"):
        scenario.load(path)


@pytest.mark.parametrize("name", ["", "a\0b", "x" * 300])
def test_what_is_no_files_name_is_refused(name):
    with pytest.raises(ScenarioError, match="is not the name of a file"):
        scenario.load(name)


def test_missing_lists_what_there_is(tmp_path, monkeypatch):
    monkeypatch.setenv("SHARED_CONTROL_CONFIG", str(tmp_path))
    with pytest.raises(ScenarioError, match="there are none in"):
        scenario.load("anything")
    (tmp_path / "first.yaml").write_text("")
    with pytest.raises(ScenarioError, match=r"'frist' not found; did you mean first\.yaml\? there are: first\.yaml"):
        scenario.load("frist")
    assert scenario.load("first").name == "first"
