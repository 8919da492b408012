"""Simulated users. Each yields a wrench: the force that a hand would apply.

``noise``   u_j ~ N(0, sd_j^2), a new sample every ``noise_hold`` ticks, clipped where asked
``idle``    no force
``mpc``     the first control of a schedule that is optimal for the user's own objective (:mod:`.presets`)
``graded``  u = s u_mpc + (1 - s) u_noise with skill s; it may see late and believe in another task (delay, model)
``human``   as graded, with a delay that a forward model bridges, a muscle and motor noise, and less of the noise from
            trial to trial (:mod:`.human`)
``replay``  forces of a recording, tick by tick
"""

from __future__ import annotations

import dataclasses
import difflib
import importlib
from typing import Any, Protocol

from shared_control.parameters import ParameterError, build, parameter
from shared_control.tasks.task import SAMPLE_TIME, Array, Robot, Task
from shared_control.users import presets

__all__ = ["User", "UserConfig", "make", "make_configured", "names"]

#: Name of the user: its module and its class. Imported when asked for: noise costs no compiler.
_REGISTRY: dict[str, tuple[str, str]] = {
    "noise": ("noise", "NoiseUser"),
    "idle": ("noise", "IdleUser"),
    "mpc": ("mpc", "MpcUser"),
    "graded": ("mpc", "GradedUser"),
    "human": ("human", "HumanUser"),
    "replay": ("replay", "ReplayUser"),
}


@dataclasses.dataclass(frozen=True)
class UserConfig:
    """Parameters of the simulated user. An empty array stands for the task's own default."""

    user: str = parameter("noise", "Which user.", choices=tuple(_REGISTRY))
    noise_sd: tuple[float, ...] = parameter(
        (), "Standard deviation of each control; empty: the task's.", unit="of the control", ge=0.0
    )
    noise_hold: int = parameter(1, "Ticks for which one sample of the noise is held.", ge=1, le=100000)
    noise_clip: tuple[float, ...] = parameter(
        (), "Largest magnitude of each control; empty: not clipped.", unit="of the control", ge=0.0
    )
    preset: str = parameter(
        "", "What an mpc, graded or human user wants; empty: the task's first.", choices=("", *presets.names())
    )
    # As a person's, it is another one in each trial of a session.
    skill: float = parameter(
        1.0, "Share of purpose in graded and human users; the rest is noise. A change is for the next trial.",
        ge=0.0, le=1.0, live=True,
    )  # fmt: skip
    delay: float = parameter(0.0, "From seeing to acting, for a graded user.", unit="s", ge=0.0, le=2.0)
    replan: int = parameter(
        1, "Ticks from plan to plan of an mpc, graded or human user, who follows the last in between.", ge=1, le=1000
    )
    model_parameters: tuple[str, ...] = parameter(
        (), "What the user wrongly believes of the task, as name=value; the rest as it is."
    )
    trial: int = parameter(0, "Trials of practice that a human user has had.", ge=0, le=100000)
    recording: str = parameter("", "Forces of a replay user: an array (N, 3) [N] in a .npy file.")


class User(Protocol):
    """Acts on what it sees."""

    def act(self, tick: int, time: float, x: Array, task_mode: int | None = None) -> Array:
        """Force (3,) [N] for tick k at trial time k t_s [s], in the state (n,) and the mode of a hybrid task."""

    def reset(self, seed: int) -> None:
        """As new, for the trial with this seed."""


def names() -> tuple[str, ...]:
    """Names of the registered users."""
    return tuple(_REGISTRY)


def make(
    name: str,
    task: Task,
    seed: int = 0,
    *,
    robot: Robot | None = None,
    sample_time: float = SAMPLE_TIME,
    **options: Any,
) -> User:
    """The user of this name, who pushes at a robot; ``options`` are those of :class:`UserConfig`.

    Raises
    ------
    ParameterError: no such user or option, or a value that is refused.
    """
    if name not in _REGISTRY:
        near = difflib.get_close_matches(name, _REGISTRY, n=1)
        hint = f"did you mean {near[0]}?" if near else "known: " + ", ".join(_REGISTRY)
        raise ParameterError(f"user: {name!r} is not known; {hint}")
    return make_configured(task, build(UserConfig, {"user": name, **options}), robot or Robot(), seed, sample_time)


def make_configured(task: Task, config: UserConfig, robot: Robot, seed: int, sample_time: float = SAMPLE_TIME) -> User:
    """The user that a configuration names."""
    module, cls = _REGISTRY[config.user]
    user: User = getattr(importlib.import_module(f"{__name__}.{module}"), cls)(task, config, robot, seed, sample_time)
    return user
