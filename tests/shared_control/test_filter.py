"""Algorithm 1: verdicts, reasons and what is applied, in every mode."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared_control import controllers, tasks
from shared_control.cost import quadratic
from shared_control.filter import INPUT_FAULTS, FilterConfig, MigFilter, Mode, Reason, Verdict, costs
from shared_control.integrate import Stepper
from shared_control.mig import mig_integral
from shared_control.parameters import ParameterError

TASK = tasks.get("cart_pendulum")
#: Falling to the right: the cart must go right to catch it.
X = np.array([0.3, 0.5, 0.0, 0.0])
GOOD, BAD = np.array([5.0]), np.array([-5.0])
#: Falling so fast that its cost overflows.
SINGULAR = np.array([0.1, 0.0, 0.0, 1.7e308])
#: So far away that its cost overflows, which is a square; its slope does not.
FAR = np.array([0.3, 0.5, 1e160, 0.0])


def make(mode="assistance", **values):
    return MigFilter(TASK, FilterConfig(mode=mode, horizon=0.5, **values))


def test_accepted():
    for mode in ("training", "assistance"):
        decision = make(mode).decide(X, GOOD)
        assert (decision.verdict, decision.reason) == (Verdict.ACCEPTED, Reason.CRITERION)
        assert decision.criterion < 0.0 == decision.threshold
        assert decision.applied_control == GOOD
        assert decision.user_control == GOOD
        assert decision.nominal_control == 0.0
        with pytest.raises(ValueError, match="read-only"):  # it is every decision's
            decision.nominal_control[0] = 1.0
        assert decision.mode == Mode.of(mode)


@pytest.mark.parametrize(
    ("configured", "made"),
    [
        ({}, {"iterations": 3, "tolerance": FilterConfig().controller_tolerance}),
        ({"controller_iterations": 1}, {"iterations": 1}),
        ({"controller_tolerance": 1.0, "controller_iterations": 50}, {"iterations": 50, "tolerance": 1.0}),
        ({"control_limits": (3.0,), "controller_horizon": 0.8}, {"limits": (3.0,), "horizon": 0.8}),
    ],
)
def test_the_controller_is_the_one_that_is_configured(configured, made):
    """At a sample time that is not the default: what it would do at the first tick is what is applied."""
    agent = MigFilter(TASK, FilterConfig(mode="assistance", horizon=0.5, **configured), sample_time=0.02)
    full = {"horizon": 0.5, "limits": FilterConfig().control_limits, "iterations": 3, **made}
    alone = controllers.make("ilqr", TASK, quadratic(TASK), dt=0.02, **full)
    decision = agent.decide(X, BAD)
    assert decision.verdict == Verdict.REPLACED
    assert decision.applied_control == alone.solve(X).control


def test_agreement_is_with_what_the_controller_wants_now():
    agent = make("training", judge="agreement")
    assert agent.decide(X, GOOD).criterion < 0.0
    assert agent.decide(-X, GOOD).criterion > 0.0, "it falls to the other side, and the same push is against the catch"


@pytest.mark.parametrize("along", ["nominal", "user"])
def test_the_adjoint_runs_along_what_is_configured(along):
    readings = {
        read: mig_integral(TASK, quadratic(TASK), X, 20.0 * GOOD, horizon=0.5, dt=0.01, adjoint_along=read)
        for read in ("nominal", "user")
    }
    assert readings["nominal"] != readings["user"]
    assert make(adjoint_along=along).decide(X, 20.0 * GOOD).criterion == readings[along]


def test_rejected_in_training():
    decision = make("training").decide(X, BAD)
    assert (decision.verdict, decision.reason) == (Verdict.REJECTED, Reason.CRITERION)
    assert decision.criterion > 0.0
    assert decision.applied_control == 0.0


def test_replaced_in_assistance():
    decision = make().decide(X, BAD)
    assert (decision.verdict, decision.reason) == (Verdict.REPLACED, Reason.CRITERION)
    assert 0.0 < decision.applied_control[0] <= 20.0


def test_off_accepts_everything_finite():
    decision = make("off").decide(X, BAD)
    assert (decision.verdict, decision.reason) == (Verdict.ACCEPTED, Reason.FILTER_OFF)
    assert math.isnan(decision.criterion)
    assert decision.applied_control == BAD


def test_null_action_and_dead_zone():
    for filter_, u in ((make(), 0.0), (make(dead_zone=6.0), -5.0)):
        decision = filter_.decide(X, np.array([u]))
        assert (decision.verdict, decision.reason) == (Verdict.ACCEPTED, Reason.NULL_ACTION)
        assert decision.applied_control == u
    assert make(dead_zone=4.0).decide(X, BAD).verdict == Verdict.REPLACED


def test_threshold_moves_the_border():
    criterion = make().decide(X, BAD).criterion
    assert make(threshold=criterion).decide(X, BAD).verdict == Verdict.ACCEPTED
    assert make(threshold=math.nextafter(criterion, 0.0)).decide(X, BAD).verdict == Verdict.REPLACED
    assert make(threshold=-1e9).decide(X, GOOD).verdict == Verdict.REPLACED


def test_contraction_asks_for_a_share_of_the_cost(oracle):
    cost = oracle.cost(X, [0.0] * 50, 0.01)
    decision = make().decide(X, GOOD)
    share = -decision.criterion / cost
    assert 0.0 < share < 1.0
    asked = make(contraction=0.99 * share).decide(X, GOOD)
    assert asked.verdict == Verdict.ACCEPTED
    assert asked.threshold == pytest.approx(-0.99 * share * cost, rel=1e-9)
    filter_ = make(contraction=1.01 * share)
    assert filter_.decide(X, GOOD).verdict == Verdict.REPLACED
    filter_.configure(contraction=0.0)
    assert filter_.decide(X, GOOD).verdict == Verdict.ACCEPTED


def test_where_no_share_is_asked_the_cost_need_not_be_finite():
    decision = make("training").decide(FAR, BAD)
    assert (decision.verdict, decision.reason) == (Verdict.ACCEPTED, Reason.CRITERION)
    asked = make("training", contraction=0.1).decide(FAR, BAD)
    assert (asked.verdict, asked.reason) == (Verdict.REJECTED, Reason.NON_FINITE_CRITERION)


def test_a_controller_without_a_solution_is_told_and_its_last_schedule_goes_on():
    filter_ = make(controller_horizon=0.04)
    decision = filter_.decide(FAR, GOOD)
    assert (decision.verdict, decision.reason) == (Verdict.REPLACED, Reason.NOT_CONVERGED)
    assert decision.applied_control == 0.0
    filter_.decide(X, BAD)
    later = [filter_.decide(FAR, GOOD).applied_control for _ in range(4)]
    assert later[0] > 0.0 == later[3]


@pytest.mark.parametrize("asks", [{"continuation": "controller"}, {"judge": "predictive"}])
def test_what_asks_a_controller_that_finds_nothing_cannot_judge(asks):
    decision = make(**asks).decide(FAR, BAD)
    assert (decision.verdict, decision.reason) == (Verdict.REPLACED, Reason.NON_FINITE_CRITERION)
    assert decision.applied_control == 0.0


def test_continuation_forgives_what_the_controller_can_mend():
    """With the controller after it even a push the wrong way is part of a descent; one that is too hard is not."""
    filter_ = make(continuation="controller")
    decision = filter_.decide(X, BAD)
    assert (decision.verdict, decision.reason) == (Verdict.ACCEPTED, Reason.CRITERION)
    assert filter_.decide(X, 1e4 * BAD).verdict == Verdict.REPLACED

    cost = quadratic(TASK)
    controller = controllers.make("ilqr", TASK, cost, horizon=0.5)

    def expected() -> float:
        after = X.copy()
        Stepper(TASK, 0.01).advance(after, BAD)
        controller.solve(after)
        return mig_integral(TASK, cost, X, BAD, horizon=0.5, dt=0.01, then=controller.schedule)

    filter_ = make(continuation="controller")
    assert filter_.decide(X, BAD).criterion == expected() < 0.0 < make().decide(X, BAD).criterion
    # A tick later the controller begins with what it had found, one sample on.
    controller.advance()
    assert filter_.decide(X, BAD).criterion == expected()


SLIP = tasks.get("slip")
FLYING = np.array([0.0, 0.8, 1.1, -1.0, 0.1])


def slip(mode="assistance", **values):
    return MigFilter(SLIP, FilterConfig(mode=mode, horizon=0.6, **values))


def test_channels_are_judged_one_by_one():
    """Compressed, thrust up is good: of a good thrust and a bad toe only the toe is taken, and the other way round."""
    stance = np.array([0.0, 0.8, 0.9, -0.5, -0.2])
    probe = slip("training")
    toe = next(s for s in (2.0, -2.0) if probe.decide(FLYING, np.array([0.0, s])).verdict == Verdict.REJECTED)
    both = probe.decide(FLYING, np.array([5.0, toe]))
    assert (both.verdict, list(both.applied_control)) == (Verdict.REJECTED, [0.0, 0.0])
    kept = slip("training", channels="separately").decide(FLYING, np.array([5.0, toe]))
    assert (kept.verdict, list(kept.applied_control)) == (Verdict.REJECTED, [5.0, 0.0])
    push = next(s for s in (5.0, -5.0) if probe.decide(stance, np.array([s, 0.0])).verdict == Verdict.REJECTED)
    kept = slip("training", channels="separately").decide(stance, np.array([push, 2.0]))
    assert (kept.verdict, list(kept.applied_control)) == (Verdict.REJECTED, [0.0, 2.0])
    helped = slip(channels="separately").decide(FLYING, np.array([5.0, toe]))
    assert helped.verdict == Verdict.REPLACED
    assert helped.applied_control[0] == 5.0
    assert helped.applied_control[1] == slip().decide(FLYING, np.array([0.0, toe])).applied_control[1]


def test_channels_apart_agree_with_their_sum():
    """Along the nominal trajectory the criterion is linear: the joint one is the sum of those of the channels."""
    for toe in (-1.5, 1.5):
        u = np.array([7.0, toe])
        joint = slip().decide(FLYING, u).criterion
        alone = [slip().decide(FLYING, part).criterion for part in (u * [1.0, 0.0], u * [0.0, 1.0])]
        assert joint == pytest.approx(sum(alone), rel=1e-9)
        assert slip(channels="separately").decide(FLYING, u).criterion == max(alone)
    # The last toe is a good one, and the thrust changes nothing in flight: apart, that is the larger of the two.
    assert alone[1] < 0.0 == alone[0]


def test_a_channel_at_rest_is_not_judged_apart():
    u = np.array([0.0, 1.5])
    apart = slip(channels="separately").decide(FLYING, u)
    assert apart.verdict == Verdict.ACCEPTED
    assert apart.criterion == slip().decide(FLYING, u).criterion < 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("mode", ["off", "training", "assistance"])
def test_not_finite_never_passes(mode, bad):
    filter_ = make(mode)
    for x, u, reason in (
        (X, np.array([bad]), Reason.NON_FINITE_WRENCH),
        (np.array([0.1, bad, 0.0, 0.0]), GOOD, Reason.NON_FINITE_STATE),
    ):
        decision = filter_.decide(x, u)
        assert decision.reason == reason
        assert decision.verdict == Verdict.REJECTED
        assert decision.applied_control == 0.0
        assert math.isnan(decision.criterion)


def test_state_near_a_singularity():
    decision = make("training").decide(SINGULAR, GOOD)
    assert decision.verdict == Verdict.REJECTED
    assert decision.reason == Reason.NON_FINITE_CRITERION


def test_without_a_criterion_assistance_follows_the_last_valid_schedule_to_its_end():
    filter_ = make(controller_horizon=0.04)
    first = filter_.decide(X, BAD).applied_control
    later = [filter_.decide(SINGULAR, BAD) for _ in range(5)]
    assert all(d.verdict == Verdict.REPLACED and d.reason == Reason.NON_FINITE_CRITERION for d in later)
    assert first > 0.0
    assert later[0].applied_control > 0.0
    assert later[3].applied_control == later[4].applied_control == 0.0
    filter_.decide(X, BAD)
    filter_.reset()
    assert filter_.decide(SINGULAR, BAD).applied_control == 0.0


@pytest.mark.parametrize("mode", ["off", "training", "assistance"])
def test_fallback_is_nothing_even_where_the_controller_would_help(mode):
    filter_ = make(mode)
    filter_.decide(X, BAD)
    decision = filter_.fallback(5, BAD)
    assert (decision.verdict, decision.reason) == (Verdict.REJECTED, Reason.STALE_WRENCH)
    assert decision.applied_control == 0.0


def test_a_tick_without_inputs_is_a_tick_of_the_controllers_schedule_too():
    def after(*reasons):
        filter_ = make(controller_horizon=0.04)
        filter_.decide(X, BAD)
        for reason in reasons:
            filter_.fallback(reason, BAD)
        return filter_.decide(SINGULAR, BAD).applied_control

    assert after() != after(Reason.STALE_STATE)
    assert after(Reason.STALE_STATE) > 0.0
    assert after(*3 * [Reason.STALE_WRENCH]) == 0.0


def test_reasons_of_inputs_that_are_not_to_be_believed():
    """They are those whose names speak of a state, a wrench or its frame."""
    named = {r for r in Reason if r.name.endswith(("_STATE", "_WRENCH", "_FRAME"))}
    assert named == INPUT_FAULTS


def test_mode_changes_between_ticks():
    filter_ = make("training")
    assert filter_.decide(X, BAD).verdict == Verdict.REJECTED
    filter_.mode = "assistance"
    assert filter_.decide(X, BAD).verdict == Verdict.REPLACED
    filter_.mode = 0
    assert filter_.decide(X, BAD).verdict == Verdict.ACCEPTED
    with pytest.raises(ParameterError, match="mode"):
        filter_.mode = "helpful"
    with pytest.raises(ParameterError, match="mode"):
        filter_.mode = 3


def test_configure_all_or_nothing():
    filter_ = make()
    filter_.configure(mode="training", threshold=2.0, dead_zone=1.0)
    assert (filter_.mode, filter_.threshold) == (Mode.TRAINING, 2.0)
    for values in ({"threshold": 3.0, "horizon": 2.0}, {"threshold": 3.0, "dead_zone": -1.0}, {"treshold": 3.0}):
        with pytest.raises(ParameterError):
            filter_.configure(**values)
        assert filter_.threshold == 2.0


def test_the_force_that_is_believed_changes_when_it_is_named_and_only_then():
    filter_ = make(max_force=50.0)
    filter_.configure(threshold=1.0)
    assert filter_.max_force == 50.0
    filter_.configure(max_force=20.0)
    assert filter_.max_force == 20.0


def test_the_dead_zone_changes_when_it_is_named_and_only_then():
    filter_ = make("training", dead_zone=4.0)
    filter_.configure(mode="assistance")
    assert filter_.decide(X, np.array([-3.9])).reason == Reason.NULL_ACTION
    filter_.configure(dead_zone=6.0)
    assert filter_.decide(X, BAD).reason == Reason.NULL_ACTION
    filter_.configure(dead_zone=1.0)
    assert filter_.decide(X, BAD).verdict == Verdict.REPLACED


def test_nothing_compiles_after_warm_up():
    from shared_control.controllers.ilqr_kernels import search
    from shared_control.dispatch import compiled
    from shared_control.mig import _slope

    filter_ = make()
    filter_.warm_up()
    before = compiled(_slope), compiled(search)
    frozen = X.copy()
    frozen.setflags(write=False)
    for x in (frozen, np.stack([X, X], axis=1)[:, 0], X.astype(np.float32), [0.3, 0.5, 0.0, 0.0]):
        filter_.decide(x, BAD)
    assert (compiled(_slope), compiled(search)) == before


@pytest.mark.parametrize("asks", [{"contraction": 0.1}, {"continuation": "controller"}, {"judge": "predictive"}])
def test_after_warm_up_no_kernel_is_looked_for(asks, monkeypatch):
    """What each object calls is bound to the types of its first call, which is warm-up's."""
    from shared_control.mig import _slope

    filter_ = make(threshold=-1e9, **asks)
    filter_.warm_up()
    asked = []
    monkeypatch.setattr(type(_slope), "compile", lambda kernel, types: asked.append(kernel))
    assert filter_.decide(X, BAD).verdict == Verdict.REPLACED
    assert not asked


def test_warm_up_leaves_no_schedule():
    filter_ = make()
    filter_.warm_up()
    assert filter_.decide(SINGULAR, BAD).applied_control == 0.0


anything = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=150)
@given(st.tuples(anything, anything, anything, anything), anything, st.sampled_from(["off", "training", "assistance"]))
def test_whatever_comes_in_what_goes_out_is_finite(x, u, mode):
    decision = make(mode).decide(np.array(x), np.array([u]))
    assert np.all(np.isfinite(decision.applied_control))
    if decision.verdict == Verdict.ACCEPTED:
        assert decision.applied_control == u


def test_weights_that_do_not_fit():
    with pytest.raises(ParameterError, match="controller_state_weights"):
        make(controller_state_weights=(1.0,))
    with pytest.raises(ParameterError, match=r"^state_weights"):
        make(state_weights=(1.0,))
    with pytest.raises(ParameterError, match="control_limits"):
        make(control_limits=(1.0, 2.0))


def test_the_controllers_weights_are_the_filters_unless_they_are_given():
    judged = {
        "state_weights": (1.0, 2.0, 3.0, 4.0), "control_weights": (5.0,), "terminal_weights": (6.0, 7.0, 8.0, 9.0),
        "target": (0.1, 0.2, 0.3, 0.4),
    }  # fmt: skip
    filters, controllers_ = costs(TASK, FilterConfig(**judged))
    assert filters == controllers_ == quadratic(TASK, *judged.values())
    own = {"state_weights": (4.0, 3.0, 2.0, 1.0), "control_weights": (0.5,), "terminal_weights": (9.0, 8.0, 7.0, 6.0)}
    for key, value in own.items():
        filters, controllers_ = costs(TASK, FilterConfig(**judged, **{f"controller_{key}": value}))
        assert filters == quadratic(TASK, *judged.values())
        assert controllers_ == quadratic(TASK, **{**judged, key: value})
