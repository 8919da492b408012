"""Runs of many trials: the same table for any number of workers, on Dask, and however often they stopped."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from rig_study import runs, sweep_cli
from rig_study.changes import apply
from rig_study.declared import StudyError
from rig_study.runs import Job, run
from rig_study.sweep import Sweep, load_sweep, montecarlo_jobs, sweep_jobs
from shared_control import scenario as science
from shared_control.parameters import ParameterError
from shared_control.trial import run_trial

FILE: dict[str, Any] = {
    "sweep": {"scenario": "cart_pendulum_noise_training", "trials": 2, "seed": 5},
    "parameters": {"mig_filter.horizon": [0.2, 0.4], "user_sim.noise_sd": [[5.0], [20.0]], "loop.duration": [0.5]},
}


def sweep(folder: Path, **parameters: Any) -> Sweep:
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump({**FILE, "parameters": parameters or FILE["parameters"]}, sort_keys=False))
    return load_sweep(path)


def text(rows: list[dict[str, Any]]) -> str:
    return json.dumps(rows)  # NaN is not equal to itself, its text is.


def test_a_row_is_the_trial(tmp_path: Path) -> None:
    jobs = sweep_jobs(sweep(tmp_path))
    assert [job.labels["mig_filter.horizon"] for job in jobs] == [0.2] * 4 + [0.4] * 4
    assert [job.seed for job in jobs] == [5, 6] * 4
    row = run(jobs[2:3], tmp_path / "run", workers=1)[0]
    changes = {"mig_filter.horizon": 0.2, "user_sim.noise_sd": [20.0], "loop.duration": 0.5}
    alone = run_trial(apply(science.load("cart_pendulum_noise_training"), changes, "here"), 5)
    assert row["rms_error"] == alone.measures.rms_error
    assert row["pra_trial"] == alone.measures.pra_trial
    assert row["user_sim.noise_sd"] == "[20.0]"


def test_any_number_of_workers_and_a_cluster_give_the_same(tmp_path: Path) -> None:
    import distributed

    jobs = sweep_jobs(sweep(tmp_path))
    one = run(jobs, tmp_path / "one", workers=1)
    assert text(run(jobs, tmp_path / "two", workers=2)) == text(one)
    # Workers in threads, but over sockets: jobs and rows are serialised, and no interpreter has to start.
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None
    ) as cluster:
        assert text(run(jobs, tmp_path / "cluster", scheduler=cluster.scheduler_address)) == text(one)
    tables = [runs.write_table(run(jobs, tmp_path / name), tmp_path / f"{name}.parquet") for name in ("one", "cluster")]
    assert tables[0].read_bytes() == tables[1].read_bytes()


def test_a_run_goes_on_where_it_was_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = montecarlo_jobs_short(4)
    whole = run(jobs, tmp_path / "whole", workers=1)
    folder = tmp_path / "killed"

    class KilledError(Exception):
        pass

    def killed(done: int, total: int, there: int) -> None:
        if done == 2:
            raise KilledError

    with pytest.raises(KilledError):
        run(jobs, folder, workers=1, report=killed)
    journal = folder / "journal.jsonl"
    assert len(journal.read_bytes().splitlines()) == 2
    # As a kill in the middle of a line leaves it.
    journal.write_bytes(journal.read_bytes() + b'{"key": "t00000')
    ran: list[str] = []
    original = runs.run_job

    def watched(job: Job) -> dict[str, Any]:
        ran.append(job.name)
        return original(job)

    monkeypatch.setattr(runs, "run_job", watched)
    assert text(run(jobs, folder, workers=1)) == text(whole)
    assert [name[-7:] for name in ran] == ["t000002", "t000003"]
    assert text(run(jobs, folder, workers=1)) == text(whole)
    assert len(ran) == 2


def montecarlo_jobs_short(count: int, **changes: Any) -> list[Job]:
    scenario = apply(science.load("cart_pendulum_noise_training"), {"loop.duration": 0.3, **changes}, "here")
    jobs = montecarlo_jobs("cart_pendulum_noise_training", count, 7, 10)
    return [Job(job.name, scenario, job.seed, job.labels, job.trace) for job in jobs]


def test_what_a_result_depends_on_is_in_its_key(tmp_path: Path) -> None:
    (job,) = montecarlo_jobs_short(1)
    (other,) = montecarlo_jobs_short(1, **{"user_sim.noise_sd": [5.0]})
    assert job.key == montecarlo_jobs_short(1)[0].key
    assert len({job.key, other.key, Job(job.name, job.scenario, 8, job.labels, 10).key}) == 3
    first = run([job], tmp_path, workers=1)
    assert run([other], tmp_path, workers=1) != first
    assert run([job], tmp_path, workers=1) == first


def test_a_result_of_other_code_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (job,) = montecarlo_jobs_short(1)
    run([job], tmp_path, workers=1)
    before = job.key
    monkeypatch.setattr(runs, "science", lambda: "as it was edited")
    assert job.key != before
    run([job], tmp_path, workers=1)
    assert len((tmp_path / "journal.jsonl").read_bytes().splitlines()) == 2


def test_a_list_of_grids_is_one_after_the_other(tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    grids = [{"mig_filter.mode": ["off"]}, {"mig_filter.mode": ["training"], "mig_filter.judge": ["mig", "random"]}]
    path.write_text(yaml.safe_dump({**FILE, "parameters": grids}))
    points = [dict(changes) for changes, _ in load_sweep(path).points]
    assert points == [
        {"mig_filter.mode": "off"},
        {"mig_filter.mode": "training", "mig_filter.judge": "mig"},
        {"mig_filter.mode": "training", "mig_filter.judge": "random"},
    ]
    for empty in ([], [{}], {}):
        path.write_text(yaml.safe_dump({**FILE, "parameters": empty}))
        with pytest.raises(StudyError, match="at least one is needed"):
            load_sweep(path)


def test_every_shipped_sweep_is_allowed() -> None:
    files = sorted((Path(__file__).parents[2] / "config" / "sweeps").glob("*.yaml"))
    assert len(files) > 10
    for file in files:
        sweep = load_sweep(file)
        assert len({job.key for job in sweep_jobs(sweep)}) == len(sweep.points) * sweep.config.trials


def test_a_trace_is_the_state_now_and_then(tmp_path: Path) -> None:
    (job,) = montecarlo_jobs_short(1)
    (row,) = run([job], tmp_path, workers=1)
    assert row["trace.theta"] == run_trial(job.scenario, job.seed).states[::10, 0].tolist()
    assert row["trace_step"] == pytest.approx(0.1)


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sweep(tmp_path)
    assert sweep_cli.sweep([str(tmp_path / "sweep.yaml"), "--out", str(tmp_path / "out"), "--workers", "1"]) == 0
    assert "8 trials" in capsys.readouterr().out
    assert (tmp_path / "out" / "trials.parquet").exists()
    assert sweep_cli.montecarlo(["nowhere", "--out", str(tmp_path / "x")]) == 2
    assert "scenario 'nowhere' not found" in capsys.readouterr().err
    assert sweep_cli.montecarlo(["cart_pendulum_noise_off", "--trials", "0", "--out", str(tmp_path / "x")]) == 2
    assert "must be at least 1" in capsys.readouterr().err


def test_a_sweep_that_is_not_allowed_is_one_sentence(tmp_path: Path) -> None:
    for parameters, says in (
        ({"mig_filter.horizn": [1.0]}, "unknown parameter horizn = 1.0; did you mean horizon"),
        ({"mig_filter.horizon": [1.0, -1.0]}, "horizon: -1.0 is not allowed; it must be float from 0.001 to 60"),
        ({"filter.horizon": [1.0]}, "write NODE.KEY with NODE one of mig_filter"),
        ({"mig_filter.horizon": 1.0}, "must be a list of values"),
        ({"user_sim.noise_sd": [[1.0, 2.0]]}, "cart_pendulum has 1 controls"),
    ):
        with pytest.raises(ParameterError, match=says):
            sweep(tmp_path, **parameters)
    job = montecarlo_jobs_short(1)[0]
    with pytest.raises(StudyError, match="same name"):
        run([job, job], tmp_path / "twice")
