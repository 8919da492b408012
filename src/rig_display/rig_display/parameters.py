"""Parameters of the display."""

from __future__ import annotations

from dataclasses import dataclass

from shared_control.parameters import parameter

__all__ = ["TOKEN_LENGTH", "DisplayConfig"]

#: [characters] Least length of a token: what cannot be guessed over a network.
TOKEN_LENGTH = 16


@dataclass(frozen=True)
class DisplayConfig:
    """Where the page is served, who may use it, and what the hand may do."""

    host: str = parameter("127.0.0.1", "address to listen on; any but loopback needs a token")
    port: int = parameter(8600, "port to listen on; 0 takes a free one", ge=0, le=65535)
    token: str = parameter("", "what a browser must know; empty: that of the environment, RIG_DISPLAY_TOKEN")
    max_clients: int = parameter(32, "most pages that may be connected at a time", ge=1, le=1000)
    message_rate: float = parameter(
        400.0, "most messages of a page in a second; more close its connection", unit="1/s", ge=1.0, le=10000.0
    )
    stale_after: float = parameter(
        0.1, "a hand that has not been heard of for this long pushes nothing", unit="s", ge=0.02, le=5.0
    )
    force_limits: tuple[float, ...] = parameter(
        (), "largest force along x, y, z; empty: what the task's control limits amount to", unit="N", ge=0.0, le=10000.0
    )
    hand: str = parameter(
        "direct", "how the page begins: force by drag, or a spring to the hand", choices=("direct", "spring")
    )
    spring_stiffness: float = parameter(40.0, "of the spring to the hand", unit="N/m", ge=0.0, le=100000.0)
    spring_damping: float = parameter(9.0, "of the spring to the hand", unit="N s/m", ge=0.0, le=100000.0)
    feedback: bool = parameter(False, "show and feel the filter's verdicts on the driver's page", live=True)
    driver_starts: bool = parameter(
        True,
        "whether who drives may begin a trial, release the stop and clear faults; otherwise only an operator",
    )
    countdown: float = parameter(3.0, "from Start on the page to the trial", unit="s", ge=0.0, le=60.0)
