"""Where the time of a tick goes: the composed graph in lockstep, sampled by py-spy and summed by kind.

    .venv/bin/pip install py-spy
    ./rig run python bench/hot_path.py [--seconds 1000] [--record]

What compiled code does counts for the line of Python that calls it. Needs the right to look into a process (root, or
`kernel.yama.ptrace_scope` 0).
"""

from __future__ import annotations

import argparse
import collections
import linecache
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from loop import timed_trial
from machine import describe
from rows import BenchError

_RATE = 400  # [1/s]
_LEAF = re.compile(r"(?P<function>.*) \((?P<file>.*):(?P<line>\d+)\)")

#: By what the path of the file says; the first that fits.
_PLACES = (
    (r"rig_bag/", "recorder"),
    (r"rig_runtime/(wire|ticks)\.py", "numbers in and out of the bytes, ticks"),
    (r"shared_control/|numpy/|<string>|/enum\.py", "Python around the kernels in shared_control"),
    (r"_node/", "the nodes' callbacks"),
    (r"/bench/", "the benchmark's own clock"),
)
_REST = "reports, diagnostics, rclpy"


def kind(stack: str) -> str:
    """What a sample counts for."""
    leaf = _LEAF.fullmatch(stack.rpartition(";")[2])
    if leaf is None:
        return _REST
    if leaf["function"].endswith("call") and leaf["file"].endswith("shared_control/dispatch.py"):
        which = "search" if "_search (" in stack else "criterion" if "/mig.py:" in stack else "the task's step"
        return f"kernels: {which}"
    if leaf["function"].endswith(("serve", "spin_until_future_complete")):
        return "executor and taking, in the middleware"
    if re.search(r"\b_?send|publish\(", linecache.getline(leaf["file"], int(leaf["line"]))):
        return "publishing, in the middleware"
    return next((name for pattern, name in _PLACES if re.search(pattern, leaf["file"])), _REST)


def sample(seconds: float, record: bool) -> collections.Counter[str]:
    """Samples by kind, of the time in which the executor serves.

    Raises
    ------
    BenchError: py-spy is not there, or refused.
    """
    spy = shutil.which("py-spy")
    if spy is None:
        raise BenchError("py-spy is not installed: .venv/bin/pip install py-spy")
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "raw"
        command = [spy, "record", "--rate", str(_RATE), "--full-filenames", "--format", "raw", "--output", str(raw)]
        command += ["--", sys.executable, __file__, "--trial", "--seconds", str(seconds), *["--record"] * record]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0 or not raw.exists():
            raise BenchError(f"py-spy failed: {result.stderr.strip()[-500:]}")
        found: collections.Counter[str] = collections.Counter()
        for line in raw.read_text(encoding="utf-8").splitlines():
            stack, _, count = line.rpartition(" ")
            # The main thread, once nodes are there and until they are not.
            if " (" in stack and "serve (" in stack:
                found[kind(stack)] += int(count)
        return found


def main() -> int:
    """Sample and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=1000.0, help="of trial, not of wall time (%(default)s)")
    parser.add_argument("--record", action="store_true", help="with the recorder in the process")
    parser.add_argument("--trial", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.trial:
        timed_trial(pacing="lockstep", duration=options.seconds, record=options.record)
        return 0
    try:
        found = sample(options.seconds, options.record)
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    total = found.total()
    for name, count in found.most_common():
        print(f"{100 * count / total:5.1f} %  {name}")
    print(f"{total} samples; commit {describe()['commit']}; load {os.getloadavg()[0]:.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
