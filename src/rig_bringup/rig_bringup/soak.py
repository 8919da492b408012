"""`./rig soak`: the graph for hours, and whether it is at the end as it was at the beginning.

Memory, file descriptors and threads of each process are read from /proc while the trial runs; latencies and losses from
the bag when it is closed; files that stay behind in shared memory when all has ended.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rig_bringup import up
from rig_bringup.graph_process import GraphProcess

#: [s] After this long all is loaded and every buffer has its size; windows of this length are compared.
_SETTLED = 300.0

#: What is allowed: growth of a process [MB], of the latency's 99th percentile [share].
_MEMORY, _LATENCY = 1.0, 0.10

_SHARED_MEMORY = Path("/dev/shm")


class Use(NamedTuple):
    """What a process uses at a moment."""

    at: float  # [s] since the first sample
    memory: float  # [MB] resident
    files: int
    threads: int


class Samples:
    """What every process of a graph uses, from time to time."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._begin = self._next = time.monotonic()
        self.uses: dict[str, list[Use]] = defaultdict(list)
        self.shared_memory: set[Path] = set()

    def take(self, graph: GraphProcess) -> None:
        """To be called often; looks once in a period."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + self._period
        for pid in graph.left():
            process = Path("/proc") / str(pid)
            try:
                name, use = _look(process, now - self._begin)
                self.shared_memory |= _mapped(process)
            except (OSError, ValueError):
                continue  # it has just ended
            if name:
                self.uses[name].append(use)


def _look(process: Path, at: float) -> tuple[str, Use]:
    words = (process / "cmdline").read_bytes().split(b"\0")
    # The interpreter runs `lib/PACKAGE/EXECUTABLE`; whatever else is there (the script, `ros2 run`) does no work.
    scripts = [Path(word.decode()) for word in words[:3]]
    name = next((path.name for path in scripts if path.parent.parent.name == "lib"), "")
    status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines() if ":" in line)
    memory = int(status["VmRSS"].split()[0]) / 1000.0
    return name, Use(at, memory, sum(1 for _ in (process / "fd").iterdir()), int(status["Threads"]))


def _mapped(process: Path) -> set[Path]:
    """Files in shared memory that the process uses: its own graph's, whatever else runs on the machine."""
    paths = (line.split(maxsplit=5)[5:] for line in (process / "maps").read_text().splitlines())
    return {Path(path[0]) for path in paths if path and path[0].startswith(f"{_SHARED_MEMORY}/")}


@dataclass
class Finding:
    """One line of the result: the beginning's value, the end's, and whether the end's is allowed."""

    what: str
    unit: str
    begin: float
    end: float
    allowed: str
    good: bool

    def line(self) -> str:
        """For a person."""
        return (
            f"{self.what:36} {self.begin:12.4g} {self.end:12.4g} {self.unit:6} "
            f"{'ok' if self.good else 'NOT ALLOWED':12} {self.allowed}"
        )


def of_processes(uses: dict[str, list[Use]], window: float) -> Iterator[Finding]:
    """Compare each process's first window [s] after it has settled with its last one."""
    for name, taken in sorted(uses.items()):
        last = taken[-1].at
        settled = min(_SETTLED, 0.2 * last)
        first = [use for use in taken if settled <= use.at <= settled + window] or taken[:1]
        late = [use for use in taken if use.at >= last - window]
        for field, unit, most in (("memory", "MB", _MEMORY), ("files", "", 0.0), ("threads", "", 0.0)):
            begin, end = (float(np.median([getattr(use, field) for use in part])) for part in (first, late))
            allowed = f"grows by at most {most:g} {unit}".rstrip()
            yield Finding(f"{name}: {field}", unit, begin, end, allowed, end - begin <= most)


def of_latency(time_: np.ndarray, latency: np.ndarray, window: float) -> Iterator[Finding]:
    """Compare state-to-decision times [s] of the first window after the settling with those of the last."""
    settled = min(_SETTLED, 0.2 * float(time_[-1]))
    first = latency[(time_ >= settled) & (time_ <= settled + window)]
    late = latency[time_ >= time_[-1] - window]
    for q, bound in ((50, None), (99, _LATENCY)):
        begin, end = (1e3 * float(np.percentile(part, q)) for part in (first, late))
        good = bound is None or end <= (1.0 + bound) * begin
        yield Finding(
            f"state to decision, p{q}", "ms", begin, end, f"grows by at most {bound:.0%}" if bound else "", good
        )


def of_bag(bag: Path, window: float) -> Iterator[Finding]:
    """Latency, and what is missing."""
    from rig_bag.verify import verify
    from rig_study.recorded import load

    trial = load(bag)
    yield from of_latency(trial.time, trial.state_age + trial.compute_time, window)
    for group, entry in verify(bag).ticks.items():
        missing = entry["missing"] or 0
        yield Finding(f"missing: {group.rpartition('/')[2]}", "", 0.0, missing, "none", missing == 0)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser("rig soak", description=__doc__)
    result.add_argument("scenario", nargs="?", help="name or file (default: as ./rig up)")
    result.add_argument("--hours", type=float, default=1.0, help="how long (%(default)s)")
    result.add_argument("--compose", action="store_true", help="all nodes in one process")
    result.add_argument("--out", type=Path, metavar="DIR", help="folder of the run (default: a new one under runs/)")
    return result


def main(argv: Sequence[str]) -> int:
    """0 if all is as it was, 1 if something grew, was lost or stayed behind, 2 for bad input."""
    arguments = parser()
    options = arguments.parse_args(argv)
    if not 0.0 < options.hours <= 24.0:
        arguments.error(f"--hours {options.hours:g}: must be more than 0 and at most 24")
    out = options.out or Path.cwd() / "runs" / f"soak_{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}"
    seconds = 3600.0 * options.hours
    samples = Samples(period=min(10.0, seconds / 50.0))
    there = set(_SHARED_MEMORY.iterdir())
    command = ["--pacing", "realtime", "--duration", f"{seconds:.2f}", "--no-report", "--out", str(out)]
    command += ["--compose"] * options.compose + ([options.scenario] if options.scenario else [])
    code = up.main(command, sampler=samples.take)
    if code:
        return code
    window = min(_SETTLED, 0.2 * seconds)
    findings = [*of_processes(samples.uses, window), *of_bag(out / "bag", window)]
    left = [path for path in samples.shared_memory - there if path.exists()]
    findings.append(Finding("left in shared memory", "files", 0.0, len(left), "none", not left))
    print(f"\n{'after settling, and at the end':36} {'':>12} {'':>12}")
    for finding in findings:
        print(finding.line())
    _write(out / "soak.json", samples, findings)
    bad = sum(not finding.good for finding in findings)
    print(f"{len(findings) - bad} of {len(findings)} are as they must be; all samples: {out / 'soak.json'}")
    return 1 if bad else 0


def _write(path: Path, samples: Samples, findings: list[Finding]) -> None:
    content: dict[str, Any] = {
        "findings": [vars(finding) for finding in findings],
        "processes": {name: [use._asdict() for use in uses] for name, uses in samples.uses.items()},
    }
    path.write_text(json.dumps(content, indent=1) + "\n")
