"""Through the real graph, in lockstep: noise with assistance inverts the pendulum, seed after seed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from whole_graph import run_composed  # noqa: F401

from rig_study.recorded import load
from shared_control import measures

#: `bench/lockstep.py --seeds 10` runs all of the ten; these are the ones that the suite has time for.
SEEDS = (101, 102)

#: [s] Nearly twice what the slowest of 200 other seeds took to succeed; the bench runs the paper's 30 s.
DURATION = 15.0


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_with_assistance_is_inverted(
    run_composed: Callable[..., Path],  # noqa: F811
    seed: int,
) -> None:
    trial = load(run_composed(f"seed{seed}", duration=DURATION, seed=seed))
    assert trial.ticks_recorded == trial.decisions_recorded == round(DURATION / trial.sample_time)
    assert measures.cart_pendulum(trial.states, trial.sample_time).success
