"""A live graph on its own domain, and the ``ros2`` command run against it, in this process or as one of its own."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest
import rclpy
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool

from ros2_fallback.cli import main

#: [s] only ever waited for in full by a test that fails
PATIENCE = 240.0


class Result(NamedTuple):
    """Exit code, stdout and stderr of a command."""

    code: int
    out: str
    err: str


class Running:
    """A command that runs as a process."""

    def __init__(self, argv: tuple[str, ...], environment: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ros2_fallback", *argv],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.pid = self._process.pid

    def line(self) -> str:
        """The next line of its stdout."""
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def stop_reading(self) -> None:
        """Go away as a reader of its stdout."""
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._process.stdout = None

    def send(self, signum: int) -> None:
        self._process.send_signal(signum)

    def finish(self) -> Result:
        """Wait for it to end."""
        out, err = self._process.communicate(timeout=PATIENCE)
        return Result(self._process.returncode, out or "", err)

    def kill(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()


class Rig:
    """One node of everything that the command can look at, served by a thread."""

    def __init__(self, domain_id: int) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain_id)
        self.node = rclpy.create_node("demo", namespace="rig", context=self.context)
        self.node.declare_parameter(
            "gain",
            1.5,
            ParameterDescriptor(
                description="how much", floating_point_range=[FloatingPointRange(from_value=0.0, to_value=3.0)]
            ),
        )
        self.node.declare_parameter("filter.mode", "off")
        self.node.declare_parameter("filter.weights", [1.0, 2.5])
        self.node.declare_parameter("unset", Parameter.Type.DOUBLE)

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.latched = self.node.create_publisher(String, "latched", latched)
        self.latched.publish(String(data="yes: no"))
        self.wrench = self.node.create_publisher(WrenchStamped, "wrench", 10)
        self.node.create_timer(0.01, self._publish_wrench)

        self.inbox: queue.Queue[Any] = queue.Queue()
        self.node.create_subscription(String, "inbox", self.inbox.put, 10)
        self.node.create_subscription(Header, "headers", self.inbox.put, 10)
        self.node.create_service(SetBool, "switch", self._switch)

        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin)
        self.thread.start()

    def _publish_wrench(self) -> None:
        message = WrenchStamped()
        message.header.frame_id = "base"
        message.wrench.force.x = 1e-05
        self.wrench.publish(message)

    @staticmethod
    def _switch(request: Any, response: Any) -> Any:
        response.success = request.data
        response.message = "switched"
        return response

    def received(self) -> Any:
        """The next message that came in on one of the topics subscribed to."""
        return self.inbox.get(timeout=PATIENCE)

    def close(self) -> None:
        self.executor.shutdown()
        self.thread.join()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(scope="module")
def domain_id() -> int:
    """One of 60 to 79, so that two runs at the same time seldom meet."""
    return 60 + os.getpid() % 20


@pytest.fixture(scope="module")
def environment(domain_id: int) -> Iterator[dict[str, str]]:
    """The environment of the command; this process has it too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain_id))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield dict(os.environ)


@pytest.fixture(scope="module")
def rig(environment: dict[str, str]) -> Iterator[Rig]:
    rig = Rig(int(environment["ROS_DOMAIN_ID"]))
    yield rig
    rig.close()


@pytest.fixture
def ros2(
    environment: dict[str, str],
    capsys: pytest.CaptureFixture[str],
) -> Callable[..., Result]:
    """Run the command in this process: saves the start of an interpreter and the import of rclpy."""

    def run(*argv: str) -> Result:
        capsys.readouterr()
        code = main(argv)
        out, err = capsys.readouterr()
        return Result(code, out, err)

    return run


@pytest.fixture
def ros2_process(environment: dict[str, str]) -> Iterator[Callable[..., Running]]:
    """Start the command as a process of its own; what still runs at the end is killed."""
    started: list[Running] = []

    def start(*argv: str, **more_environment: str) -> Running:
        started.append(Running(argv, environment | more_environment))
        return started[-1]

    yield start
    for process in started:
        process.kill()
