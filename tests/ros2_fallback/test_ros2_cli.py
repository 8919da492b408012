"""The command line itself: help, what is not there, and what is handed on."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable
from typing import Any

import pytest

from ros2_fallback.cli import COMMANDS

Ros2 = Callable[..., Any]


def test_help_says_what_it_is_and_what_it_has(ros2: Ros2) -> None:
    result = ros2("--help")
    assert result.code == 0
    assert "not ros2cli" in result.out
    assert all(name in result.out for name in COMMANDS)
    assert ros2() == result


@pytest.mark.parametrize(
    ("argv", "offered"),
    [
        (["daemon", "status"], COMMANDS),
        (["topic", "delay", "/x"], ["echo", "hz"]),
        (["node", "kill"], ["info", "list"]),
        (["--nonsense"], []),
        (["topic", "list", "--nonsense"], []),
        (["topic", "hz", "/x", "-w", "0"], []),
    ],
)
def test_what_is_not_there_is_answered_with_what_is(argv: list[str], offered: list[str], ros2: Ros2) -> None:
    result = ros2(*argv)
    assert result.code == 2
    assert result.out == ""
    assert "usage: ros2" in result.err
    assert all(name in result.err for name in offered)


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if command.verbs])
def test_listed_verbs_are_those_that_exist(name: str, ros2: Ros2) -> None:
    result = ros2(name)
    assert result.code == 0
    listed = COMMANDS[name].verbs.split(", ")
    section = result.out.split("Commands:\n")[1].split("\n\n")[0]
    assert [line.split()[0] for line in section.splitlines()] == listed
    for verb in listed:
        assert ros2(name, verb, "--help").code == 0


def test_bag_is_handed_to_rig_bag(ros2: Ros2, monkeypatch: pytest.MonkeyPatch) -> None:
    package, cli = types.ModuleType("rig_bag"), types.ModuleType("rig_bag.cli")
    package.__path__ = []
    cli.__spec__ = types.SimpleNamespace()  # type: ignore[assignment]
    cli.main = lambda argv: print(argv) or 5  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "rig_bag", package)
    monkeypatch.setitem(sys.modules, "rig_bag.cli", cli)
    assert ros2("bag", "info", "-h", "x y") == (5, "['info', '-h', 'x y']\n", "")


def test_bag_without_rig_bag_says_so(ros2: Ros2, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = types.ModuleType("rig_bag")
    empty.__path__ = []
    monkeypatch.setitem(sys.modules, "rig_bag", empty)
    monkeypatch.delitem(sys.modules, "rig_bag.cli", raising=False)
    result = ros2("bag", "info", "x")
    assert result.code == 1
    assert "rig_bag, which is not installed" in result.err


def test_interface_lists(ros2: Ros2) -> None:
    result = ros2("interface", "list")
    assert result.code == 0
    titles = [line for line in result.out.splitlines() if not line.startswith(" ")]
    assert titles == ["Messages:", "Services:", "Actions:"]
    assert "    geometry_msgs/msg/Wrench\n" in result.out
    assert "_Request" not in result.out
    assert "Messages:" not in ros2("interface", "list", "-s").out
    assert "std_srvs/srv/Trigger\n" in ros2("interface", "package", "std_srvs").out
    assert ros2("interface", "package", "std_srvs", "-m") == (0, "", "")
    assert ros2("interface", "package", "nowhere") == (1, "", "Unknown package 'nowhere'\n")
    assert "mig_interfaces\n" in ros2("interface", "packages").out


def test_interface_show(ros2: Ros2) -> None:
    assert ros2("interface", "show", "std_srvs/srv/SetBool", "--no-comments").out == (
        "bool data\n---\nbool success\nstring message\n"
    )
    shown = ros2("interface", "show", "geometry_msgs/msg/WrenchStamped").out.splitlines()
    assert shown[0].startswith("# ")
    start = shown.index("std_msgs/Header header")
    assert shown[start : start + 5] == [
        "std_msgs/Header header",
        "\tbuiltin_interfaces/Time stamp",
        "\t\tint32 sec",
        "\t\tuint32 nanosec",
        "\tstring frame_id",
    ]
    everything = ros2("interface", "show", "geometry_msgs/msg/WrenchStamped", "--all-comments").out
    assert "\t# " in everything
    bare = ros2("interface", "show", "mig_interfaces/msg/FilterDecision", "--no-comments").out
    assert "#" not in bare
    assert "uint8 VERDICT_REPLACED = 2\n" in bare
    for name, message in {
        "std_msgs/String": "Invalid name",
        "a/msg/B": "Unknown package",
        "std_msgs/msg/B": "B",
    }.items():
        result = ros2("interface", "show", name)
        assert result.code == 1
        assert message in result.err


def test_interface_proto(ros2: Ros2) -> None:
    assert ros2("interface", "proto", "std_srvs/srv/SetBool").out == '"data: false\n"\n'
    assert ros2("interface", "proto", "--no-quotes", "std_msgs/msg/Header").out == (
        "stamp:\n  sec: 0\n  nanosec: 0\nframe_id: ''\n\n"
    )
    assert ros2("interface", "proto", "std_msgs/msg/Nothing").code == 1
