"""Trials on a Dask cluster, and whom it is safe to ask.

Dask pickles jobs and results. Whoever answers at the scheduler's address, and whoever can reach a scheduler without
TLS, runs code here and on every worker; nothing in plain TCP says who that is. So a scheduler is asked on this machine,
with TLS, where both sides show a certificate, or where the caller says that everybody in the network may run code.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar
from urllib.parse import urlsplit

from rig_study.declared import StudyError

__all__ = ["check_address", "results"]

J = TypeVar("J")
R = TypeVar("R")

#: Where Dask looks for the three files that TLS needs; `tls:` under `distributed: comm:` in its YAML files is the same.
TLS_FILES = tuple(f"DASK_DISTRIBUTED__COMM__TLS__{name}" for name in ("CA_FILE", "CLIENT__CERT", "CLIENT__KEY"))


def check_address(address: str, *, trusted_network: bool = False) -> None:
    """Refuse a scheduler of which nobody can tell who it is.

    Parameters
    ----------
    address: ``tls://host:port``, or ``tcp://host:port`` with an address of this machine itself.
    trusted_network: take ``tcp://`` to any host.

    Raises
    ------
    StudyError: neither of these.
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise StudyError(f"scheduler {address!r}: {error}") from error
    if parts.scheme not in ("tcp", "tls") or not host or not port:
        raise StudyError(f"scheduler {address!r} is not allowed; it must be tcp://host:port or tls://host:port")
    if parts.scheme == "tcp" and not trusted_network and not _is_loopback(host):
        raise StudyError(
            f"scheduler {address!r} is not allowed: whoever is in the network between could run code here. Use tls://, "
            "or say --trusted-network if everybody who can reach it may do that"
        )


def _is_loopback(host: str) -> bool:
    # A name is not looked up: it may be another machine's by the time that Dask does.
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def results(
    work: Callable[[J], R], jobs: Mapping[str, J], address: str, *, trusted_network: bool = False
) -> Iterator[tuple[str, R]]:
    """Key and result of each job, in the order in which the workers of the scheduler finish them.

    Raises
    ------
    StudyError: as :func:`check_address`; or the scheduler cannot be reached.
    """
    check_address(address, trusted_network=trusted_network)
    # Imported here: who has no cluster need not wait for it.
    from distributed import Client, as_completed
    from distributed.security import Security

    security = Security()
    if address.startswith("tls:") and security.get_connection_args("client")["ssl_context"] is None:
        raise StudyError(f"scheduler {address!r} needs certificates: set {', '.join(TLS_FILES)}, each to a PEM file")
    try:
        client: Any = Client(address, security=security, timeout="30s")
    except (OSError, ValueError) as error:
        raise StudyError(f"scheduler {address!r} cannot be reached: {error}") from error
    with client:
        futures = client.map(work, list(jobs.values()), pure=False)
        key_of = {future.key: key for future, key in zip(futures, jobs, strict=True)}
        for future in as_completed(futures):
            yield key_of[future.key], future.result()
