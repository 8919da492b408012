"""Named objectives of simulated users who know what they want: model predictive control with these numbers.

Cart-pendulum: three strategies that invert it without help and whose actions the shipped filter hardly ever stops
(docs/results.md, 'Skilled users of the cart-pendulum', says how they differ), and a learner: what the subjects of the
simulated study strive for, who would invert it as well but turn later than the filter wants. SLIP: a skilled user, who
runs at a varying speed and at a height that a leg can reach, and a low-skill user, who aims below the rest length and
falls. The paper says this in words ('Simulated User Results', 'SLIP - Safety'); its numbers are lost, these are ours.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from shared_control.parameters import ParameterError

__all__ = ["PRESETS", "SKILLED", "Preset", "get", "names"]

Numbers = tuple[float, ...]


class Preset(NamedTuple):
    """Objective (:mod:`shared_control.cost`) and search of one user; the target sways about its middle.

    x_d(t) = target + sway sin(2 pi t / period)
    """

    horizon: float  # [s]
    state_weights: Numbers
    control_weights: Numbers
    terminal_weights: Numbers
    target: Numbers
    limits: Numbers
    sway: Numbers = ()
    period: float = 10.0  # [s]
    iterations: int = 5

    def aim(self, time: float) -> Numbers:
        """x_d at a time [s]."""
        if not self.sway:
            return self.target
        phase = math.sin(2.0 * math.pi * time / self.period)
        return tuple(middle + swing * phase for middle, swing in zip(self.target, self.sway, strict=True))


_UPRIGHT = (0.0, 0.0, 0.0, 0.0)

PRESETS: dict[str, dict[str, Preset]] = {
    "cart_pendulum": {
        # Little effort, near the origin: a strong hand that does not use its strength.
        "economical": Preset(1.65, (100.0, 1.5, 6.0, 0.46), (4.3,), (0.0,) * 4, _UPRIGHT, (20.0,)),
        # Whatever the way, upright at the end of the horizon: the shortest time, the longest path of the cart.
        "goal": Preset(2.02, (6.1, 1.3, 0.069, 0.017), (0.26,), (1300.0, 220.0, 43.0, 0.063), _UPRIGHT, (15.5,)),
        # A weak hand, used to its limit: to and fro until the pendulum goes up.
        "pumping": Preset(1.57, (100.0, 2.9, 11.5, 0.7), (4.4,), (0.0,) * 4, _UPRIGHT, (6.0,)),
        "learner": Preset(2.4, (100.0, 0.2, 5.0, 2.5), (11.0,), (0.0,) * 4, _UPRIGHT, (20.0,)),
    },
    "slip": {
        "skilled": Preset(
            0.85, (0.0, 70.0, 50.0, 0.0, 0.0), (0.01, 0.2), (0.0,) * 5, (0.0, 0.8, 1.18, 0.0, 0.0), (20.0, 5.0),
            sway=(0.0, 0.5, 0.0, 0.0, 0.0), iterations=8,
        ),
        # Looks less far ahead and moves the foot unwillingly.
        "low_skill": Preset(
            0.55, (0.0, 32.0, 50.0, 0.0, 0.0), (0.01, 0.49), (0.0,) * 5, (0.0, 1.0, 0.75, 0.0, 0.0), (20.0, 5.0),
            iterations=8,
        ),
    },
}  # fmt: skip

#: The skilled users of the cart-pendulum.
SKILLED = ("economical", "goal", "pumping")


def names() -> tuple[str, ...]:
    """Names of all presets, of all tasks."""
    return tuple(name for presets in PRESETS.values() for name in presets)


def get(task: str, name: str = "") -> Preset:
    """The preset of a task; its first if no name is given.

    Raises
    ------
    ParameterError: the task has none of this name.
    """
    presets = PRESETS.get(task, {})
    if not presets or (name and name not in presets):
        known = ", ".join(presets) or "none"
        raise ParameterError(f"preset: {name!r} is not allowed; {task} has {known}")
    return presets[name or next(iter(presets))]
