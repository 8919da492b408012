"""Parameters of the pacemaker that have no meaning without a graph."""

from __future__ import annotations

from dataclasses import dataclass

from shared_control.parameters import parameter


@dataclass(frozen=True)
class PacemakerConfig:
    """How trials are begun, waited for and named."""

    autostart: bool = parameter(True, "begin a trial as soon as the node is up, without a call of trial/start")
    required_nodes: tuple[str, ...] = parameter(
        ("user_sim", "mig_filter", "admittance_sim"),
        "names, in this namespace, of the nodes without which no trial starts",
    )
    ready_timeout: float = parameter(
        0.0, "give up arming a trial after this time; 0 waits for ever, saying what for", unit="s", ge=0.0
    )
    lockstep_timeout: float = parameter(
        10.0, "abort lockstep that has stood still for this long, naming the node it waits for", unit="s", ge=0.1
    )
    view_rate: float = parameter(
        25.0,
        "how often task/markers and task/joint_states are published in real time, at most once a tick; 0: not at all",
        unit="Hz",
        ge=0.0,
        le=1000.0,
    )
    scenario: str = parameter("", "name of the scenario, recorded with the trial")
    configuration_hash: str = parameter("", "SHA-256 of the configuration, recorded with the trial")
    subject: str = parameter("", "who pushes, recorded with the trial")
    group: str = parameter("", "group of the study, recorded with the trial")
    set: str = parameter("", "set of the study, recorded with the trial")
    trial: int = parameter(0, "number of the trial in its set, recorded with it", ge=0)
