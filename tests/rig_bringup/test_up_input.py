"""Bad input to `./rig up` and to the set-up: one clear sentence, a non-zero exit code, nothing started."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from datetime import datetime, tzinfo
from pathlib import Path

import pytest
import yaml

from rig_bringup import up
from rig_bringup.provision import machine
from rig_bringup.provision.steps import failure_reason, mend_include_paths
from rig_runtime.claim import Claim

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RIG_ROOT", str(ROOT))


def scenario(tmp_path: Path, text: str) -> str:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("/**:\n  ros__parameters:\n    seeed: 1\n", ["seeed", "did you mean seed"]),
        ("/**:\n  ros__parameters:\n    seed: one\n", ["seed", "'one'", "int"]),
        ("/**/mig_filter:\n  ros__parameters:\n    horizon: -1.0\n", ["horizon", "-1.0"]),
        ("/**/mig_filter:\n  ros__parameters:\n    mode: hard\n", ["mode", "'hard'", "off, training, assistance"]),
        ("/**/mig_fliter:\n  ros__parameters:\n    mode: off\n", ["mig_fliter", "did you mean"]),
        ("/**/recorder:\n  ros__parameters:\n    url: x\n", ["url", "did you mean uri"]),
        ("{{{", ["YAML"]),
        ("- 1\n", ["mapping"]),
    ],
)
def test_a_bad_scenario_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: list[str]
) -> None:
    path = scenario(tmp_path, text)
    assert up.main([path, "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for word in [*words, "bad.yaml"]:
        assert word in said
    assert not (tmp_path / "run").exists()


def test_a_missing_scenario_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert up.main(["cart_pendulum_nose_assistance"]) == 2
    assert "did you mean cart_pendulum_noise_assistance" in capsys.readouterr().err


def test_a_bad_value_on_the_command_line_is_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert up.main(["--duration", "-3", "--out", str(tmp_path / "run")]) == 2
    assert "duration: -3.0" in capsys.readouterr().err


def test_runs_of_the_same_second_do_not_share_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Clock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Clock:
            return cls(2026, 1, 2, 3, 4, 5)

    monkeypatch.setattr(up, "datetime", Clock)
    monkeypatch.chdir(tmp_path)
    folders = [up._make_folder(None, "trial") for _ in range(3)]
    assert [folder.name for folder in folders] == [f"trial_2026-01-02_03-04-05{end}" for end in ("", "_2", "_3")]
    assert all(folder.is_dir() for folder in folders)


def test_a_bag_is_never_overwritten(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    assert up.main(["--out", str(tmp_path)]) == 2
    assert "no bag is ever overwritten" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--display", "--pacing", "lockstep"], "must be realtime"),
        (["--display", "--host", "0.0.0.0", "--token", "short"], "can be guessed"),
        (["--display", "--port", "70000"], "port: 70000"),
        (["--display", "--user-from", "bag"], "leave one out"),
        (["--port", "9000"], "--display"),
    ],
)
def test_a_display_that_cannot_be_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert up.main([*arguments, "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said
    assert not (tmp_path / "run").exists()


def test_with_a_person_the_files_of_a_run_name_the_display_and_hold_no_token(tmp_path: Path) -> None:
    given = up.parser().parse_args(["--display", "--host", "0.0.0.0", "--port", "9000"])
    checked, _ = up._load(given)
    assert len(given.token) >= 16
    assert f"?token={given.token}" in up.invitation(checked.display, given)
    files = up._write_parameters(tmp_path, tmp_path / "bag", checked)
    texts = "".join(file.read_text() for file in files)
    assert given.token not in texts
    assert "/**/user_sim" not in texts
    values = {
        name: body["ros__parameters"] for file in files for name, body in yaml.safe_load(file.read_text()).items()
    }
    assert values["/**/task_sim"]["autostart"] is False
    assert values["/**/task_sim"]["required_nodes"][0] == "display"
    assert yaml.safe_load(files[0].read_text())["/**/display"]["ros__parameters"]["port"] == 9000


def tools(tmp_path: Path, *names: str) -> dict[str, str]:
    """An environment whose PATH holds just these tools, and a checkout in which nothing is set up."""
    bin_ = tmp_path / "bin"
    bin_.mkdir()
    for name in names:
        (bin_ / name).symlink_to(shutil.which(name) or name)
    return {"PATH": str(bin_), "HOME": str(tmp_path)}


def bare_checkout(tmp_path: Path) -> Path:
    root = tmp_path / "checkout"
    root.mkdir()
    shutil.copy(ROOT / "rig", root / "rig")
    # Other tests write and rename what Python keeps compiled.
    shutil.copytree(ROOT / "src", root / "src", ignore=shutil.ignore_patterns("__pycache__"))
    return root


@pytest.mark.parametrize(("present", "missing"), [((), "C compiler"), (("cc",), "C++ compiler")])
def test_a_missing_compiler_is_named_with_a_remedy(tmp_path: Path, present: tuple[str, ...], missing: str) -> None:
    environment = tools(tmp_path, "bash", "dirname", "python3", *present)
    result = subprocess.run(
        [str(bare_checkout(tmp_path) / "rig"), "up"], env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    assert f"error: {missing}:" in result.stderr
    assert "apt install" in result.stderr


def test_no_python_is_named(tmp_path: Path) -> None:
    environment = tools(tmp_path, "bash", "dirname", "cat")
    environment["RIG_PYTHON"] = "python4"
    result = subprocess.run([str(ROOT / "rig"), "up"], env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "no python4 on PATH" in result.stderr


def test_another_distribution_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DISTRO", "humble")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.sep)
    finding = machine.ros_finding()
    assert not finding.ok
    assert "jazzy" in finding.remedy


def test_an_unsupported_processor_is_refused_on_the_wheel_route(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    monkeypatch.setattr(machine.platform, "machine", lambda: "riscv64")
    with pytest.raises(machine.MachineError, match=r"riscv64.*x86_64 only"):
        machine.require([machine.processor_finding()])


def test_an_unreachable_registry_is_said_in_one_sentence() -> None:
    log = "WARNING: Retrying ... NewConnectionError('failed to establish a new connection')"
    assert "registry cannot be reached" in failure_reason(log)
    assert "numpi" in failure_reason("ERROR: No matching distribution found for numpi")


def test_the_include_path_mend_is_idempotent(tmp_path: Path) -> None:
    target = tmp_path / "share" / "pkg" / "cmake" / "x.cmake"
    target.parent.mkdir(parents=True)
    target.write_text(
        'set(A "/opt/python/cp311-cp311/include/python3.11;'
        '/opt/python/cp311-cp311/lib/python3.11/site-packages/numpy/_core/include")\n'
    )
    assert mend_include_paths(tmp_path, tmp_path / "packages") == 1
    text = target.read_text()
    assert "/opt/python" not in text
    assert str(tmp_path / "packages" / "numpy" / "_core" / "include") in text
    assert mend_include_paths(tmp_path, tmp_path / "packages") == 0
    assert target.read_text() == text


def test_within_its_own_environment_the_set_up_has_nothing_new_to_do() -> None:
    program = (
        "import sys, pathlib; from rig_bringup.provision.steps import Places, steps;"
        "print([step.digest for step in steps(Places(pathlib.Path(sys.argv[1])))])"
    )
    base = sys._base_executable  # type: ignore[attr-defined]
    said = {
        python: subprocess.run(
            [python, "-c", program, str(ROOT)],
            env={**os.environ, "PYTHONPATH": str(ROOT / "src" / "rig_bringup")},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for python in (sys.executable, base)
    }
    assert base != sys.executable
    assert len(set(said.values())) == 1


def test_a_namespace_that_is_taken_is_refused_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    namespace, out = f"taken_{os.getpid()}", tmp_path / "run"
    other = Claim(77, namespace)
    try:
        assert up.main(["--namespace", namespace, "--out", str(out)]) == 2
    finally:
        other.close()
    assert f"another graph paces /{namespace} on domain 77" in capsys.readouterr().err
    assert not out.exists()
    monkeypatch.setenv("ROS_DOMAIN_ID", "mine")
    assert up.main(["--namespace", namespace, "--out", str(out)]) == 2
    assert "ROS_DOMAIN_ID=mine: must be a whole number" in capsys.readouterr().err
