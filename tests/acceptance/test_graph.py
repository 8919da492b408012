"""Through the real graph, in lockstep: noise with assistance inverts the pendulum, seed after seed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from whole_graph import run_composed  # noqa: F401

from rig_study.recorded import load
from shared_control import measures

#: `bench/lockstep.py --seeds 10` runs all of the ten; these are the ones that the suite has time for.
SEEDS = (101, 102)


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_with_assistance_is_inverted(
    single_graph: Any,
    run_composed: Callable[..., Path],  # noqa: F811
    seed: int,
) -> None:
    trial = load(run_composed(single_graph, f"seed{seed}", duration=30.0, seed=seed))
    assert trial.ticks_recorded == trial.decisions_recorded == 3000
    assert measures.cart_pendulum(trial.states, trial.sample_time).success
