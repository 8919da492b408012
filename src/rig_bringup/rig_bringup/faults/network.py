"""Faults of the network: a graph on two machines, which are two network namespaces with a bad line between them."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType

from rig_bringup.faults.live_graph import FaultError, LiveGraph
from rig_bringup.faults.rows import LIMIT, Inject, NotHereError, Seen, row

_CLONE_NEWNET = 0x40000000
_NEAR, _FAR = "rignear", "rigfar"
_UP_LIMIT = 10.0  # [s]

#: [s] After its push no force may be followed: the filter waits for `command_timeout` and so does the robot.
_TOO_LATE = 2.0 * LIMIT

#: A program for the kernel's filter that drops a packet if a random number is below a bound, for kernels without netem:
#: load random; jump if not below; drop; pass.
_DROP = "4,32 0 0 4294963256,53 1 0 {bound},6 0 0 2,6 0 0 0"

_libc = ctypes.CDLL(None, use_errno=True)


class Line:
    """Two network namespaces joined by a line: this thread goes into the one, `far` names the way into the other.

    Raises
    ------
    NotHereError: they cannot be made.
    """

    def __init__(self) -> None:
        if missing := [name for name in ("ip", "tc", "unshare", "nsenter") if shutil.which(name) is None]:
            raise NotHereError(f"needs {', '.join(missing)}; on Debian: apt install iproute2 util-linux")
        self._home = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        if _libc.unshare(_CLONE_NEWNET) != 0:
            os.close(self._home)
            raise NotHereError(f"needs the right to make network namespaces: {os.strerror(ctypes.get_errno())}")
        here = Path("/proc/thread-self/ns/net").readlink()
        self._holder = subprocess.Popen(["unshare", "--net", "sleep", "86400"])
        self.far = ["nsenter", f"--net=/proc/{self._holder.pid}/ns/net"]
        try:
            there = Path(f"/proc/{self._holder.pid}/ns/net")
            while self._holder.poll() is None and there.readlink() == here:
                time.sleep(0.01)
            for side, device, address in (([], _NEAR, "10.213.77.1/30"), (self.far, _FAR, "10.213.77.2/30")):
                if side == []:
                    _run(
                        "ip", "link", "add", _NEAR, "type", "veth", "peer", "name", _FAR, "netns", str(self._holder.pid)
                    )
                for command in (f"addr add {address} dev {device}", f"link set {device} up", "link set lo up"):
                    _run(*side, "ip", *command.split())
            self._wait_until_up()
        except BaseException as error:
            self.close()
            if isinstance(error, subprocess.CalledProcessError):
                raise NotHereError(f"needs the right to join network namespaces: {error.stderr.strip()}") from None
            raise

    def _wait_until_up(self) -> None:
        # The kernel may take a second to say so, and the middleware leaves out what is not up when it starts.
        end = time.monotonic() + _UP_LIMIT
        for side, device in (([], _NEAR), (self.far, _FAR)):
            while "state UP" not in _run(*side, "ip", "link", "show", "dev", device):
                if time.monotonic() > end:
                    raise NotHereError(f"needs a line that comes up; {device} has not within {_UP_LIMIT:.0f} s")
                time.sleep(0.01)

    def lose(self, share: float) -> str:
        """Lose this share of the packets, both ways; returns by what means."""
        for side, device in (([], _NEAR), (self.far, _FAR)):
            try:
                means = "netem"
                _run(*side, "tc", "qdisc", "replace", "dev", device, "root", "netem", "loss", f"{100 * share:g}%")
            except subprocess.CalledProcessError:
                means = "a filter in the kernel, which has no netem"
                _run(*side, "tc", "qdisc", "replace", "dev", device, "clsact")
                program = _DROP.format(bound=min(round(share * 2**32), 2**32 - 1))
                filter_ = ["filter", "replace", "dev", device, "egress", "pref", "1", "handle", "1", "bpf", "da"]
                _run(*side, "tc", *filter_, "bytecode", program)
        return means

    def close(self) -> None:
        """Back to where this thread was; the namespaces and the line between them go."""
        _libc.setns(self._home, _CLONE_NEWNET)
        os.close(self._home)
        self._holder.kill()
        self._holder.wait()


def _run(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


class SplitGraph(LiveGraph):
    """A graph whose filter is on another machine."""

    kind = "split"

    def __init__(self, folder: Path, namespace: str = "faults") -> None:
        self.line = Line()
        try:
            super().__init__(folder, namespace)
        except BaseException:
            self.line.close()
            raise

    def environment(self) -> dict[str, str]:
        # Both are on this machine after all: what they share but the line is to be of no use.
        return {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(os.environ["RIG_ROOT"]) / "config" / "fastdds_network.xml"),
        }

    def around(self, node: str) -> list[str]:
        return self.line.far if node == "mig_filter" else []

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        super().__exit__(kind, error, trace)
        self.line.close()


@row("network/cut", "the line to the filter is cut", "no force; goes on when it is mended", LIMIT, SplitGraph)
def _cut(graph: SplitGraph, repeats: int) -> Seen:
    zero, hand = [], graph.hand
    for _ in range(min(repeats, 50)):
        graph.recover()
        _beside(graph, 1.0)
        with graph.noting_stalls():
            graph.wait(
                lambda: bool(hand.motions) and hand.motions[-1].force == 0.0,
                "the force has not become zero",
                limit=10.0,
            )
        # When the packets were lost is not known to a tick; the last force that still came is before that.
        moved = hand.motions
        last = max(k for k, heard in enumerate(moved) if heard.force)
        zero.append(moved[last + 1].at - moved[last].at)
        _beside(graph, 0.0)
        hand.motions.clear()
    graph.recover()
    return Seen(zero)


def _lossy(share: float) -> Inject:
    def inject(graph: SplitGraph, _: int) -> Seen:
        means = _beside(graph, share)
        hand = graph.hand
        hand.forget()
        try:
            graph.ticks(500)
        finally:
            _beside(graph, 0.0)
        if twice := [tick for tick, count in hand.decided.items() if count > 1]:
            raise FaultError(f"{len(twice)} ticks were decided twice, the first is {twice[0]}")
        # From the push to the motion, for each that was followed.
        pushed = hand.account.pushed
        late = [heard.at - pushed[heard.stamp].at for heard in hand.motions if heard.force and heard.stamp in pushed]
        if max(late, default=0.0) > _TOO_LATE:
            raise FaultError(f"a force was followed {1e3 * max(late):.0f} ms after it was pushed")
        still = 100.0 * (1.0 - len(late) / max(len(hand.motions), 1))
        return Seen(late, f"these times: to a motion under force; {still:.0f} % under none; by {means}")

    return inject


def _beside(graph: SplitGraph, share: float) -> str:
    """Change the line while the hand goes on."""
    return graph.meanwhile(lambda: graph.line.lose(share), "the line could not be changed")


for _name, _share in (("a hundredth", 0.01), ("a tenth", 0.1)):
    row(
        f"network/loses {_name}",
        f"the line to the filter loses {_name} of its packets, both ways",
        "no tick twice, no force on what is late; goes on",
        LIMIT,
        SplitGraph,
    )(_lossy(_share))
