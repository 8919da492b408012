"""What it costs to record the whole graph at 100 Hz, and whether anything is lost: processor time of the recorder's
process, from /proc, between the trial's begin and its end; then the bag is verified. Beside it, what the loop itself
missed, and a C loop at the same rate.

    RIG_REALTIME=auto ./rig run python bench/recording.py --minutes 10
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from jitter import nanosleep_beside
from live import in_own_domain
from native import program
from rows import BenchError

from rig_bag.mcap_scan import scan
from rig_bag.reader import info
from rig_bag.verify import verify
from rig_study.recorded import load as recorded

_PERIOD = 0.01
_TICK = os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Print a table; 1 if anything was lost or the bag is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--scenario", default="cart_pendulum_noise_assistance")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [sys.executable, "-m", "rig_bringup", "up", arguments.scenario, "--no-report", "--out", str(out)]
        command += ["--duration", str(60.0 * arguments.minutes)]
        load = os.getloadavg()[0]
        with (
            program("wake") as wake,
            nanosleep_beside(wake, _PERIOD) as wakes,
            subprocess.Popen(command, env=in_own_domain(), stdout=subprocess.PIPE, text=True) as up,
        ):
            try:
                shares = _watch(up, out / "bag")
            finally:
                if up.poll() is None:
                    up.send_signal(signal.SIGINT)
        if up.returncode != 0:
            raise BenchError(f"the trial did not run to its end: exit code {up.returncode}")
        return _report(out / "bag", shares, wakes.late, load)


def _watch(up: subprocess.Popen[str], bag: Path) -> list[tuple[float, float]]:
    """(wall time, processor time) of the recorder's process [s], once a second while it records."""
    samples: list[tuple[float, float]] = []
    recorder: int | None = None
    while up.poll() is None:
        if recorder is None and bag.exists():
            recorder = next((pid for pid in _descendants(up.pid) if "rig_bag" in _command(pid)), None)
        if recorder is not None:
            try:
                samples.append((time.monotonic(), _processor_time(recorder)))
            except OSError:
                # It has ended; the trial's own end follows.
                recorder = -1
        time.sleep(1.0)
        if recorder == -1:
            up.wait()
    if len(samples) < 5:
        raise BenchError("no process of the recorder was found")
    return samples


def _descendants(pid: int) -> Iterator[int]:
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            yield int(child)
            yield from _descendants(int(child))


def _command(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")


def _processor_time(pid: int) -> float:
    """User and system time [s] of all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def _report(bag: Path, samples: list[tuple[float, float]], late: list[float], load: float) -> int:
    found = verify(bag)
    # Start and end of the process are not recording; the first samples still hold imports and matching.
    (begin, used), (end, used_then) = samples[3], samples[-2]
    share = (used_then - used) / (end - begin)
    metadata = info(bag).metadata
    account = dict(scan(info(bag).files()[-1]).metadata)["completeness"]
    missing = sum(entry["missing"] for entry in found.ticks.values())
    size = info(bag).size / 1e6
    print(f"recorded      {metadata.duration * 1e-9:.1f} s, {metadata.messages} messages, {size:.1f} MB")
    print(f"recorder      {100.0 * share:.2f} % of a core over {end - begin:.0f} s (wanted: at most 3 %)")
    print(f"lost          {missing} ticks missing, {account['lost']} lost by the recorder's account (wanted: 0)")
    trial = recorded(bag).trial
    over = sum(lateness > _PERIOD for lateness in late)
    deadlines = f"{trial.missed_deadlines} of {trial.ticks_published} missed (wanted: 0)"
    print(f"deadlines     {deadlines}; a C loop beside it: {over} of {len(late)}")
    print(f"verify        {'ok' if found.ok else 'NOT ok'}")
    print(f"scheduling    {metadata.custom_data['scheduling']}")
    print(f"load          {load:.1f} before, {os.getloadavg()[0]:.1f} after")
    if not found.ok:
        print(found.text())
    return int(not found.ok or missing > 0)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
