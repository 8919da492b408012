"""Measures on trajectories made by hand."""

from __future__ import annotations

import itertools
import math
import statistics
import warnings

import numpy as np
import pytest

from shared_control.measures import cart_pendulum, slip
from shared_control.parameters import ParameterError

DT = 0.01


def trajectory(*pieces):
    """Nodes from (count, theta, theta_dot) pieces; the first node counts with its piece."""
    rows = [[theta, omega, 0.0, 0.0] for count, theta, omega in pieces for _ in range(count)]
    return np.array(rows)


def test_hanging():
    measures = cart_pendulum(trajectory((3001, math.pi, 0.0)), DT)
    assert measures == (False, 30.0, 0.0, pytest.approx(1.0), 0.0, 0.0, 0.0, False)


def test_the_papers_example():
    """Success at 8.3 s and balance of 19.7 s in a trial of 30 s: entry, and from 2 s after it."""
    states = trajectory((830, math.pi, 0.0), (3001 - 830, 0.1, 0.0))
    measures = cart_pendulum(states, DT)
    assert measures.success
    assert measures.time_to_success == pytest.approx(8.3)
    assert measures.balance_time == pytest.approx(19.7)
    other = cart_pendulum(states, DT, success_time="dwell", balance="in_region")
    assert other.time_to_success == pytest.approx(10.3)
    assert other.balance_time == pytest.approx(21.7)


def test_upright_at_the_end_is_of_the_last_node_and_knows_no_speed():
    assert cart_pendulum(trajectory((100, 3.0, 0.0), (1, 2.0 * math.pi - 0.39, 9.0)), DT).upright_at_end
    assert not cart_pendulum(trajectory((300, 0.0, 0.0), (1, 0.41, 0.0)), DT).upright_at_end
    assert cart_pendulum(trajectory((1, -0.4, 0.0)), DT).upright_at_end


def test_a_stay_must_last_two_seconds():
    assert cart_pendulum(trajectory((100, 3.0, 0.0), (201, 0.0, 0.0)), DT).success
    assert not cart_pendulum(trajectory((100, 3.0, 0.0), (200, 0.0, 0.0)), DT).success
    assert not cart_pendulum(trajectory((150, 0.0, 0.0), (1, 0.0, 0.8), (150, 0.0, 0.0)), DT).success


def test_borders_belong_and_turns_do_not_matter():
    assert cart_pendulum(trajectory((201, 0.4, -0.75)), DT).success
    assert cart_pendulum(trajectory((201, 6.0 * math.pi - 0.39, 0.75)), DT).success
    assert not cart_pendulum(trajectory((201, 0.4001, 0.0)), DT).success


def test_balance_is_cumulative_over_successful_stays():
    states = trajectory((301, 0.0, 0.0), (50, 1.0, 0.0), (101, 0.0, 0.0), (50, 1.0, 0.0), (251, 0.0, 0.0))
    assert cart_pendulum(states, DT).balance_time == pytest.approx(1.0 + 0.5)
    assert cart_pendulum(states, DT, balance="in_region").balance_time == pytest.approx(3.0 + 1.0 + 2.5)


def test_rms():
    states = trajectory((50, math.pi / 2, 0.0), (50, -math.pi / 2, 3.0))
    assert cart_pendulum(states, DT).rms_error == pytest.approx(0.5)
    assert cart_pendulum(states, DT, error="state").rms_error == pytest.approx(
        math.sqrt((math.pi / 2) ** 2 + 4.5) / math.pi
    )


def test_rejections():
    states = trajectory((100, 3.0, 0.0), (901, 0.0, 0.0))
    action, intervened = np.ones(1000, bool), np.zeros(1000, bool)
    action[:100] = False
    intervened[50:150] = True
    intervened[600:] = True
    measures = cart_pendulum(states, DT, action=action, intervened=intervened)
    # Success is complete at tick 300: of the actions 100 to 299 those up to 149 were stopped.
    assert measures.pra == pytest.approx(50 / 200)
    assert measures.pra_trial == pytest.approx(450 / 900)
    nobody = cart_pendulum(states, DT, action=np.zeros(1000, bool), intervened=intervened)
    assert math.isnan(nobody.pra)
    assert math.isnan(nobody.pra_trial)


def test_excursion():
    states = np.zeros((3, 4))
    states[:, 2] = (0.0, -3.0, 2.0)
    assert cart_pendulum(states, DT).cart_excursion == 3.0


def test_refused():
    for options in ({"success_time": "exit"}, {"balance": "all"}, {"error": "max"}, {"action": np.ones(5)}):
        with pytest.raises(ParameterError):
            cart_pendulum(np.zeros((3, 4)), DT, **options)
    with pytest.raises(ParameterError, match="states"):
        cart_pendulum(np.zeros((3, 5)), DT)


def test_slip_until_the_fall():
    states = np.zeros((1001, 5))
    states[:, 2] = 1.0
    states[:, 1] = 1.0
    states[400:, 2] = -0.01
    states[401:, 1] = 9.0
    intervened = np.zeros(1000, bool)
    intervened[:100] = intervened[500:] = True
    found = slip(states, DT, intervened=intervened, wanted_speed=np.full(1001, 0.7))
    assert found.fell
    assert found.fall_time == pytest.approx(4.0)
    assert found.override == pytest.approx(0.25)
    assert found.mean_speed == pytest.approx(1.0)
    assert found.speed_rmse == pytest.approx(0.3)
    assert math.isnan(found.speed_correlation)


def test_slip_that_follows():
    time = DT * np.arange(1001)
    wanted = 0.8 + 0.5 * np.sin(time)
    states = np.zeros((1001, 5))
    states[:, 1], states[:, 2] = wanted + 0.1, 1.0
    found = slip(states, DT, wanted_speed=wanted)
    assert not found.fell
    assert found.fall_time == pytest.approx(10.0)
    assert found.speed_rmse == pytest.approx(0.1)
    assert found.speed_correlation == pytest.approx(1.0)
    assert math.isnan(slip(states, DT).speed_rmse)
    assert slip(states, DT, wanted_speed=2.0 - wanted).speed_correlation == pytest.approx(-1.0)
    assert slip(states, DT, fall_height=1.0).fall_time == 0.0
    for options in ({"wanted_speed": wanted[1:]}, {"action": np.ones(5)}):
        with pytest.raises(ParameterError):
            slip(states, DT, **options)


def test_the_rhythm_of_the_steps_is_no_error_of_the_strides():
    """0.3 s of stance at 0.8 m/s, 0.2 s of flight at 1.3 m/s: strides of 1 m/s, which is what is wanted."""
    stood = np.tile([True] * 30 + [False] * 20, 8)[:-9]
    states = np.zeros((len(stood), 5))
    states[:, 1], states[:, 2] = np.where(stood, 0.8, 1.3), 1.0
    states[1:, 0] = np.cumsum(DT * states[:-1, 1])
    found = slip(states, DT, wanted_speed=np.full(len(stood), 1.0), stance=stood)
    assert found.stride_speed_rmse == pytest.approx(0.0, abs=1e-12)
    assert found.speed_rmse == pytest.approx(math.sqrt(np.mean((states[:, 1] - 1.0) ** 2)))
    faster = slip(states, DT, wanted_speed=np.full(len(stood), 1.1), stance=stood)
    assert faster.stride_speed_rmse == pytest.approx(0.1)
    assert math.isnan(faster.stride_speed_correlation)


def test_strides_against_a_plain_loop():
    """Strides of any length, and a runner who falls in the middle of one."""
    random = np.random.default_rng(5)
    stood, speed = [], []
    for _ in range(12):
        for standing in (True, False):
            ticks = int(random.integers(8, 40))
            stood += [standing] * ticks
            speed += random.normal(0.8, 0.3, ticks).tolist()
    count, fall = len(stood), len(stood) - 30
    wanted = [0.8 + 0.5 * math.sin(0.01 * k) for k in range(count)]
    states = np.zeros((count, 5))
    states[:, 1], states[:, 2] = speed, 1.0
    states[fall:, 2] = -0.1
    for k in range(1, count):
        states[k, 0] = states[k - 1, 0] + DT * speed[k - 1]
    found = slip(states, DT, wanted_speed=wanted, stance=stood)

    starts = [k for k in range(1, fall + 1) if stood[k] and not stood[k - 1]]
    assert len(starts) >= 10
    means, aims = [], []
    for first, end in itertools.pairwise(starts):
        means.append(statistics.fmean(speed[first:end]))
        aims.append(statistics.fmean((wanted[k] + wanted[k + 1]) / 2 for k in range(first, end)))
    squares = [(mean - aim) ** 2 for mean, aim in zip(means, aims, strict=True)]
    assert found.stride_speed_rmse == pytest.approx(math.sqrt(statistics.fmean(squares)))
    assert found.stride_speed_correlation == pytest.approx(statistics.correlation(means, aims))


@pytest.mark.parametrize(("fall", "error"), [(49, 0.0), (50, math.sqrt(0.5)), (51, math.sqrt(0.5))])
def test_a_stride_counts_that_has_ended_when_the_runner_falls(fall, error):
    """Strides at the wanted speed and at 1 m/s more, from node 10 to 30 and on to 50."""
    stood = np.zeros(61, bool)
    for touchdown in (10, 30, 50):
        stood[touchdown : touchdown + 5] = True
    states = np.zeros((61, 5))
    states[:, 0] = DT * (np.arange(61) + np.maximum(np.arange(61) - 30, 0))
    states[:fall, 2] = 1.0
    found = slip(states, DT, wanted_speed=np.ones(61), stance=stood)
    assert found.stride_speed_rmse == pytest.approx(error, abs=1e-12)


def test_without_a_whole_stride_there_is_no_speed_of_strides():
    states = np.zeros((101, 5))
    states[:, 1], states[:, 2] = 1.0, 1.0
    wanted, one = np.linspace(0.5, 1.5, 101), np.arange(101) >= 50
    for stance in (None, np.ones(101, bool), np.zeros(101, bool), one):
        found = slip(states, DT, wanted_speed=wanted, stance=stance)
        assert math.isfinite(found.speed_rmse)
        assert math.isnan(found.stride_speed_rmse)
        assert math.isnan(found.stride_speed_correlation)
    assert math.isnan(slip(states, DT, stance=one).stride_speed_rmse)
    with pytest.raises(ParameterError, match="stance"):
        slip(states, DT, wanted_speed=wanted, stance=one[1:])


def test_a_correlation_with_a_constant_is_none_and_no_warning():
    still, varying = np.full(11, 0.7), np.linspace(0.0, 1.0, 11)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for speed, wanted in ((still, varying), (varying, still), (still, still), (still[:1], still[:1])):
            states = np.zeros((len(speed), 5))
            states[:, 1], states[:, 2] = speed, 1.0
            assert math.isnan(slip(states, DT, wanted_speed=wanted).speed_correlation)


def test_a_trial_without_a_tick_has_measures():
    """It begins and ends hanging, or standing: its state is there, its time is not."""
    hanging = cart_pendulum(trajectory((1, math.pi, 0.0)), DT)
    assert not hanging.success
    assert (hanging.time_to_success, hanging.balance_time) == (0.0, 0.0)
    assert not slip(np.array([[0.0, 1.0, 1.0, 0.0, 0.0]]), DT).fell
    for measures, width in ((cart_pendulum, 4), (slip, 5)):
        with pytest.raises(ParameterError, match="states"):
            measures(np.zeros((0, width)), DT)


def test_what_kind_of_numbers_a_table_has_does_not_matter():
    """Columns of bags are single precision, or integers where they mean yes and no."""
    random = np.random.default_rng(31)
    nodes = np.column_stack([np.cumsum(random.uniform(0, 0.01, 201)), *random.uniform(0.5, 1.5, (4, 201))])
    single, stance = nodes.astype(np.float32), random.uniform(size=201) < 0.5
    wanted = random.uniform(0.5, 1.5, 201).astype(np.float32)
    found = slip(single, DT, wanted_speed=wanted, stance=np.where(stance, 200, 0))
    assert found == slip(single.astype(float), DT, wanted_speed=wanted.astype(float), stance=stance)
    assert cart_pendulum(single[:, :4], DT) == cart_pendulum(single[:, :4].astype(float), DT)
