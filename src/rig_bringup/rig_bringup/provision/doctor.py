"""`./rig doctor`: what this machine has, what it lacks, what to do. Needs nothing installed and changes nothing."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

from rig_bringup.provision.machine import Finding, needed_to_build
from rig_bringup.provision.steps import Places
from rig_runtime import realtime


def main() -> int:
    """Print one line a finding; exit code 1 if something needed is missing."""
    places = Places(Path(sys.argv[1]).resolve())
    needed = needed_to_build(places.root)
    for finding in [*needed, *_of_the_running_rig(places)]:
        mark = "ok     " if finding.ok else "MISSING" if finding in needed else "note   "
        print(f"{mark} {finding.name:22} {finding.found}")
        if finding.remedy and not finding.ok:
            print(f"{'':8}{'':22} -> {finding.remedy}")
    return 0 if all(finding.ok for finding in needed) else 1


def _of_the_running_rig(places: Places) -> list[Finding]:
    return [
        _set_up(places),
        _middleware(places),
        scheduling(),
        memory_lock(),
        _shared_memory(),
        _discovery(),
        _processors(),
    ]


def _set_up(places: Places) -> Finding:
    done = (places.state / "environment.sh").exists() and places.python.exists()
    return Finding("set-up", done, "done" if done else "not done yet", "./rig up does it on first use")


def _middleware(places: Places) -> Finding:
    chosen = os.environ.get("RMW_IMPLEMENTATION", "")
    if chosen not in ("", "rmw_fastrtps_cpp"):
        return Finding("middleware", False, f"RMW_IMPLEMENTATION={chosen}", "the rig is tested with rmw_fastrtps_cpp")
    return Finding("middleware", True, "rmw_fastrtps_cpp" + ("" if chosen else " (the default)"))


def scheduling() -> Finding:
    """Whether nodes paced by wall time may run before everything else."""
    refusal = realtime.request_fifo()
    if not refusal:
        realtime.release_fifo()
        found = f"SCHED_FIFO {realtime.PRIORITY} is permitted (limit rtprio {realtime.limit('rtprio')})"
        return Finding("real-time scheduling", True, found)
    remedy = f"for fewer late ticks, allow it: {_limit(f'rtprio {realtime.ALLOWED}')}"
    return Finding("real-time scheduling", False, f"SCHED_FIFO: {refusal}", remedy)


def memory_lock() -> Finding:
    """Whether nodes paced by wall time may keep their memory from being paged out."""
    refusal = realtime.memory_refusal()
    remedy = f"allow it: {_limit('memlock unlimited')}"
    found = refusal or f"permitted (limit memlock {realtime.limit('memlock')})"
    return Finding("memory lock", not refusal, found, remedy)


def _limit(what: str) -> str:
    return f'echo "$USER - {what}" | sudo tee -a /etc/security/limits.conf, then log in again; no root needed after'


def _shared_memory() -> Finding:
    path = Path("/dev/shm")
    if not path.is_dir():
        return Finding("shared memory", False, "no /dev/shm", "mount a tmpfs there: same-host transport uses it")
    free = shutil.disk_usage(path).free / 1e6
    left = len(list(path.glob("fastrtps_*")))
    found = f"{free:.0f} MB free in /dev/shm, {left} segments of Fast DDS"
    remedy = "when no ROS process runs, remove what killed ones left: rm /dev/shm/fastrtps_*"
    return Finding("shared memory", free > 64 and left < 500, found, remedy)


def _discovery() -> Finding:
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    if not reach:
        return Finding("discovery range", True, f"LOCALHOST (the rig's default), domain {domain}")
    return Finding("discovery range", True, f"{reach} (from ROS_AUTOMATIC_DISCOVERY_RANGE), domain {domain}")


def _processors() -> Finding:
    count = len(os.sched_getaffinity(0))
    remedy = "the graph as separate processes wants two or more; try ./rig up --compose"
    return Finding("processors", count >= 2, f"{count} usable", remedy)


if __name__ == "__main__":
    sys.exit(main())
