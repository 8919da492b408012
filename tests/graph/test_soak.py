"""`./rig soak`: what it finds in made-up samples, and a short one over the real graph."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from rig_bringup.soak import Use, of_latency, of_processes


def grown(by: float) -> dict[str, bool]:
    uses = [Use(float(at), 100.0 + by * (at > 3000), 20, 8) for at in range(0, 3600, 10)]
    return {finding.what: finding.good for finding in of_processes({"node": uses}, 300.0)}


def test_memory_may_grow_by_a_megabyte_after_it_has_settled() -> None:
    assert all(grown(0.9).values())
    assert grown(1.1) == {"node: memory": False, "node: files": True, "node: threads": True}
    # What a process takes while it settles is its own affair.
    early = [Use(float(at), 50.0 if at < 200 else 100.0, 20, 8) for at in range(0, 3600, 10)]
    assert all(finding.good for finding in of_processes({"node": early}, 300.0))


def test_files_and_threads_may_not_grow() -> None:
    uses = [Use(float(at), 100.0, 20 + (at > 3000), 8 + (at > 3000)) for at in range(0, 3600, 10)]
    assert [f.good for f in of_processes({"node": uses}, 300.0)] == [True, False, False]


def test_latency_may_drift_by_a_tenth() -> None:
    time = np.arange(0.0, 3600.0, 0.01)
    latency = 1e-3 + 1e-4 * np.random.default_rng(3).random(len(time))
    for factor, good in ((1.0, True), (1.05, True), (1.2, False)):
        drifted = np.where(time > 3200.0, factor, 1.0) * latency
        assert [finding.good for finding in of_latency(time, drifted, 300.0)] == [True, good]


def test_a_short_soak_of_the_real_graph(tmp_path: Path) -> None:
    out = tmp_path / "soak"
    command = [sys.executable, "-m", "rig_bringup", "soak", "--hours", "0.002", "--compose", "--out", str(out)]
    surroundings = {**os.environ, "ROS_DOMAIN_ID": str(62 + os.getpid() % 30)}
    done = subprocess.run(command, env=surroundings, capture_output=True, text=True, timeout=300, check=False)
    # Whether something grows in seven seconds says nothing; that it was looked at does.
    assert done.returncode in (0, 1), done.stdout + done.stderr
    written = json.loads((out / "soak.json").read_text())
    assert set(written["processes"]) == {"compose"}
    found = {finding["what"]: finding for finding in written["findings"]}
    assert found["compose: memory"]["end"] > 10.0
    assert found["state to decision, p99"]["end"] > 0.0
    assert found["missing: decision"]["good"]
    assert found["left in shared memory"]["good"], done.stdout
