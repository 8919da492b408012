"""The claims of docs/results.md: every one can be run, and its line says what its trials gave."""

from __future__ import annotations

import re

import numpy as np
import pytest

from shared_control import reproduce
from shared_control.reproduce import CLAIMS, FIRST_SEED, GRADED, Claim, measure
from shared_control.scenario import load
from shared_control.trial import run_trials


@pytest.mark.parametrize("name", [name for name, claim in CLAIMS.items() if claim is not GRADED])
def test_a_claims_scenario_holds_its_changes(name):
    claim = CLAIMS[name]
    loaded = load(reproduce.scenario(claim))
    sections = {"": loaded.loop, "mig_filter": loaded.filter, "user_sim": loaded.user, "task_sim": loaded.task}
    for node, values in claim.changes.items():
        for key, value in values.items():
            found = getattr(sections[node], key)
            assert (list(found) if isinstance(found, tuple) else found) == value
    assert claim.seeds >= 1
    assert claim.wanted


def test_a_claim_changes_no_other():
    before = load(reproduce.scenario(CLAIMS["cart/noise/training"]))
    reproduce.scenario(CLAIMS["cart/laboratory/user/sd 5"])
    assert load(reproduce.scenario(CLAIMS["cart/noise/training"])) == before


def test_the_carts_line_is_its_trials():
    claim = Claim("cart_pendulum_noise_assistance", {"": {"duration": 0.5}}, 5, "nothing")
    results = run_trials(reproduce.scenario(claim), range(FIRST_SEED, FIRST_SEED + 3), workers=1)
    line = measure(claim, seeds=3, workers=1)
    assert line.startswith("0 of 3 inverted, 0 upright at the end; PRA ")
    assert f"PRA {np.mean([result.measures.pra for result in results]):.3f}" in line
    excursions = [result.measures.cart_excursion for result in results]
    assert f"cart p50 {np.median(excursions):.1f}" in line
    assert line.endswith("time to success p50 0.5, most 0.5 s")
    assert measure(claim, workers=1).startswith("0 of 5 ")


def test_a_runners_line_is_its_trials():
    line = measure(Claim("slip_skilled_off", {"": {"duration": 0.5}}, 2, "nothing"), workers=1)
    assert re.fullmatch(
        r"0 of 2 fell \(quartiles 0.5, 0.5, 0.5 s\); override 0.000; -?[\d.]+ m/s, RMSE [\d.]+ m/s, r -?[\d.]+", line
    )
    noise = measure(Claim("slip_noise_off", {"": {"duration": 0.2}}, 2, "nothing"), workers=1)
    assert "RMSE" not in noise


def test_users_are_compared_alone_with_what_the_filter_would_say(monkeypatch):
    monkeypatch.setattr(reproduce, "_GRADES", [(skill, 0.0, 2.0) for skill in (0.0, 1.0)])
    line = measure(GRADED, seeds=1, workers=1)
    said = re.fullmatch(r"Spearman -1.00 over 2 users; success alone 0.00 to 1.00, PRA ([\d.]+) to ([\d.]+)", line)
    assert float(said[1]) < 0.2
    assert 0.4 < float(said[2]) < 0.6
