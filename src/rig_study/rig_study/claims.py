"""What the paper and the issue claim of the science: with which configuration, over how many seeds, within what bounds.

``./rig reproduce`` measures it (:mod:`rig_study.reproduce_cli`); nothing here is tuned to the seeds. The map is of the
shipped configurations' neighbourhood: one thing is changed at a time, to see how the figures move and where they break.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from rig_study.bounds import Bound, all_of, at_least, at_most, near, none_of
from rig_study.changes import apply
from rig_study.runs import Job
from shared_control import scenario as science
from shared_control import tasks
from shared_control.scenario import Scenario
from shared_control.users.presets import SKILLED

__all__ = ["CART", "FIRST_SEED", "MAP", "SLIP", "Claim", "jobs", "scenario"]

#: First of the seeds; used nowhere else.
FIRST_SEED = 40_000_000


class Claim(NamedTuple):
    """One line of the table."""

    base: str  # scenario
    changes: Mapping[str, Any]  # to it, by dotted names
    seeds: int
    wanted: tuple[Bound, ...] = ()  # of its figures (rig_study.claim_figures); none: they are reported


def scenario(claim: Claim) -> Scenario:
    """The claim's scenario: its file with the changes."""
    return apply(science.load(claim.base), claim.changes, claim.base)


def jobs(name: str, claim: Claim, seeds: int) -> list[Job]:
    """The first ``seeds`` of its trials, or all if it has fewer."""
    loaded = scenario(claim)
    return [Job(f"{name}_t{k:06d}", loaded, FIRST_SEED + k) for k in range(min(seeds, claim.seeds))]


def _cart(mode: str, *wanted: Bound, seeds: int = 100, **changes: Any) -> Claim:
    names = {"sd": "user_sim.noise_sd"}
    return Claim(
        f"cart_pendulum_noise_{mode}",
        {names.get(key, f"mig_filter.{key}"): [value] if key == "sd" else value for key, value in changes.items()},
        seeds,
        wanted,
    )


def _skilled(preset: str, mode: str, spread: float) -> Claim:
    changes = {"task_sim.initial_sd": [spread] * 4} if spread else {}
    wanted = [all_of("inverted")]
    if mode != "off":
        wanted.append(at_most("rejected", 0.01 if spread == 0.0 else 0.05))
    return Claim(f"cart_pendulum_{preset}_{mode}", changes, 1 if spread == 0.0 else 100, tuple(wanted))


_INVERTED, _FELL = all_of("inverted"), none_of("fell")

#: Of the cart-pendulum, by name.
CART: dict[str, Claim] = {
    "cart/noise/assistance": _cart(
        "assistance", _INVERTED, all_of("upright at the end"), near("rejected", 0.50, 0.02),
        at_most("cart p99", 15.0, "m"), seeds=1000,
    ),
    "cart/noise/assistance/sac": _cart("assistance", _INVERTED, controller="sac"),
    "cart/noise/training": _cart("training"),
    "cart/noise/off": _cart("off", none_of("inverted")),
    **{
        f"cart/laboratory/{along}/sd {sd}": _cart(
            "assistance", _INVERTED, *([near("rejected", share, 0.02)] if share else []),
            horizon=1.0, adjoint_along=along, sd=float(sd),
        )
        for along, sd, share in (
            ("nominal", 20, 0.50), ("nominal", 10, 0.50), ("nominal", 5, 0.50),
            ("user", 20, 0.63), ("user", 10, None), ("user", 5, None),
        )
    },
    **{
        f"cart/{preset}/{mode}/{'exact' if spread == 0.0 else 'perturbed'} start": _skilled(preset, mode, spread)
        for preset in SKILLED
        for mode in ("off", "assistance")
        for spread in (0.0, 0.1)
    },
}  # fmt: skip

_RANDOM = {"mig_filter.judge": "random", "mig_filter.rejection_rate": 0.7}

#: Of SLIP, by name.
SLIP: dict[str, Claim] = {
    "slip/noise/off": Claim("slip_noise_off", {}, 100, (all_of("fell"),)),
    "slip/noise/assistance/sac": Claim("slip_noise_assistance", {"mig_filter.controller": "sac"}, 100),
    "slip/noise/assistance": Claim("slip_noise_assistance", {}, 300, (_FELL, near("override", 0.70, 0.05))),
    "slip/noise/random rejection": Claim("slip_noise_assistance", _RANDOM, 100),
    "slip/noise/predictive safety filter": Claim("slip_noise_assistance", {"mig_filter.judge": "predictive"}, 100),
    "slip/noise/training": Claim("slip_noise_training", {}, 100),
    # So many, because fall times scatter: the median of 1,000 has a standard error of 0.3 s, that of 100 0.6 s.
    "slip/low skill/off": Claim("slip_low_skill_off", {}, 1000, (near("fall time p50", 5.5, 0.5, "s"),)),
    "slip/low skill/assistance": Claim(
        "slip_low_skill_assistance", {}, 300, (_FELL, at_most("override", 0.40), near("mean speed", 0.98, 0.05, "m/s"))
    ),
    "slip/skilled/off": Claim("slip_skilled_off", {}, 100, (_FELL,)),
    "slip/skilled/assistance": Claim(
        "slip_skilled_assistance", {}, 100,
        (
            _FELL, at_most("override", 0.22), at_most("speed error", 0.06, "m/s"), at_least("speed correlation", 0.98),
            at_most("stride's speed error", 0.06, "m/s"), at_least("stride's speed correlation", 0.98),
        ),
    ),
}  # fmt: skip


def _neighbours(
    base: str, seeds: int, wanted: Bound, node: str, **values: list[Any] | dict[str, Any]
) -> Iterator[tuple[str, Claim]]:
    """The scenario with one parameter of a node at each of its values in turn; a dictionary names them."""
    for parameter, options in values.items():
        named = options if isinstance(options, dict) else {str(value): value for value in options}
        for name, value in named.items():
            label = f"map/{base.removesuffix('_assistance')}/{parameter.replace('_', ' ')} {name}"
            yield label, Claim(base, {f"{node}.{parameter}": value}, seeds, (wanted,))


def _mismatch(parameter: str, default: float) -> dict[str, list[str]]:
    """A plant whose parameter is by so much larger or smaller than filter and controller believe."""
    return {
        f"{parameter} {percent:+d} %": [f"{parameter}={default * (1.0 + percent / 100.0):g}"]
        for percent in (-30, -20, -10, 10, 20, 30)
    }


def _map() -> Iterator[tuple[str, Claim]]:
    cart, slip = ("cart_pendulum_noise_assistance", 20, _INVERTED), ("slip_noise_assistance", 10, _FELL)
    pendulum, leg = tasks.get("cart_pendulum").parameters, tasks.get("slip").parameters
    yield from _neighbours(
        *cart, "mig_filter", horizon=[0.4, 0.6, 0.8, 1.0, 1.2, 2.0],
        state_weights={
            "angle alone": [200.0, 0.0, 0.0, 0.0], "a tenth on the cart": [200.0, 0.0, 2.0, 1.0],
            "five times on the cart": [200.0, 0.0, 100.0, 1.0], "rate too": [200.0, 20.0, 20.0, 1.0],
        },
        adjoint_along=["user"],
    )  # fmt: skip
    yield from _neighbours(*cart, "user_sim", noise_sd=[[2.0], [5.0], [10.0], [40.0]], noise_hold=[5, 20])
    yield from _neighbours(
        *cart, "task_sim", initial_state={"swinging": [3.0, 0.5, 0.0, 0.0], "upright": [0.0] * 4},
        plant_parameters={**_mismatch("length", pendulum.length), **_mismatch("mass", pendulum.mass)},
    )  # fmt: skip
    yield from _neighbours(*cart, "loop", sample_time=[0.005, 0.02, 0.04])
    yield from _neighbours(
        *slip, "mig_filter", horizon=[0.6, 0.7, 0.8, 1.0, 1.2], adjoint_along=["nominal"],
        target={f"height {z} m": [0.0, 0.0, z, 0.0, 0.0] for z in (1.1, 1.2, 1.4)},
        state_weights={"a fifth": [0.0, 0.0, 10.0, 0.0, 0.0], "speed too": [0.0, 5.0, 50.0, 0.0, 0.0]},
        controller_state_weights={
            "height alone": [0.0, 0.0, 50.0, 0.0, 0.0], "four times on the speed": [0.0, 2.0, 50.0, 0.0, 0.0],
        },
    )  # fmt: skip
    yield from _neighbours(*slip, "user_sim", noise_sd=[[5.0, 2.5], [10.0, 3.3], [30.0, 15.0]])
    yield from _neighbours(
        *slip, "task_sim", initial_state={"at rest": [0.0, 0.0, 1.0, 0.0, 0.0]},
        plant_parameters={**_mismatch("stiffness", leg.stiffness), **_mismatch("mass", leg.mass)},
    )  # fmt: skip
    yield from _neighbours(*slip, "loop", sample_time=[0.005, 0.02])


#: The neighbourhood of the shipped configurations, by name: does the claim still hold there.
MAP: dict[str, Claim] = dict(_map())
