"""What diagnostics say of a node's last ticks."""

from __future__ import annotations

import time

import pytest

from rig_runtime.stages import KEPT, StageTimes, delay_of


def test_a_delay_counts_from_the_stamp() -> None:
    assert delay_of(time.time_ns() - 2_000_000_000) == pytest.approx(2.0, abs=1.0)
    assert delay_of(time.time_ns() + 2_000_000_000) == pytest.approx(-2.0, abs=1.0)


def test_the_spread_of_the_last_ticks() -> None:
    stage = StageTimes()
    assert stage.values() == {}
    for k in range(KEPT + 50):
        stage.add(1e-3 * k, 1e-6 * k)
    assert stage.values() == {
        "begins after due [ms]": "p50 100.000, p90 139.000, p99 148.000, most 149.000, of 100 ticks",
        "takes [ms]": "p50 0.100, p90 0.139, p99 0.148, most 0.149, of 100 ticks",
    }
    stage.reset()
    assert stage.values() == {}
