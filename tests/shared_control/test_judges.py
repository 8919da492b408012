"""What else may judge an action, for comparison: chance, agreement with the controller, a predictive safety filter."""

from __future__ import annotations

import math

import numpy as np

from shared_control import tasks
from shared_control.filter import FilterConfig, MigFilter, Verdict

TASK = tasks.get("cart_pendulum")
#: Falling to the right: the cart must go right to catch it.
X = np.array([0.3, 0.5, 0.0, 0.0])
GOOD, BAD = np.array([5.0]), np.array([-5.0])


def make(mode="assistance", **values):
    return MigFilter(TASK, FilterConfig(mode=mode, horizon=0.5, **values))


def test_random_baseline_begins_as_after_a_reset():
    def verdicts(filter_):
        return [filter_.decide(X, GOOD).verdict for _ in range(50)]

    fresh, reset = (make("training", judge="random") for _ in range(2))
    begun = verdicts(fresh)
    assert verdicts(reset) == begun
    reset.reset()
    assert verdicts(reset) == begun
    reset.reset(1)
    assert verdicts(reset) != begun


def test_random_baseline_rejects_at_its_rate_and_repeats():
    filter_ = make("training", judge="random", rejection_rate=0.3)
    filter_.reset(4)
    verdicts = [filter_.decide(X, GOOD).verdict for _ in range(3000)]
    assert abs(np.mean(verdicts) - 0.3) < 4.0 * math.sqrt(0.21 / 3000)
    filter_.reset(4)
    assert verdicts == [filter_.decide(X, GOOD).verdict for _ in range(3000)]
    filter_.reset(5)
    assert verdicts != [filter_.decide(X, GOOD).verdict for _ in range(3000)]


def test_agreement_baseline():
    """Accepts what has a positive inner product with the controller's, and replaces by it otherwise."""
    decision = make(judge="agreement").decide(X, BAD)
    controls = make(judge="agreement").decide(X, GOOD)
    assert decision.verdict == Verdict.REPLACED
    assert controls.verdict == Verdict.ACCEPTED
    assert decision.criterion == -float(BAD @ decision.applied_control) > 0.0
    assert decision.applied_control == make().decide(X, BAD).applied_control


def test_predictive_baseline_stops_what_could_not_be_made_good():
    """A cart that can still brake before the end of its track may be pushed towards it; one that cannot may not."""
    task = tasks.get("cart_pendulum", track=1.0)
    filter_ = MigFilter(task, FilterConfig(horizon=0.5, judge="predictive", state_weights=(0.0, 0.0, 200.0, 1.0)))
    push = np.array([20.0])
    # At 1 m/s and 20 m/s^2 it takes 2.5 cm to stop, and the push adds what it moves in a sample and what that costs.
    can, cannot = (np.array([math.pi, 0.0, x, 1.0]) for x in (0.90, 0.98))
    decision = filter_.decide(can, push)
    assert (decision.verdict, decision.criterion) == (Verdict.ACCEPTED, -1.0)
    decision = filter_.decide(cannot, push)
    assert (decision.verdict, decision.criterion) == (Verdict.REPLACED, 1.0)
    assert decision.applied_control[0] < 0.0
    # Of a horizon of one sample the end counts too: it fails there, and not yet after the user's sample.
    config = FilterConfig(horizon=0.01, judge="predictive", state_weights=(0.0, 0.0, 200.0, 1.0))
    at_the_end = MigFilter(task, config).decide(np.array([math.pi, 0.0, 0.985, 1.0]), push)
    assert (at_the_end.verdict, at_the_end.criterion) == (Verdict.REPLACED, 1.0)
    endless = MigFilter(TASK, FilterConfig(horizon=0.5, judge="predictive"))
    assert endless.decide(cannot, push).verdict == Verdict.ACCEPTED
