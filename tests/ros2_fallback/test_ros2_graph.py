"""The commands against a live graph, in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from std_msgs.msg import String

from ros2_fallback.message_text import to_yaml

Ros2 = Callable[..., Any]

pytestmark = pytest.mark.usefixtures("rig")

WRENCH = "geometry_msgs/msg/WrenchStamped"


def test_node(ros2: Ros2) -> None:
    assert ros2("node", "list") == (0, "/rig/demo\n", "")
    assert ros2("node", "list", "-c").out == "1\n"
    result = ros2("node", "info", "/rig/demo")
    assert result.code == 0
    lines = result.out.splitlines()
    assert lines[0] == "/rig/demo"
    assert [line for line in lines if line.endswith(":")] == [
        *("  Subscribers:", "  Publishers:", "  Service Servers:"),
        *("  Service Clients:", "  Action Servers:", "  Action Clients:"),
    ]
    publishers = lines[lines.index("  Publishers:") : lines.index("  Service Servers:")]
    assert f"    /rig/wrench: {WRENCH}" in publishers
    assert "    /rig/inbox: std_msgs/msg/String" in lines[: lines.index("  Publishers:")]
    assert "    /rig/switch: std_srvs/srv/SetBool" in lines
    assert result.out.endswith("  Action Clients:\n\n")


def test_node_that_is_not_there(ros2: Ros2) -> None:
    assert ros2("node", "info", "--spin-time", "0.1", "/no") == (1, "", "Unable to find node '/no'\n")


def test_topic_list(ros2: Ros2) -> None:
    result = ros2("topic", "list")
    assert result == (0, "/parameter_events\n/rig/headers\n/rig/inbox\n/rig/latched\n/rig/wrench\n/rosout\n", "")
    typed = ros2("topic", "list", "-t", "--no-daemon").out.splitlines()
    assert f"/rig/wrench [{WRENCH}]" in typed
    verbose = ros2("topic", "list", "-v").out
    assert verbose.startswith("Published topics:\n")
    assert f" * /rig/wrench [{WRENCH}] 1 publisher\n" in verbose.split("\nSubscribed topics:\n")[0]
    assert " * /rig/inbox [std_msgs/msg/String] 1 subscriber\n" in verbose.split("\nSubscribed topics:\n")[1]
    assert ros2("topic", "find", WRENCH).out == "/rig/wrench\n"
    assert ros2("topic", "find", "-c", "std_msgs/msg/String").out == "2\n"


def test_topic_type_and_info(ros2: Ros2) -> None:
    assert ros2("topic", "type", "/rig/wrench") == (0, f"{WRENCH}\n", "")
    assert ros2("topic", "type", "--spin-time", "0.1", "/nothing") == (1, "", "")
    assert ros2("topic", "info", "/rig/wrench").out == (f"Type: {WRENCH}\nPublisher count: 1\nSubscription count: 0\n")
    verbose = ros2("topic", "info", "-v", "rig/latched").out
    assert verbose.startswith("Type: std_msgs/msg/String\n\nPublisher count: 1\n\nNode name: demo\n")
    assert "Durability: TRANSIENT_LOCAL\n" in verbose
    assert verbose.endswith("\n\nSubscription count: 0\n\n")
    result = ros2("topic", "info", "--spin-time", "0.1", "/nothing")
    assert result == (1, "", "Unknown topic '/nothing'\n")


def test_topic_echo(ros2: Ros2) -> None:
    latched = ros2("topic", "echo", "--once", "/rig/latched")
    assert latched == (0, f"{to_yaml(String(data='yes: no'))}---\n", ""), "as durable as it is published"
    assert ros2("topic", "echo", "--once", "/rig/latched", "--field", "data").out == "yes: no\n---\n"
    assert ros2("topic", "echo", "--once", "/rig/latched", "--csv").out == "yes: no\n"
    assert ros2("topic", "echo", "--once", "/rig/wrench", WRENCH, "--field", "wrench.force").out == (
        "x: 1.0e-05\ny: 0.0\nz: 0.0\n---\n"
    )
    assert ros2("topic", "echo", "--once", "--raw", "/rig/latched").out.startswith("b'")
    info = ros2("topic", "echo", "--once", "-i", "/rig/latched").out
    head, message, end = info.split("---\n")
    assert {"received_timestamp", "source_timestamp"} <= set(yaml.safe_load(head))
    assert (message, end) == (to_yaml(String(data="yes: no")), "")


def test_topic_echo_filters_and_times_out(ros2: Ros2) -> None:
    assert ros2("topic", "echo", "--timeout", "0.2", "--filter", "m.wrench.force.x > 1", "/rig/wrench") == (0, "", "")
    result = ros2("topic", "echo", "--once", "--filter", "m.nothing", "/rig/wrench")
    assert result.code == 1
    assert "nothing" in result.err
    assert ros2("topic", "echo", "--filter", "m.", "/rig/wrench").code == 1


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["/rig/wrench", "--field", "wrench.forces"], "Invalid field 'wrench.forces'"),
        (["/rig/wrench", "--field", ".."], "Invalid field value"),
        (["/nothing", "--spin-time", "0.1"], "Could not determine the type"),
        (["/not a name"], "name"),
        (["/rig/wrench", "std_msgs/msg/Nothing"], "Nothing"),
    ],
)
def test_topic_echo_says_what_is_wrong(argv: list[str], words: str, ros2: Ros2) -> None:
    result = ros2("topic", "echo", "--once", *argv)
    assert result.code == 1
    assert words in result.err


def test_topic_pub(rig: Any, ros2: Ros2) -> None:
    result = ros2("topic", "pub", "--once", "/rig/inbox", "std_msgs/msg/String", "{data: hello}")
    assert result.code == 0
    assert result.out.endswith("publisher: beginning loop\npublishing #1: std_msgs.msg.String(data='hello')\n\n")
    assert rig.received().data == "hello"

    result = ros2("topic", "pub", "-t", "3", "-r", "100", "-p", "2", "/rig/inbox", "std_msgs/String", "data: again")
    assert result.code == 0
    assert result.out.count("publishing #") == 1
    assert [rig.received().data for _ in range(3)] == ["again"] * 3

    assert ros2("topic", "pub", "--once", "/rig/headers", "std_msgs/msg/Header", "stamp: now").code == 0
    assert rig.received().stamp.sec > 0
    assert rig.inbox.empty()


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["/rig/inbox", "std_msgs/msg/String", "{dat: x}"], "Failed to populate field: 'dat'"),
        (["/rig/inbox", "std_msgs/msg/String", "x"], "needs to be a dictionary"),
        (["/rig/inbox", "String", "{}"], "is not the name of an interface"),
        (["not a name", "std_msgs/msg/String"], "name"),
        (["/alone", "std_msgs/msg/String", "--max-wait-time-secs", "0.1"], "Timed out waiting for subscribers"),
    ],
)
def test_topic_pub_says_what_is_wrong(argv: list[str], words: str, ros2: Ros2) -> None:
    result = ros2("topic", "pub", "--once", *argv)
    assert result.code == 1
    assert words in result.err


def test_param_read(ros2: Ros2) -> None:
    assert ros2("param", "list").out.splitlines()[:4] == [
        *("/rig/demo:", "  filter.mode", "  filter.weights", "  gain"),
    ]
    assert "  gain (type: double)\n" in ros2("param", "list", "/rig/demo", "--param-type").out
    assert ros2("param", "list", "/rig/demo", "--filter", "filter").out == "  filter.mode\n  filter.weights\n"
    assert ros2("param", "get", "/rig/demo", "filter.mode") == (0, "String value is: off\n", "")
    assert ros2("param", "get", "--hide-type", "/rig/demo", "filter.weights").out == "[1.0, 2.5]\n"
    dump = ros2("param", "dump", "/rig/demo").out
    parameters = yaml.safe_load(dump)["/rig/demo"]["ros__parameters"]
    assert parameters["filter"] == {"mode": "off", "weights": [1.0, 2.5]}
    assert parameters["gain"] == 1.5
    assert "unset" not in parameters
    assert ros2("param", "describe", "/rig/demo", "gain").out == (
        "Parameter name: gain\n  Type: double\n  Description: how much\n"
        "  Constraints:\n    Min value: 0.0\n    Max value: 3.0\n"
    )


def test_param_write(rig: Any, ros2: Ros2, tmp_path: Path) -> None:
    assert ros2("param", "set", "/rig/demo", "gain", "2.5") == (0, "Set parameter successful\n", "")
    assert rig.node.get_parameter("gain").value == 2.5
    result = ros2("param", "set", "rig/demo", "gain", "5.5")
    assert result.code == 1
    assert result.err.startswith("Setting parameter failed: ")
    assert rig.node.get_parameter("gain").value == 2.5

    file = tmp_path / "parameters.yaml"
    file.write_text("/**: {ros__parameters: {gain: 0.5}}\n/other: {ros__parameters: {gain: 9.0}}\n")
    assert ros2("param", "load", "/rig/demo", str(file)) == (0, "Set parameter gain successful\n", "")
    assert rig.node.get_parameter("gain").value == 0.5
    result = ros2("param", "load", "/rig/demo", str(tmp_path / "nothing.yaml"))
    assert result.code == 1
    assert "nothing.yaml" in result.err


def test_param_of_a_node_that_is_not_there(ros2: Ros2) -> None:
    result = ros2("param", "get", "--spin-time", "0.1", "--timeout", "0", "/nobody", "gain")
    assert result == (1, "", "Node not found\n")


def test_service(ros2: Ros2) -> None:
    assert "/rig/switch [std_srvs/srv/SetBool]\n" in ros2("service", "list", "-t").out
    assert ros2("service", "find", "std_srvs/srv/SetBool").out == "/rig/switch\n"
    assert ros2("service", "type", "/rig/switch") == (0, "std_srvs/srv/SetBool\n", "")
    assert ros2("service", "info", "/rig/switch").out == (
        "Type: std_srvs/srv/SetBool\nClients count: 0\nServices count: 1\n"
    )
    result = ros2("service", "call", "/rig/switch", "std_srvs/srv/SetBool", "data: true")
    assert result.code == 0
    assert result.out.endswith(
        "requester: making request: std_srvs.srv.SetBool_Request(data=True)\n\n"
        "response:\nstd_srvs.srv.SetBool_Response(success=True, message='switched')\n\n"
    )
    result = ros2("service", "call", "/rig/switch", "std_srvs/srv/SetBool", "dat: true")
    assert result.code == 1
    assert "has no field 'dat'" in result.err
