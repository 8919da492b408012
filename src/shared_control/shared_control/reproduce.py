"""The science's part of docs/results.md: what is claimed, with which configuration and how many seeds.

``./rig reproduce`` measures it (:mod:`rig_study.reproduce_cli`). Headless, with a progress bar for each line; nothing
here is tuned to the seeds. The lines that begin with ``map`` say how the figures move when one thing is changed at a
time, and where they break.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from shared_control import measures
from shared_control.cost import wrap
from shared_control.scenario import find
from shared_control.trial import TrialResult, judged, run_trials
from shared_control.users.presets import PRESETS

__all__ = ["CLAIMS", "Claim", "measure", "scenario"]

#: First of the seeds; used nowhere else.
FIRST_SEED = 40_000_000


class Claim(NamedTuple):
    """One line of the table."""

    base: str  # scenario
    changes: Mapping[str, Mapping[str, Any]]  # to its sections, by node; none: what the nodes share
    seeds: int
    wanted: str  # in words


def _cart(mode: str, wanted: str, seeds: int = 100, **filter_: Any) -> Claim:
    sd = filter_.pop("sd", None)
    changes: dict[str, dict[str, Any]] = {"mig_filter": filter_}
    if sd is not None:
        changes["user_sim"] = {"noise_sd": [sd]}
    return Claim(f"cart_pendulum_noise_{mode}", changes, seeds, wanted)


def _skilled(preset: str, mode: str, spread: float) -> Claim:
    changes: dict[str, dict[str, Any]] = {
        "user_sim": {"user": "mpc", "preset": preset},
        "task_sim": {"initial_sd": [spread] * 4},
    }
    wanted = "always successful" + ("" if mode == "off" else f", PRA <= {0.01 if spread == 0.0 else 0.05}")
    return Claim(f"cart_pendulum_noise_{mode}", changes, 1 if spread == 0.0 else 20, wanted)


#: Users between noise and skill: how much purpose, how late, how wrong about the pendulum's length [m].
_GRADES = [
    (float(skill), delay, length)
    for skill, delay, length in zip(
        np.linspace(0.0, 1.0, 32), 8 * (0.0, 0.05, 0.1, 0.2), 4 * (2.0, 1.6, 2.4, 2.0, 3.0, 2.0, 1.2, 2.0), strict=True
    )
]


def _graded(seeds: int, workers: int | None) -> str:
    """Success of 32 users alone, and what share of their actions the filter would have rejected; ``seeds`` trials."""
    from scipy.stats import spearmanr

    successes, rejected = [], []
    for number, (skill, delay, length) in enumerate(_GRADES):
        user = {
            "user": "graded", "preset": "economical", "skill": skill, "delay": delay,
            "model_parameters": [f"length={length}"],
        }  # fmt: skip
        trials = range(FIRST_SEED + 1000 * number, FIRST_SEED + 1000 * number + seeds)
        alone = run_trials(scenario(Claim("cart_pendulum_noise_off", {"user_sim": user}, seeds, "")), trials, workers)
        successes.append(float(_field(alone, "success").mean()))
        rejected.append(float(np.mean([judged(trial, "cart_pendulum_noise_training").pra for trial in alone])))
    return (
        f"Spearman {spearmanr(successes, rejected).statistic:.2f} over {len(_GRADES)} users; "
        f"success alone {min(successes):.2f} to {max(successes):.2f}, PRA {min(rejected):.3f} to {max(rejected):.3f}"
    )


#: The claim that compares users with each other.
GRADED = Claim("cart_pendulum_noise_training", {}, 10, "Spearman of success alone and PRA at most -0.8")

_RANDOM = {"mig_filter": {"judge": "random", "rejection_rate": 0.7}}


def _neighbours(base: str, seeds: int, node: str, **values: list[Any] | dict[str, Any]) -> Iterator[tuple[str, Claim]]:
    """The scenario with one parameter of a node at each of its values in turn; a dictionary names them."""
    for parameter, options in values.items():
        named = options if isinstance(options, dict) else {str(value): value for value in options}
        for name, value in named.items():
            label = f"map/{base.removesuffix('_assistance')}/{parameter.replace('_', ' ')} {name}"
            yield label, Claim(base, {node: {parameter: value}}, seeds, "reported")


def _mismatch(parameter: str, default: float) -> dict[str, list[str]]:
    """A plant whose parameter is by so much larger or smaller than filter and controller believe."""
    return {
        f"{parameter} {percent:+d} %": [f"{parameter}={default * (1.0 + percent / 100.0):g}"]
        for percent in (-30, -20, -10, 10, 20, 30)
    }


def _map() -> Iterator[tuple[str, Claim]]:
    """The neighbourhood of the shipped configurations."""
    from shared_control import tasks

    cart, slip = "cart_pendulum_noise_assistance", "slip_noise_assistance"
    pendulum, leg = tasks.get("cart_pendulum").parameters, tasks.get("slip").parameters
    yield from _neighbours(
        cart, 20, "mig_filter", horizon=[0.4, 0.6, 0.8, 1.0, 1.2, 2.0],
        state_weights={
            "angle alone": [200.0, 0.0, 0.0, 0.0], "a tenth on the cart": [200.0, 0.0, 2.0, 1.0],
            "five times on the cart": [200.0, 0.0, 100.0, 1.0], "rate too": [200.0, 20.0, 20.0, 1.0],
        },
        adjoint_along=["user"],
    )  # fmt: skip
    yield from _neighbours(cart, 20, "user_sim", noise_sd=[[2.0], [5.0], [10.0], [40.0]], noise_hold=[5, 20])
    yield from _neighbours(
        cart, 20, "task_sim", initial_state={"swinging": [3.0, 0.5, 0.0, 0.0], "upright": [0.0] * 4},
        plant_parameters={**_mismatch("length", pendulum.length), **_mismatch("mass", pendulum.mass)},
    )  # fmt: skip
    yield from _neighbours(cart, 20, "", sample_time=[0.005, 0.02, 0.04])
    yield from _neighbours(
        slip, 10, "mig_filter", horizon=[0.6, 0.7, 0.8, 1.0, 1.2], adjoint_along=["nominal"],
        target={f"height {z} m": [0.0, 0.0, z, 0.0, 0.0] for z in (1.1, 1.2, 1.4)},
        state_weights={"a fifth": [0.0, 0.0, 10.0, 0.0, 0.0], "speed too": [0.0, 5.0, 50.0, 0.0, 0.0]},
    )  # fmt: skip
    yield from _neighbours(slip, 10, "user_sim", noise_sd=[[5.0, 2.5], [10.0, 3.3], [30.0, 15.0]])
    yield from _neighbours(
        slip, 10, "task_sim", initial_state={"at rest": [0.0, 0.0, 1.0, 0.0, 0.0]},
        plant_parameters={**_mismatch("stiffness", leg.stiffness), **_mismatch("mass", leg.mass)},
    )  # fmt: skip
    yield from _neighbours(slip, 10, "", sample_time=[0.005, 0.02])


#: Every claim that can be measured here, by name.
CLAIMS: dict[str, Claim] = {
    "cart/noise/assistance": _cart("assistance", "1,000 of 1,000, PRA 0.50 +- 0.02, cart p99 <= 15 m", 1000),
    "cart/noise/assistance/sac": _cart("assistance", "100 of 100", controller="sac"),
    "cart/noise/training": _cart("training", "the filter alone rectifies noise"),
    "cart/noise/off": _cart("off", "0 of 100"),
    **{
        f"cart/laboratory/{along}/sd {sd}": _cart(
            "assistance", "100 of 100" + (", PRA 0.50" if along == "nominal" else ""), horizon=1.0, adjoint_along=along,
            sd=float(sd),
        )
        for along in ("nominal", "user")
        for sd in (20, 10, 5)
    },
    **{
        f"cart/{preset}/{mode}/{'exact' if spread == 0.0 else 'perturbed'} start": _skilled(preset, mode, spread)
        for preset in PRESETS["cart_pendulum"]
        for mode in ("off", "assistance")
        for spread in (0.0, 0.1)
    },
    "cart/graded users": GRADED,
    "slip/noise/off": Claim("slip_noise_off", {}, 100, "falls in 100 of 100"),
    "slip/noise/assistance/sac": Claim(
        "slip_noise_assistance", {"mig_filter": {"controller": "sac"}}, 100, "reported"
    ),
    "slip/noise/assistance": Claim("slip_noise_assistance", {}, 300, "never falls, override 0.70 +- 0.05"),
    "slip/noise/random rejection": Claim("slip_noise_assistance", _RANDOM, 100, "what replacement alone does"),
    "slip/noise/predictive safety filter": Claim(
        "slip_noise_assistance", {"mig_filter": {"judge": "predictive"}}, 100, "reported"
    ),
    "slip/noise/training": Claim("slip_noise_training", {}, 100, "reported"),
    "slip/low skill/off": Claim("slip_low_skill_off", {}, 100, "falls at about 5.5 s in the median"),
    "slip/low skill/assistance": Claim("slip_low_skill_assistance", {}, 300, "never falls, < 0.40, 0.98 +- 0.05 m/s"),
    "slip/skilled/off": Claim("slip_skilled_off", {}, 100, "never falls"),
    "slip/skilled/assistance": Claim("slip_skilled_assistance", {}, 100, "never falls, <= 0.22, 0.06 m/s, r >= 0.98"),
    **dict(_map()),
}  # fmt: skip


def scenario(claim: Claim) -> dict[str, Any]:
    """The claim's scenario: its file with the changes, as a mapping."""
    import yaml

    content: dict[str, Any] = copy.deepcopy(yaml.safe_load(find(claim.base).read_text()))
    for node, values in claim.changes.items():
        section = f"/**/{node}" if node else "/**"
        content.setdefault(section, {"ros__parameters": {}})["ros__parameters"].update(values)
    return content


def measure(claim: Claim, seeds: int | None = None, workers: int | None = None) -> str:
    """Run a claim's trials, as many as it says or fewer, and say in one line what came out."""
    count = claim.seeds if seeds is None else min(seeds, claim.seeds)
    if claim is GRADED:
        return _graded(count, workers)
    results = run_trials(scenario(claim), range(FIRST_SEED, FIRST_SEED + count), workers)
    first = results[0].measures
    say: Callable[[list[TrialResult]], str] = (
        _cart_line if isinstance(first, measures.CartPendulumMeasures) else _slip_line
    )
    return say(results)


def _field(results: list[TrialResult], name: str) -> np.ndarray:
    return np.array([getattr(result.measures, name) for result in results], dtype=float)


def _cart_line(results: list[TrialResult]) -> str:
    excursion, to_success = _field(results, "cart_excursion"), _field(results, "time_to_success")
    pra, pra_trial = (np.nanmean(_field(results, name)) for name in ("pra", "pra_trial"))
    upright = sum(abs(wrap(float(result.states[-1, 0]))) <= 0.4 for result in results)
    return (
        f"{int(_field(results, 'success').sum())} of {len(results)} inverted, {upright} upright at the end; "
        f"PRA {pra:.3f} ({pra_trial:.3f} over the trial); "
        f"cart p50 {np.median(excursion):.1f}, p99 {np.percentile(excursion, 99):.1f} m; "
        f"time to success p50 {np.median(to_success):.1f}, most {to_success.max():.1f} s"
    )


def _slip_line(results: list[TrialResult]) -> str:
    low, middle, high = np.percentile(_field(results, "fall_time"), [25, 50, 75])
    fell = int(_field(results, "fell").sum())
    line = (
        f"{fell} of {len(results)} fell (quartiles {low:.1f}, {middle:.1f}, {high:.1f} s); "
        f"override {np.nanmean(_field(results, 'override')):.3f}; {_field(results, 'mean_speed').mean():.3f} m/s"
    )
    rmse, correlation = (_field(results, name).mean() for name in ("speed_rmse", "speed_correlation"))
    if not math.isnan(rmse):
        line += f", RMSE {rmse:.3f} m/s"
    return line if math.isnan(correlation) else f"{line}, r {correlation:.3f}"
