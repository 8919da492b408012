"""What a bag knows of its trial: the contents of ``mig_interfaces/msg/TrialState``, without ROS."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from typing import Any

__all__ = ["TRIAL_TYPE", "Trial"]

TRIAL_TYPE = "mig_interfaces/msg/TrialState"

_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Trial:
    """One state of a trial. Times in nanoseconds; fields as in ``mig_interfaces/msg/TrialState``."""

    uid: int
    phase: int
    stamp: int
    epoch: int
    sample_time: int
    ticks_planned: int
    ticks_published: int
    missed_deadlines: int
    outcome: int
    pacing: int
    subject: str
    group: str
    set: str
    trial: int
    scenario: str
    configuration_hash: str
    seed: int
    task: str
    message: str
    state_names: tuple[str, ...] = ()
    state_units: tuple[str, ...] = ()
    control_names: tuple[str, ...] = ()
    control_units: tuple[str, ...] = ()
    attempt: int = 0

    IDLE, ARMING, RUNNING, FINISHED, ABORTED = range(5)

    @classmethod
    def from_message(cls, message: Any) -> Trial:
        """Take over a TrialState message, decoded by whatever means; an older bag's may lack what has a default."""
        values: dict[str, Any] = {}
        for name, field in cls.__dataclass_fields__.items():
            if name == "stamp":
                value: Any = message.header.stamp
            elif field.default is MISSING:
                value = getattr(message, name)
            else:
                value = getattr(message, name, field.default)
            if name in ("stamp", "epoch", "sample_time"):
                value = value.sec * _SECOND + value.nanosec
            elif name.endswith(("_names", "_units")):
                value = tuple(value)
            values[name] = value
        return cls(**values)

    @property
    def under_way(self) -> bool:
        return self.phase in (self.ARMING, self.RUNNING)

    @property
    def ended(self) -> bool:
        return self.phase in (self.FINISHED, self.ABORTED)

    @property
    def last_tick(self) -> int:
        """Stamp of the last tick published; before the epoch if none was."""
        return self.epoch + (self.ticks_published - 1) * self.sample_time

    def custom_data(self) -> dict[str, str]:
        """What of it ``metadata.yaml`` carries."""
        return {
            key: value
            for key, value in self.strings().items()
            if key not in ("uid", "stamp", "message", "epoch") and not key.endswith(("_names", "_units"))
        }

    def strings(self) -> dict[str, str]:
        """The trial as a map of strings, for metadata."""
        result = {}
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            result[name] = ",".join(value) if isinstance(value, tuple) else str(value)
        result["phase"] = _word(self.phase, "idle", "arming", "running", "finished", "aborted")
        result["pacing"] = _word(self.pacing, "realtime", "lockstep")
        return result


def _word(number: int, *words: str) -> str:
    """Of a number that has none, which a damaged or a foreign message may hold, the number."""
    return words[number] if number < len(words) else str(number)
