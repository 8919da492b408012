"""The paper's claim for the cart-pendulum, as shipped: filtered noise inverts it."""

from __future__ import annotations

import numpy as np

from shared_control.cost import wrap
from shared_control.trial import run_trials

#: Not used while tuning.
SEEDS = range(910_000, 910_012)


def test_noise_with_assistance_inverts():
    results = run_trials("cart_pendulum_noise_assistance", SEEDS, workers=2)
    assert all(result.measures.success for result in results)
    assert all(abs(wrap(result.states[-1, 0])) <= 0.4 for result in results)
    assert abs(np.mean([result.measures.pra_trial for result in results]) - 0.5) <= 0.02
    assert max(result.measures.cart_excursion for result in results) <= 15.0


def test_noise_alone_does_not():
    assert not any(result.measures.success for result in run_trials("cart_pendulum_noise_off", SEEDS[:10], workers=2))
