"""One pacemaker for each namespace and domain of a machine.

Two graphs under the same names would answer each other's ticks: a robot would follow either's filter. Nothing but
Python is needed here: `./rig up` asks before it starts anything.
"""

from __future__ import annotations

import socket

__all__ = ["Claim", "ClaimError"]


class ClaimError(Exception):
    """Somebody paces there already; the message says what to do."""


class Claim:
    """The right to pace a namespace, for as long as this object is not closed and the process lives.

    A name among the kernel's abstract sockets: nothing stays behind, however the process ends.

    Parameters
    ----------
    domain: ROS domain id.
    namespace: with or without its slash.

    Raises
    ------
    ClaimError: another process of this machine has it.
    """

    def __init__(self, domain: int, namespace: str) -> None:
        name = namespace.strip("/")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.bind(f"\0shared_control_rig/pacemaker/{domain}/{name}")
        except OSError:
            self._socket.close()
            raise ClaimError(
                f"another graph paces /{name} on domain {domain} of this machine; end it, or use another namespace "
                "(--namespace) or ROS_DOMAIN_ID"
            ) from None

    def close(self) -> None:
        """Let somebody else have it. Idempotent."""
        self._socket.close()
