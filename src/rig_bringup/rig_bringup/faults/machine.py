"""Faults of the machine: the wall clock is stepped, a disk is full, memory is short, a subscriber is slow."""

from __future__ import annotations

import ctypes
import errno
import itertools
import mmap
import os
import shutil
import signal
import struct
import subprocess
import time
from pathlib import Path

from mig_interfaces.msg import TrialState
from rig_bag import BagError
from rig_bag.repair import repair
from rig_bringup.faults.live_graph import FaultError, LiveGraph, patched_environment
from rig_bringup.faults.rows import NotHereError, Seen, expect_every_tick_once, expect_whole_bag, row
from rig_bringup.graph_process import GraphProcess
from rig_runtime import topics
from rig_runtime.ticks import from_stamp

_SAMPLE = 10_000_000  # [ns]

# -- the clock -----------------------------------------------------------------------------------------------------


class ClockGraph(LiveGraph):
    """A graph whose nodes see a wall clock that can be stepped; the machine's own is left alone."""

    kind = "clock"

    def __init__(self, folder: Path, namespace: str = "faults") -> None:
        compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
        if compiler is None:
            raise NotHereError("needs a C compiler")
        folder.mkdir(exist_ok=True)
        self._library = folder / "stepped_clock.so"
        source = Path(__file__).with_name("stepped_clock.c")
        command = [compiler, "-O2", "-shared", "-fPIC", "-o", str(self._library), str(source), "-ldl"]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode:
            raise NotHereError(f"needs a compiler that takes {source.name}: {built.stderr.strip()[-200:]}")
        self._file = folder / "step"
        self._file.write_bytes(bytes(8))
        with self._file.open("r+b") as file:
            self._step = mmap.mmap(file.fileno(), 8)
        super().__init__(folder, namespace)

    def environment(self) -> dict[str, str]:
        # Through shared memory the middleware itself does not get over a step back: docs/safety.md.
        return {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(os.environ["RIG_ROOT"]) / "config" / "fastdds_loopback.xml"),
            "LD_PRELOAD": str(self._library),
            "RIG_CLOCK_STEP": str(self._file),
        }

    def step(self, seconds: float) -> None:
        """Step the clock of every node by this much more."""
        (now,) = struct.unpack("q", self._step[:])
        self._step[:] = struct.pack("q", now + round(1e9 * seconds))


def _stepped(graph: ClockGraph, seconds: float) -> None:
    # What has not found each other before a step back may not do so after it.
    graph.wait(lambda: bool(graph.hand.decided), "no decision has come")
    graph.step(seconds)
    graph.ticks(200)
    graph.recover()
    expect_every_tick_once(graph)
    stamps = [from_stamp(state.header.stamp) for state in graph.hand.states]
    if any(after - before != _SAMPLE for before, after in itertools.pairwise(stamps)):
        raise FaultError("the stamps of the states are no more one sample apart")


@row("clock/forward", "the wall clock is stepped an hour on", "nothing but the next trial's date", on=ClockGraph)
def _clock_forward(graph: ClockGraph, _: int) -> Seen:
    _stepped(graph, 3600.0)
    hand, uid = graph.hand, graph.hand.trial.uid
    graph.kill("task_sim")
    graph.start("task_sim")
    graph.wait(
        lambda: hand.trial.uid != uid and hand.trial.phase == TrialState.PHASE_RUNNING, "no trial on the stepped clock"
    )
    hand.motions.clear()
    graph.recover()
    shift = 1e-9 * from_stamp(hand.trial.epoch) - time.time()
    return Seen([], f"the next trial is dated {shift / 60.0:+.0f} min from now")


@row(
    "clock/back",
    "the wall clock is stepped two hours back",
    "the trial and its bag do not notice; every node says so",
    on=ClockGraph,
)
def _clock_back(graph: ClockGraph, _: int) -> Seen:
    _stepped(graph, -7200.0)
    for name, process in graph.processes.items():
        if "stepped back by 7200.00 s" not in process.log.read_text():
            raise FaultError(f"{name} has not said that the clock was stepped back")
    return Seen([], f"{len(graph.hand.decided)} ticks")


# -- the disk ------------------------------------------------------------------------------------------------------


@row("disk/full", "the disk that a second recorder writes to is full", "it says so; the loop goes on; repaired")
def _disk_full(graph: LiveGraph, _: int) -> Seen:
    disk = graph.folder / "disk"
    disk.mkdir(exist_ok=True)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=384k", "tmpfs", str(disk)], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        raise NotHereError(f"needs the right to mount a small disk: {mounted.stderr.strip()}")
    try:
        recorder = graph.start_process("recorder", "second_recorder", graph.namespace, uri=str(disk / "bag"))
        try:
            graph.wait(
                lambda: "space" in graph.recorded(disk / "bag").message,
                "the recorder does not say that its disk is full",
                limit=60.0,
            )
            message = graph.recorded(disk / "bag").message
        finally:
            code = graph.end(recorder)
        if code == 0:
            raise FaultError("the recorder ended as if nothing had been wrong")
        expect_every_tick_once(graph)
        try:
            whole = repair(disk / "bag", graph.folder / "from_full_disk").out or disk / "bag"
        except BagError as error:
            raise FaultError(f"what was written cannot be repaired: {error}") from error
        count = expect_whole_bag(whole, every_tick=False)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=False)
    return Seen([], f"{count} messages in a whole bag; it said: {message.rpartition('/')[2]}")


# -- memory --------------------------------------------------------------------------------------------------------

_PIDFD_OPEN, _PROCESS_MADVISE, _MADV_PAGEOUT = 434, 440, 21


class _Piece(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


def _take_memory(pid: int) -> int:
    """Take from a process every page that the kernel would give up, as it does when memory is short; how many bytes."""
    libc = ctypes.CDLL(None, use_errno=True)
    file = libc.syscall(_PIDFD_OPEN, pid, 0)
    if file < 0:
        return 0
    try:
        before = _resident(pid)
        for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
            begin, end = (int(part, 16) for part in line.split()[0].split("-"))
            if begin >> 63:
                continue  # the kernel's own page
            piece = _Piece(begin, end - begin)
            refused = libc.syscall(_PROCESS_MADVISE, file, ctypes.byref(piece), 1, _MADV_PAGEOUT, 0) < 0
            if refused and ctypes.get_errno() in (errno.EPERM, errno.ENOSYS):
                raise NotHereError(f"needs process_madvise (CAP_SYS_NICE): {os.strerror(ctypes.get_errno())}")
        return before - _resident(pid)
    except (FileNotFoundError, ProcessLookupError):
        return 0  # it has just ended
    finally:
        os.close(file)


def _resident(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * mmap.PAGESIZE


@row(
    "memory/short",
    "every page that can be taken from the nodes is taken, ten times",
    "no tick twice, goes on by itself; from locked memory nothing is taken",
)
def _memory(graph: LiveGraph, _: int) -> Seen:
    locked = "memory locked" in graph.hand.diagnostics.get("mig_filter", (b"", {}))[1].get("scheduling", "")
    from_locked, _ticks = _without_memory(graph)
    if locked and from_locked > _SOME:
        raise FaultError(f"{1e-6 * from_locked:.1f} MB were taken from memory that is locked")
    if locked:
        expect_every_tick_once(graph)
    with patched_environment({"RIG_REALTIME": "off"}):
        graph.replace_filter()
    try:
        graph.recover()
        taken, still = _without_memory(graph)
    finally:
        graph.replace_filter()
    graph.recover()
    if twice := [tick for tick, count in graph.hand.decided.items() if count > 1]:
        raise FaultError(f"{len(twice)} ticks were decided twice")
    if taken < _SOME:
        swap = "" if len(Path("/proc/swaps").read_text().splitlines()) > 1 else ", and this machine has none"
        raise NotHereError(f"needs swap: {1e-6 * taken:.1f} MB could be taken{swap}")
    first = f"locked: {1e-6 * from_locked:.1f} MB; " if locked else ""
    return Seen([], f"{first}not locked: {1e-6 * taken:.0f} MB taken and needed again, {still} ticks under no force")


#: [B] What a process may give back by itself in a second.
_SOME = 1_000_000


def _without_memory(graph: LiveGraph) -> tuple[int, int]:
    """Take the filter's memory, and the others', ten times; how much [B] from the filter, and how often no force."""
    graph.hand.forget()
    names = {pid: name for name, process in graph.processes.items() for pid in process.left()}

    def take() -> int:
        taken = {pid: sum(_take_memory(pid) for _turn in range(10)) for pid in names}
        return sum(amount for pid, amount in taken.items() if names[pid] == "mig_filter")

    taken = graph.meanwhile(take, "memory is still being taken")
    graph.ticks(20)
    return taken, sum(heard.force == 0.0 for heard in graph.hand.motions)


# -- a slow subscriber ---------------------------------------------------------------------------------------------


@row("subscriber/slow", "a reliable subscriber that runs a tenth of the time", "the loop does not notice, nor the bag")
def _slow_subscriber(graph: LiveGraph, _: int) -> Seen:
    count = graph.hand.count_subscribers
    name = f"/{graph.namespace}/{topics.TASK_STATE.name}"
    before = count(name)
    command = ["ros2", "topic", "echo", name, "--qos-reliability", "reliable", "--qos-depth", "1"]
    subscriber = GraphProcess(command, graph.folder / "subscriber.log", {})
    try:
        graph.wait(lambda: count(name) > before, "the subscriber has not come", limit=30.0)
        graph.hand.forget()
        for _turn in range(5):
            subscriber.send_all(signal.SIGSTOP)
            graph.ticks(90)
            subscriber.send_all(signal.SIGCONT)
            graph.ticks(10)
        expect_every_tick_once(graph)
    finally:
        subscriber.send_all(signal.SIGCONT)
        graph.end(subscriber)
    held = sum(state.held for state in graph.hand.states)
    return Seen([], f"{len(graph.hand.decided)} ticks, {held} held")
