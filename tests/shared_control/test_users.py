"""The noise user against its definition, and determinism."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from shared_control import controllers, tasks, users
from shared_control.cost import quadratic
from shared_control.integrate import Stepper
from shared_control.parameters import ParameterError
from shared_control.streams import stream
from shared_control.tasks import Robot
from shared_control.users import presets

TASK = tasks.get("cart_pendulum")
NOWHERE = np.zeros(4)


def forces(user, count, start=0):
    return np.array([user.act(k, 0.01 * k, NOWHERE) for k in range(start, start + count)])


def test_is_white_gaussian_along_x():
    f = forces(users.make("noise", TASK, 3, robot=Robot(1.5), noise_sd=[20.0]), 20000)
    assert np.all(f[:, 1:] == 0.0)
    u = f[:, 0] / 1.5
    assert abs(u.mean()) < 4.0 * 20.0 / np.sqrt(len(u))
    assert stats.kstest(u / 20.0, "norm").pvalue > 1e-3
    for lag in (1, 2, 10):
        assert abs(np.corrcoef(u[:-lag], u[lag:])[0, 1]) < 4.0 / np.sqrt(len(u))
    assert np.abs(u).max() > 60.0


def test_default_is_the_tasks():
    u = forces(users.make("noise", TASK, 4), 5000)[:, 0] / Robot().mass
    assert u.std() == pytest.approx(20.0, rel=0.04)


def test_hold_and_clip():
    f = forces(users.make("noise", TASK, 5, noise_hold=5, noise_clip=[10.0]), 1000)[:, 0] / Robot().mass
    held = f.reshape(-1, 5)
    assert np.all(held == held[:, :1])
    # More than half of it lies beyond the clip: two values, and the rest all different.
    assert len(np.unique(held[:, 0])) > 50
    assert np.abs(f).max() == 10.0


def test_each_control_has_its_own_noise():
    """SLIP's thrust and toe as its scenario has them: each of its spread, clipped at its bound, and no relation."""
    task, robot = tasks.get("slip"), Robot(0.01, 40.0)
    user = users.make("noise", task, 6, robot=robot, noise_sd=[20.0, 10.0], noise_clip=[30.0, 40.0])
    u = np.array([task.control_from_wrench(user.act(k, 0.01 * k, task.initial_state), robot) for k in range(8000)])
    assert np.abs(u[:, 0]).max() == pytest.approx(30.0)
    inside = np.abs(u[:, 0]) < 30.0
    assert inside.mean() == pytest.approx(stats.norm.cdf(1.5) - stats.norm.cdf(-1.5), abs=0.02)
    assert stats.kstest(u[:, 1] / 10.0, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(u.T)[0, 1]) < 4.0 / np.sqrt(len(u))


def test_same_seed_same_floats_whatever_the_order():
    a, b = users.make("noise", TASK, 6), users.make("noise", TASK, 7)
    whole = forces(a, 1500)
    assert not np.array_equal(forces(b, 1500), whole)
    b.reset(6)
    assert np.array_equal(b.act(1200, 12.0, NOWHERE), whole[1200])
    assert np.array_equal(forces(b, 1500), whole)


def test_streams_do_not_depend_on_each_other():
    assert stream(1, "user").integers(1 << 60) != stream(1, "plant").integers(1 << 60)
    assert stream(1, "user").integers(1 << 60) == stream(1, "user").integers(1 << 60)


@pytest.mark.parametrize(("task", "preset"), [("cart_pendulum", "economical"), ("slip", "skilled")])
def test_mpc_does_what_its_controller_finds(task, preset):
    """The force is that of the first control of the schedule for the preset's own objective."""
    task, robot = tasks.get(task), Robot(0.5, 2.0)
    x, wish = task.initial_state, presets.get(task.name, preset)
    objective = quadratic(
        task, wish.state_weights, wish.control_weights, wish.terminal_weights, wish.aim(0.5 * wish.horizon)
    )
    controller = controllers.make(
        "ilqr", task, objective, horizon=wish.horizon, limits=wish.limits, iterations=wish.iterations
    )
    user = users.make("mpc", task, robot=robot, preset=preset)
    expected = task.wrench_from_control(controller.solve(x).control, robot)
    assert np.array_equal(user.act(0, 0.0, x), expected)
    user.act(1, 0.01, x)
    user.reset(5)
    assert np.array_equal(user.act(0, 0.0, x), expected)


@pytest.mark.parametrize("kind", ["mpc", "human"])
def test_follows_the_plan_between_two_plans(kind):
    """Whatever is seen in between: the schedule of the last plan, tick by tick."""
    task = tasks.get("cart_pendulum")
    always, seldom = (users.make(kind, task, preset="economical", replan=every) for every in (1, 4))
    other = np.array([0.5, 2.0, 1.0, 0.0])
    followed = [seldom.act(k, 0.01 * k, task.initial_state if k == 0 else other) for k in range(6)]
    blind = users.make(kind, task, preset="economical", replan=4)
    same = [blind.act(k, 0.01 * k, task.initial_state if k in (0, 4) else 2.0 * other) for k in range(4)]
    assert np.array_equal(followed[:4], same)
    assert np.array_equal(followed[0], always.act(0, 0.0, task.initial_state))
    if kind == "mpc":
        assert not np.array_equal(followed[4], blind.act(4, 0.04, task.initial_state))


def test_aim_sways():
    wish = presets.get("slip", "skilled")
    speeds = [wish.aim(t)[1] for t in (0.0, 2.5, 7.5)]
    assert speeds == pytest.approx([0.8, 1.3, 0.3])
    assert wish.aim(2.5)[2] == wish.target[2]


def test_graded_is_a_mixture():
    x = np.array([0.4, 0.0, 0.0, 0.0])
    noise, mpc = (users.make(name, TASK, 8).act(0, 0.0, x) for name in ("noise", "mpc"))
    for skill in (0.0, 0.3, 1.0):
        mixed = users.make("graded", TASK, 8, skill=skill).act(0, 0.0, x)
        np.testing.assert_allclose(mixed, skill * mpc + (1.0 - skill) * noise, rtol=1e-12)


def test_graded_sees_late():
    """With a delay of three ticks it acts on the first state until the fourth tick."""
    late, first = (users.make("graded", TASK, 8, delay=delay) for delay in (0.03, 0.0))
    states = [np.array([0.1 * (k + 1), 0.0, 0.0, 0.0]) for k in range(6)]
    shown = [states[0]] * 3 + states[:3]
    for k in range(6):
        assert np.array_equal(late.act(k, 0.01 * k, states[k]), first.act(k, 0.01 * k, shown[k]))


def test_graded_forgets_what_it_saw_and_did():
    user = users.make("graded", TASK, 8, skill=0.5, delay=0.03)

    def acts(seed):
        user.reset(seed)
        return [user.act(k, 0.01 * k, np.array([0.1 * (k + 1), 0.0, 0.0, 0.0]))[0] for k in range(6)]

    first = acts(8)
    assert acts(9) != first
    assert acts(8) == first


def test_wrong_model_acts_otherwise():
    x = np.array([0.4, 0.0, 0.0, 0.0])
    right, wrong = (users.make("graded", TASK, model_parameters=texts) for texts in ((), ("length=1.0",)))
    assert not np.array_equal(right.act(0, 0.0, x), wrong.act(0, 0.0, x))


def test_human_lags_and_learns():
    """The muscle's first response is 1 - exp(-h/tau) of the command; practice takes noise away."""
    x = np.array([0.4, 0.0, 0.0, 0.0])
    command = users.make("mpc", TASK).act(0, 0.0, x)[0]
    ratios = np.array([users.make("human", TASK, seed).act(0, 0.0, x)[0] / command for seed in range(300)])
    assert ratios.mean() == pytest.approx(1.0 - np.exp(-0.01 / 0.04), rel=0.02)
    assert ratios.std() / ratios.mean() == pytest.approx(0.1, rel=0.2)
    spread = []
    for trial in (0, 20, 200):
        pushes = [users.make("human", TASK, seed, skill=0.5, trial=trial).act(0, 0.0, x)[0] for seed in range(60)]
        spread.append(np.std(pushes))
    assert spread[0] > 1.5 * spread[1] > 1.5 * spread[2]


def test_human_bridges_the_delay():
    """Where its own commands are all that moves the task, it acts on the state as it is, not as it was."""
    user = users.make("human", TASK, 3)
    stepper, x = Stepper(TASK, 0.01), np.array([0.1, 0.0, 0.0, 0.0])
    for k in range(300):
        stepper.advance(x, TASK.control_from_wrench(user.act(k, 0.01 * k, x), Robot()))
    assert abs(x[0]) < 0.1


def test_replay(tmp_path):
    forces_ = np.arange(12.0).reshape(4, 3)
    path = tmp_path / "forces.npy"
    np.save(path, forces_)
    user = users.make("replay", TASK, recording=str(path))
    assert np.array_equal(forces(user, 6), np.vstack([forces_, np.zeros((2, 3))]))
    np.save(path, np.zeros(3))
    for recording in (str(path), str(tmp_path / "none.npy")):
        with pytest.raises(ParameterError, match="recording"):
            users.make("replay", TASK, recording=recording)


def test_idle():
    assert np.array_equal(forces(users.make("idle", TASK), 3), np.zeros((3, 3)))


def test_refused():
    with pytest.raises(ParameterError, match=f"known: {', '.join(users.names())}"):
        users.make("somebody", TASK)
    with pytest.raises(ParameterError, match="did you mean noise"):
        users.make("nose", TASK)
    with pytest.raises(ParameterError, match="noise_sd"):
        users.make("noise", TASK, noise_sd=[1.0, 2.0])
    with pytest.raises(ParameterError, match="preset"):
        users.make("mpc", TASK, preset="skilled")
    with pytest.raises(ParameterError, match="noise_hold"):
        users.make("noise", TASK, noise_hold=0)
    with pytest.raises(ParameterError, match="did you mean noise_hold"):
        users.make("noise", TASK, noise_holds=1)
