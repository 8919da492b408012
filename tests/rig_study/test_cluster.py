"""Which Dask scheduler is asked, and that one with TLS is asked with TLS alone."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rig_study import sweep_cli
from rig_study.cluster import TLS_FILES, check_address, results
from rig_study.declared import StudyError
from rig_study.runs import run
from rig_study.sweep import montecarlo_jobs


@pytest.mark.parametrize(
    "address",
    ["tcp://127.0.0.1:8786", "tcp://127.1.2.3:1", "tcp://[::1]:8786", "tcp://localhost:8786", "tls://10.0.0.7:8786"],
)
def test_this_machine_and_tls_are_asked(address: str) -> None:
    check_address(address)


@pytest.mark.parametrize(
    "address",
    ["tcp://10.0.0.7:8786", "tcp://cluster:8786", "tcp://0.0.0.0:8786", "tcp://localhost.example:1", "tcp://[fe80::1]:1",
     "tcp://127.0.0.1.example:1"],
)  # fmt: skip
def test_another_machine_without_tls_only_in_a_trusted_network(address: str) -> None:
    with pytest.raises(StudyError, match=r"could run code here.*tls://.*--trusted-network"):
        check_address(address)
    check_address(address, trusted_network=True)


@pytest.mark.parametrize(
    "address",
    ["", "127.0.0.1:8786", "localhost:8786", "tcp://127.0.0.1", "tcp://:8786", "tcp://127.0.0.1:x", "ws://127.0.0.1:1",
     "tcp://127.0.0.1:99999999", "inproc://1/2/3", "tcp://[::1:3"],
)  # fmt: skip
@pytest.mark.parametrize("trusted", [False, True])
def test_what_is_no_address_is_refused_in_words(address: str, trusted: bool) -> None:
    with pytest.raises(StudyError, match=r"scheduler '.*'"):
        check_address(address, trusted_network=trusted)


def test_the_command_refuses_before_anything_is_sent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["cart_pendulum_noise_training", "--trials", "1", "--out", str(tmp_path), "--scheduler", "tcp://10.0.0.7:1"]
    assert sweep_cli.montecarlo(line) == 2
    assert "error: scheduler 'tcp://10.0.0.7:1' is not allowed" in capsys.readouterr().err


def _authority(folder: Path) -> dict[str, str]:
    """Certificates of an authority of its own, as Dask's configuration names them."""
    folder.mkdir()
    options = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2", "-subj", "/CN=rig"]
    subprocess.run(
        ["openssl", "req", "-x509", *options, "-keyout", folder / "key.pem", "-out", folder / "cert.pem"],
        check=True,
        capture_output=True,
    )
    # A certificate that signed itself is its own authority.
    return dict(zip(TLS_FILES, [str(folder / name) for name in ("cert.pem", "cert.pem", "key.pem")], strict=True))


@pytest.fixture
def trusting(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[dict[str, str]], None]]:
    """Has Dask read its configuration anew with these in the environment."""
    import dask

    def trust(files: dict[str, str]) -> None:
        for name, value in files.items():
            monkeypatch.setenv(name, value)
        dask.config.refresh()

    yield trust
    monkeypatch.undo()
    dask.config.refresh()


@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes its certificates with openssl, which is not here")
def test_a_scheduler_with_tls_gives_the_same_and_no_other_certificate_will_do(
    tmp_path: Path, trusting: Callable[[dict[str, str]], None]
) -> None:
    import distributed
    from distributed.security import Security

    ours = _authority(tmp_path / "ours")
    ca, cert, key = ours.values()
    names = ("scheduler", "worker", "client")
    files = {f"tls_{name}_{kind}": file for name in names for kind, file in (("cert", cert), ("key", key))}
    security = Security(tls_ca_file=ca, require_encryption=True, **files)
    jobs = montecarlo_jobs("cart_pendulum_noise_training", 2, 0, 0)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tls", security=security, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        with pytest.raises(StudyError, match=r"needs certificates: set DASK_.*CA_FILE"):
            list(results(str, {"a": 1}, address))
        trusting(ours)
        assert dict(results(str, {"a": 1, "b": 2}, address)) == {"a": "1", "b": "2"}
        assert json.dumps(run(jobs, tmp_path / "cluster", scheduler=address)) == json.dumps(
            run(jobs, tmp_path / "one", workers=1)
        )
        trusting(_authority(tmp_path / "others"))
        with pytest.raises(StudyError, match="cannot be reached"):
            list(results(str, {"a": 1}, address))
