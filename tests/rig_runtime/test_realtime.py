"""Real-time settings: what the environment may say, and that what is reported is what the kernel has.

Settings are applied in processes of their own, which do nothing else and end at once.
"""

from __future__ import annotations

import errno
import os
import subprocess
import sys

import pytest

from rig_bringup.provision import doctor
from rig_bringup.up import scheduling
from rig_runtime import realtime
from rig_runtime.realtime import RealtimeError, Settings, memory_refusal, release_fifo, request_fifo

#: Settings in a process that has imported what it needs and may then have lost every privilege.
_APPLY = """
import _thread, os, resource, sys, threading
from rig_runtime.realtime import Realtime, RealtimeError, Settings
if sys.argv[1] == "unprivileged":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
    if os.getuid() == 0:
        os.setgroups([])
        os.setuid(65534)
# Python knows of it, or, as of those that a library in C++ starts, does not.
class Thread:
    def __init__(self, known=True, name="dds.shm.7000"):
        ready, stay = threading.Event(), threading.Event()
        def work():
            self.native_id = threading.get_native_id()
            with open(f"/proc/self/task/{self.native_id}/comm", "w") as comm:
                comm.write(name)
            ready.set()
            stay.wait()
        threading.Thread(target=work, daemon=True).start() if known else _thread.start_new_thread(work, ())
        ready.wait()
    def priority(self):
        thread = self.native_id
        return os.sched_getparam(thread).sched_priority if os.sched_getscheduler(thread) == os.SCHED_FIFO else 0
try:
    realtime = Realtime(Settings.from_environment(alone="alone" in sys.argv))
    library = Thread(known=False)
    realtime.before_middleware()
    middleware, own, page = Thread(known=False), Thread(), Thread()
    sending = Thread(known=False, name="dds.asyn.0.0")
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    realtime.before_ticks(below=[page])
    later = Thread()
except RealtimeError as error:
    sys.exit(str(error))
locked = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmLck"))
print(os.sched_getscheduler(0) == os.SCHED_FIFO, locked > 0, len(realtime.refused), sep="|")
print(sorted(os.sched_getaffinity(0)))
print(realtime.describe())
print(*(thread.priority() for thread in (library, middleware, own, page, sending, later)))
"""


def apply(privilege: str, *more: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", _APPLY, privilege, *more],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_without_a_word_nothing_is_asked_for() -> None:
    assert Settings.from_environment({}) == Settings("off", frozenset())
    fifo, rest = apply("as started", RIG_REALTIME="").stdout.split("|", 1)
    assert fifo == "False"
    assert rest.startswith("False|0")
    assert "ordinary scheduling, memory not locked, garbage collector frozen" in rest


def test_what_is_permitted_is_granted_and_reported() -> None:
    may_schedule = not request_fifo()
    release_fifo()
    may_lock = not memory_refusal()
    result = apply("as started", RIG_REALTIME="auto")
    held, _, said, threads = result.stdout.splitlines()
    refused = (not may_schedule) + (not may_lock)
    assert held == f"{may_schedule}|{may_lock}|{refused}"
    assert ("SCHED_FIFO 20" in said) is may_schedule
    assert ("memory locked" in said) is may_lock
    assert threads == ("0 20 0 19 19 20" if may_schedule else "0 0 0 0 0 0")
    assert result.stderr.count("./rig doctor") == refused
    assert (apply("as started", RIG_REALTIME="require").returncode == 0) is (refused == 0)


def test_what_is_refused_is_reported_and_stops_nothing() -> None:
    result = apply("unprivileged", RIG_REALTIME="auto")
    held, _, said, threads = result.stdout.splitlines()
    assert held == "False|False|2"
    assert threads == "0 0 0 0 0 0"
    assert "no SCHED_FIFO" in said
    assert "no locked memory: limit memlock 64, wanted unlimited" in said
    assert result.stderr.count("./rig doctor says how to allow it") == 2


def test_what_is_refused_is_an_error_if_required() -> None:
    result = apply("unprivileged", RIG_REALTIME="require")
    assert result.returncode != 0
    assert result.stderr.startswith("RIG_REALTIME=require, but no SCHED_FIFO: ")


def test_limits_are_counted_as_limits_conf_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda kind: (65536, 65536))
    assert realtime.limit("memlock") == "64"
    assert realtime.limit("rtprio") == "65536"
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda kind: 2 * (realtime.resource.RLIM_INFINITY,))
    assert realtime.limit("memlock") == realtime.limit("rtprio") == "unlimited"


def test_a_kernel_that_refuses_is_quoted(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(realtime.os, "sched_setscheduler", refuse)
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda kind: (0, 0))
    process = realtime.Realtime(Settings("auto"))
    process.before_middleware()
    refusal = "no SCHED_FIFO: Operation not permitted (limit rtprio 0, wanted 20)"
    assert process.refused == [refusal]
    assert process.describe().endswith(f"; {refusal}")
    assert capsys.readouterr().err == f"rig_runtime: {refusal}; ./rig doctor says how to allow it\n"
    with pytest.raises(RealtimeError, match="RIG_REALTIME=require, but no SCHED_FIFO"):
        realtime.Realtime(Settings("require")).before_middleware()


def test_memory_that_may_not_be_locked_is_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "_status", lambda _: "0000000000000000")
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda _: (64 * 1024, 64 * 1024))
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *_, **__: pytest.fail("it was asked for"))
    assert realtime.request_memory() == "limit memlock 64, wanted unlimited"


def test_a_kernel_that_locks_no_memory_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    class Libc:
        def mlockall(self, _: int) -> int:
            return -1

    monkeypatch.setattr(realtime, "memory_refusal", str)
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *_, **__: Libc())
    monkeypatch.setattr(realtime.ctypes, "get_errno", lambda: errno.EPERM)
    assert realtime.request_memory() == "Operation not permitted"


def test_a_kernel_that_says_nothing_of_privileges_gives_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert realtime._status("NoSuchField") == ""
    monkeypatch.setattr(realtime, "_status", lambda _: "")
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda _: (realtime.resource.RLIM_INFINITY,) * 2)
    assert memory_refusal() == ""


def test_processors_are_chosen() -> None:
    one = max(os.sched_getaffinity(0))
    assert apply("as started", RIG_REALTIME="off", RIG_CPUS=str(one)).stdout.splitlines()[1] == f"[{one}]"


def test_processors_may_be_written_as_ranges() -> None:
    usable = sorted(os.sched_getaffinity(0))
    for text in (",".join(map(str, usable)), f"{usable[0]}-{usable[0]}"):
        assert Settings.from_environment({"RIG_CPUS": text}).cpus <= set(usable)


def test_a_graph_in_one_process_keeps_to_one_processor_where_it_has_real_time() -> None:
    usable = sorted(os.sched_getaffinity(0))
    granted = not request_fifo()
    release_fifo()
    held = apply("as started", "alone", RIG_REALTIME="auto", RIG_CPUS="").stdout.splitlines()[1]
    assert held in ([f"[{cpu}]" for cpu in usable] if granted else [str(usable)])
    # Where the kernel refuses it, it is kept nowhere: what else runs there would hold it up.
    assert apply("unprivileged", "alone", RIG_REALTIME="auto", RIG_CPUS="").stdout.splitlines()[1] == str(usable)
    assert apply("as started", "alone", RIG_REALTIME="off", RIG_CPUS="").stdout.splitlines()[1] == str(usable)
    assert apply("as started", "alone", RIG_REALTIME="auto", RIG_CPUS="all").stdout.splitlines()[1] == str(usable)
    assert apply("as started", RIG_REALTIME="auto", RIG_CPUS="").stdout.splitlines()[1] == str(usable)
    assert len(Settings.from_environment({"RIG_CPUS": "one"}).cpus) == 1


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("RIG_REALTIME", "on", "one of off, auto, require"),
        ("RIG_CPUS", "first", "write them as 0,2-3, or all, or one"),
        ("RIG_CPUS", "100000", "not all of these are usable here"),
    ],
)
def test_a_setting_that_cannot_be_is_one_sentence(variable: str, value: str, words: str) -> None:
    with pytest.raises(RealtimeError, match=rf"{variable}={value}.*{words}"):
        Settings.from_environment({variable: value})


def test_a_graph_asks_for_real_time_only_if_wall_time_paces_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RIG_REALTIME")
    assert scheduling("realtime") == {"RIG_REALTIME": "auto"}
    monkeypatch.setenv("RIG_REALTIME", "require")
    assert scheduling("realtime") == {"RIG_REALTIME": "require"}
    assert scheduling("lockstep") == {"RIG_REALTIME": "off"}


def test_the_doctor_says_how_to_allow_what_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.realtime, "request_fifo", lambda: "Operation not permitted")
    monkeypatch.setattr(doctor.realtime, "memory_refusal", lambda: "limit memlock 64, wanted unlimited")
    for finding, line in ((doctor.scheduling(), "rtprio 21"), (doctor.memory_lock(), "memlock unlimited")):
        assert not finding.ok
        assert f'echo "$USER - {line}" | sudo tee -a /etc/security/limits.conf' in finding.remedy
