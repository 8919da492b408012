"""Settings of the process for a steady loop: real-time scheduling, locked memory, processors, the garbage collector.

Two environment variables ask for them, because they concern a process, whatever nodes it has and parameters they read:

    RIG_REALTIME   off (the default), auto: what is permitted, require: an error if anything is not
    RIG_CPUS       processors to run on, such as 0,2-3; `all`; or `one`, whichever the process is on at its start

Without RIG_CPUS it is all of them, but for a whole graph in one process that real-time scheduling was granted, which
takes one. Its nodes answer one after the other, and Python's interpreter serves one thread at a time: another processor
adds nothing but the middleware's threads that wake up there and make the loop wait for what they hold.

`./rig up` asks for `auto` where the trial is paced by wall time. A graph in lockstep takes all the time it gets and
must never run before everything else, so there it asks for `off`. Nothing but Python is needed here: `./rig doctor`
asks before anything is installed.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import sys
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

#: Above every ordinary thread, below the kernel's threads for interrupts (50), which timers and the network need.
PRIORITY = 20

#: What `./rig doctor` asks to be allowed: one more, for a measurement that comes before the nodes (`bench/jitter.py`).
ALLOWED = PRIORITY + 1

#: How Fast DDS names the thread that sends what is not sent at once. It goes round without a pause for as long as
#: another wants to take a sample back from it (its `FlowControllerImpl`), and on one processor that one never comes to
#: it unless it is scheduled above: a composed graph stood still so for good.
_SPINNING = "dds.asyn"

MODES = ("off", "auto", "require")

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK = 14


class RealtimeError(Exception):
    """What was asked for is not a setting, or cannot be had; the message says why and what to do."""


@dataclass(frozen=True)
class Settings:
    """What is asked for."""

    mode: str = "off"
    cpus: frozenset[int] = frozenset()
    #: Keep to one processor where real-time scheduling is granted.
    alone: bool = False

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ, *, alone: bool = False) -> Settings:
        """From RIG_REALTIME and RIG_CPUS; `alone` is for a process for which RIG_CPUS says nothing.

        Raises
        ------
        RealtimeError: a value that is none.
        """
        mode = environment.get("RIG_REALTIME") or "off"
        if mode not in MODES:
            raise RealtimeError(f"RIG_REALTIME={mode} is not known; it must be one of {', '.join(MODES)}")
        cpus = _processors(environment.get("RIG_CPUS", ""))
        return cls(mode, cpus, alone and mode != "off" and not cpus)


def _present_processor() -> int:
    return int(ctypes.CDLL(None).sched_getcpu())


def _processors(text: str) -> frozenset[int]:
    if text == "all":
        return frozenset(os.sched_getaffinity(0))
    if text == "one":
        return frozenset({_present_processor()})
    chosen: set[int] = set()
    try:
        for part in filter(None, (part.strip() for part in text.split(","))):
            first, _, last = part.partition("-")
            chosen.update(range(int(first), int(last or first) + 1))
    except ValueError:
        raise RealtimeError(f"RIG_CPUS={text} names no processors; write them as 0,2-3, or all, or one") from None
    usable = os.sched_getaffinity(0)
    if not chosen <= usable:
        names = " ".join(map(str, sorted(usable)))
        raise RealtimeError(f"RIG_CPUS={text}: not all of these are usable here; there are {names}")
    return frozenset(chosen)


class Realtime:
    """Applies settings, each at the moment in a process's life at which it can take hold.

    Raises
    ------
    RealtimeError: from any method, if the mode is `require` and something is refused.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        #: What was asked for and not granted, in words.
        self.refused: list[str] = []
        #: Threads that are none of the middleware's.
        self._others: set[int] = set()

    def before_middleware(self) -> None:
        """Choose processors, which the middleware's threads inherit, and say at once what is refused."""
        self._others = threads()
        cpus = self._settings.cpus
        if self._settings.mode != "off":
            refusal = request_fifo()
            if not refusal:
                release_fifo()
                cpus = frozenset({_present_processor()}) if self._settings.alone else cpus
            self._note("SCHED_FIFO", refusal)
            self._note("locked memory", memory_refusal())
        if cpus:
            os.sched_setaffinity(0, cpus)

    def before_ticks(self, below: Iterable[threading.Thread] = ()) -> None:
        """Keep the garbage collector from what is loaded, lock it in memory, and come before everything else.

        Not earlier: to load, compile and set up takes a second, and must not hold up a graph that runs, nor use up what
        the kernel allows real-time threads in a second. This thread and those of the middleware are scheduled alike,
        the threads `below` just below them. Python's other threads stay as they are, and so do those that libraries had
        started before the middleware: they have no part in the loop.
        """
        freeze_garbage()
        if self._settings.mode == "off":
            return
        self._note("locked memory", request_memory())
        refusal = request_fifo()
        self._note("SCHED_FIFO", refusal)
        if not refusal:
            python = {thread.native_id for thread in threading.enumerate()}
            for thread in threads() - self._others - python:
                _schedule(thread, PRIORITY - 1 if _name_of(thread).startswith(_SPINNING) else PRIORITY)
            for own in below:
                if own.native_id is not None:
                    _schedule(own.native_id, PRIORITY - 1)

    def _note(self, what: str, refusal: str) -> None:
        if not refusal or f"no {what}: {refusal}" in self.refused:
            return
        if self._settings.mode == "require":
            raise RealtimeError(f"RIG_REALTIME=require, but no {what}: {refusal}; ./rig doctor says how to allow it")
        self.refused.append(f"no {what}: {refusal}")
        print(f"rig_runtime: no {what}: {refusal}; ./rig doctor says how to allow it", file=sys.stderr)

    def describe(self) -> str:
        """What holds for this thread, as the kernel has it, and what was refused."""
        fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
        parts = [f"SCHED_FIFO {os.sched_getparam(0).sched_priority}" if fifo else "ordinary scheduling"]
        parts.append("memory locked" if _status("VmLck").split()[:1] not in ([], ["0"]) else "memory not locked")
        if gc.get_freeze_count() and not gc.isenabled():
            parts.append("garbage collector frozen")
        parts.append(f"processors {' '.join(map(str, sorted(os.sched_getaffinity(0))))}")
        return "; ".join([", ".join(parts), *self.refused])


def threads() -> set[int]:
    """Every thread of this process, by the kernel's number."""
    return {int(entry.name) for entry in os.scandir("/proc/self/task")}


def _name_of(thread: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/self/task/{thread}/comm").read_text(encoding="utf-8")
    return ""


def _schedule(thread: int, priority: int = PRIORITY) -> None:
    # It may have ended since it was seen.
    with contextlib.suppress(ProcessLookupError):
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))


def request_fifo() -> str:
    """Give this thread SCHED_FIFO; returns why that is refused, or nothing."""
    try:
        _schedule(0)
    except OSError as error:
        return f"{error.strerror} (limit rtprio {limit('rtprio')}, wanted {PRIORITY})"
    return ""


def release_fifo() -> None:
    """Ordinary scheduling for this thread."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def memory_refusal() -> str:
    """Why memory cannot be locked, or nothing.

    A limit that is not unlimited counts as a refusal: locking would succeed, and a later allocation fail.
    """
    privileged = int(_status("CapEff") or "0", 16) >> _CAP_IPC_LOCK & 1
    if privileged or limit("memlock") == "unlimited":
        return ""
    return f"limit memlock {limit('memlock')}, wanted unlimited"


def limit(name: str) -> str:
    """A limit of this process as `/etc/security/limits.conf` names and counts it: `rtprio`, or `memlock` [KiB]."""
    kind, unit = {"rtprio": (resource.RLIMIT_RTPRIO, 1), "memlock": (resource.RLIMIT_MEMLOCK, 1024)}[name]
    value = resource.getrlimit(kind)[0]
    return "unlimited" if value == resource.RLIM_INFINITY else str(value // unit)


def request_memory() -> str:
    """Lock this process's memory; returns why that is refused, or nothing.

    Pages are locked as they come in: to bring in all that is mapped, every library whole and every thread's stack,
    would take hundreds of megabytes that no tick touches.
    """
    refusal = memory_refusal()
    if refusal:
        return refusal
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        return os.strerror(ctypes.get_errno())
    return ""


def _status(field: str) -> str:
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        name, _, value = line.partition(":")
        if name == field:
            return value.strip()
    return ""


def freeze_garbage() -> None:
    """Collect once and keep the collector from looking at what is loaded.

    A full collection with numba and scipy loaded pauses for several ticks; nothing on the path of a tick makes cycles.
    """
    gc.collect()
    gc.freeze()
    gc.disable()


def collect_garbage() -> None:
    """Collect what the last trial left; for moments when no tick waits."""
    gc.collect()
