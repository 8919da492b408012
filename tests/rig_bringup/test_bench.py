"""`./rig bench`: which rows are chosen, what counts as slower, and that a row that fails spoils no other."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import compare
import figures
import native
import numpy as np
import pytest
import suite
from hypothesis import given
from hypothesis import strategies as st
from jitter import Wakes
from rows import BenchError, Row, alternate, percentile, spread, table


def row(*ratios: float, **changes: Any) -> Row:
    """A row with these ratios to its baseline."""
    made = Row("loop.p50", "a tick", "us", tuple(10.0 * r for r in ratios), "bare ring", (10.0,) * len(ratios))
    return replace(made, **changes)


def verdict(old: Row, new: Row, **how: bool) -> str:
    (change,) = compare.compare([[old]], [new], **how)
    return change.verdict


def count(*values: float) -> Row:
    """Missed deadlines of so many runs."""
    return Row("loop.missed", "ticks", "ticks", values, wanted="value <= 0", counted=True)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (row(1.0, 1.1, 1.2), row(1.0, 1.1, 1.2), "same"),
        (row(1.0, 1.1, 1.2), row(1.9, 2.0, 2.1), "slower"),
        (row(1.9, 2.0, 2.1), row(1.0, 1.1, 1.2), "faster"),
        # Steady before, noisy now, and the other way round: the larger spread counts.
        (row(1.0, 1.0, 1.0), row(0.8, 1.3, 2.0), "same"),
        (row(0.6, 1.0, 1.6), row(1.3, 1.3, 1.3), "same"),
        # What such a row moves by between quiet hours is no change, however steady it is within one.
        (row(1.0, 1.0, 1.0), row(1.49, 1.49, 1.49), "same"),
        (row(1.0, 1.0, 1.0), row(1.51, 1.51, 1.51), "slower"),
        (row(1.0, 1.0, 1.0, name="filter.evaluation"), row(1.1, 1.1, 1.1, name="filter.evaluation"), "same"),
        (row(1.0, 1.0, 1.0, name="filter.evaluation"), row(1.2, 1.2, 1.2, name="filter.evaluation"), "slower"),
        # A single run is judged by that alone.
        (row(1.0), row(1.4), "same"),
        (row(1.0), row(1.6), "slower"),
        # Counts: by their own square root, and by their sum over the runs.
        (count(10.0), count(18.0), "same"),
        (count(10.0), count(40.0), "slower"),
        (count(0.0, 0.0, 0.0), count(0.0, 9.0, 0.0), "slower"),
        (count(0.0), count(4.0, 4.0, 4.0), "slower"),
        # More is better: the same numbers the other way.
        (row(2.0, 2.0, 2.0, more_is_better=True), row(1.0, 1.0, 1.0, more_is_better=True), "slower"),
        # A machine that is slower as a whole makes nothing slower.
        (row(1.0, 1.1, 1.2), row(1.0, 1.1, 1.2, values=(30.0, 33.0, 36.0), baselines=(30.0,) * 3), "same"),
        # Without a baseline the values are compared.
        (row(1.0, 1.0, 1.0, baselines=()), row(2.0, 2.0, 2.0, baselines=()), "slower"),
        (row(1.0, 1.0, 1.0), row(1.0, 1.0, 1.0, unit="ms"), "is measured in another way than it was"),
        (row(1.0, 1.0, 1.0, name="loop.p99"), row(1.0, 1.0, 1.0), "is new"),
    ],
)
def test_what_is_slower(old: Row, new: Row, expected: str) -> None:
    assert verdict(old, new) == expected


_RATIOS = st.lists(st.floats(0.1, 10.0), min_size=3, max_size=5)


@given(_RATIOS, _RATIOS)
def test_slower_and_faster_are_opposites(old: list[float], new: list[float]) -> None:
    opposite = {"slower": "faster", "faster": "slower", "same": "same"}
    assert verdict(row(*new), row(*old)) == opposite[verdict(row(*old), row(*new))]


@given(_RATIOS)
def test_the_same_numbers_are_the_same(ratios: list[float]) -> None:
    assert verdict(row(*ratios), row(*reversed(ratios))) == "same"


def test_a_row_that_moves_from_file_to_file_is_no_slower_within_that() -> None:
    def judged(*medians: float) -> str:
        (change,) = compare.compare([[row(median, median, median)] for median in medians], [row(1.8, 1.8, 1.8)])
        return change.verdict

    assert judged(1.0) == "slower"
    assert judged(1.0, 1.9) == "same"
    # Three files say for themselves how little it moves.
    assert judged(1.6, 1.61, 1.62) == "slower"
    assert judged(1.6, 1.61) == "same"


def test_on_another_machine_only_ratios_are_judged() -> None:
    assert verdict(row(1.0), row(9.0), same_machine=False) == "slower"
    assert verdict(row(1.0, baselines=()), row(9.0, baselines=()), same_machine=False).startswith("not judged")
    assert verdict(count(0.0), count(99.0), same_machine=False).startswith("not judged")


def test_rows_that_a_measurement_no_longer_has_are_named() -> None:
    old = [row(1.0, name=name) for name in ("loop.lockstep.p50", "loop.lockstep.p99", "loop.100Hz.p50", "reader.read")]
    gone = compare.vanished([old, old], [old[0]], ["loop.lockstep", "loop.100"])
    assert [change.text() for change in gone] == ["loop.lockstep.p99: has vanished: it was measured then"]


def test_files_of_other_settings_or_machines_are_told_apart(tmp_path: Path) -> None:
    here = {"RIG_REALTIME": "off", "RIG_CPUS": "", "middleware": "m", "processor": "A", "processors usable": 2}
    old = compare.Bench(tmp_path / "old.json", (), here, {})
    assert compare.check_settings([old], here) == []
    with pytest.raises(BenchError, match=r"old\.json was measured with RIG_REALTIME=off, and now it is auto"):
        compare.check_settings([old], here | {"RIG_REALTIME": "auto"})
    (warning,) = compare.check_settings([old], here | {"processors usable": 8})
    assert "another machine (processors usable: 2, now 8)" in warning


def test_spread_and_percentile() -> None:
    assert spread([5.0]) == 0.0
    assert spread([1.0, 2.0, 3.0, 4.0, 5.0]) == 2.0
    assert percentile([3.0, 1.0, 2.0], 0.5) == 2.0
    assert percentile([3.0, 1.0, 2.0], 1.0) == 3.0


def test_runs_alternate() -> None:
    order: list[str] = []
    first, second = alternate(3, lambda: order.append("a") or "a", lambda: order.append("b") or "b")
    assert "".join(order) == "abbaab"
    assert (first, second) == (("a",) * 3, ("b",) * 3)


def test_wanted_figures() -> None:
    assert row(1.0, wanted="ratio <= 1.2").met is True
    assert row(1.3, wanted="ratio <= 1.2").met is False
    assert row(1.3, wanted="value >= 13").met is True
    assert row(1.3).met is None
    # A baseline of zero (no wake was late) gives no ratio.
    assert row(0.0, baselines=(0.0,), wanted="value < 0.1").met is True
    assert row(0.0, baselines=(0.0,)).ratio is None
    # Two of five runs that miss something are not forgotten.
    assert count(0.0, 0.0, 3.0, 2.0, 0.0).met is False
    assert count(0.0, 0.0, 0.0).met is True
    assert row(0.0, 0.0, 3.0, baselines=(), wanted="value <= 0").met is True
    with pytest.raises(ValueError, match="no wanted figure"):
        row(1.0, wanted="fast")
    with pytest.raises(ValueError, match="1 values beside 2"):
        row(1.0, baselines=(1.0, 2.0))
    assert table([row(1.3, wanted="ratio <= 1.2")]).endswith("ratio <= 1.2 NO")


def test_rows_are_chosen_by_beginnings() -> None:
    assert suite.select([], everything=True) == list(suite.MEASUREMENTS)
    assert suite.select([]) == [name for name, found in suite.MEASUREMENTS.items() if not found.long]
    assert suite.select(["loop"], everything=True) == [name for name in suite.MEASUREMENTS if name.startswith("loop.")]
    filters = ["filter.cart_pendulum", "filter.slip", "filter.laboratory", "filter.batch"]
    assert suite.select(["filter"]) == filters
    # What takes long is measured only by its own name.
    assert "loop.10min" not in suite.select(["loop"])
    assert suite.select(["loop.10min"]) == suite.select(["loop.10min.p99"]) == ["loop.10min"]
    assert suite.select(["timer.1kHz.p99", "loop.100"]) == ["timer", "loop.100Hz"]
    with pytest.raises(BenchError, match=r"no row begins with 'fitler'; there are filter\.cart_pendulum"):
        suite.select(["fitler"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fitler"], "no row begins with 'fitler'"),
        (["--runs", "0"], "at least one"),
        (["--out", "nowhere/bench.json"], "there is no such folder"),
        (["--compare", "nowhere.json"], "No such file"),
        (["--compare", __file__], "is no result of ./rig bench"),
        (["--table", "nowhere.json"], "No such file"),
        (["--into", "docs/performance.md"], "the table of which run"),
    ],
)
def test_bad_input_is_one_sentence(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert suite.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said


#: Measurements for the suite to run in their processes, quick ones.
_PROBE = """
import time
from rows import BenchError, NotHereError, Row, alternate


def rows(runs):
    values, bases = alternate(runs, time.perf_counter, time.perf_counter)
    return [Row("clock", "the time", "s", values, "the time", bases)]


def broken(runs):
    raise BenchError("no sensor is connected")


def needs(runs):
    raise NotHereError("no camera on this machine")


def dies(runs):
    import os

    os._exit(3)
"""


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "probe.py").write_text(_PROBE)
    monkeypatch.syspath_prepend(tmp_path)
    functions = {"broken": "broken", "dies": "dies", "needs": "needs", "clock": "rows"}
    measurements = {name: suite.Measurement(f"probe:{function}", 1, name) for name, function in functions.items()}
    monkeypatch.setattr(suite, "MEASUREMENTS", measurements)


@pytest.mark.usefixtures("probe")
def test_a_row_that_fails_says_why_and_spoils_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert suite.main(["--runs", "1", "--out", str(tmp_path / "bench.json")]) == 1
    said = capsys.readouterr()
    assert "error: broken: no sensor is connected" in said.err
    assert "error: dies: BrokenProcessPool" in said.err
    assert "not run: needs: no camera on this machine" in said.out
    written = compare.load(tmp_path / "bench.json")
    assert [row.name for row in written.rows] == ["clock"]
    assert len(written.rows[0].load) == 2


@pytest.mark.usefixtures("probe")
def test_what_this_machine_lacks_is_no_failure(tmp_path: Path) -> None:
    assert suite.main(["needs", "clock", "--runs", "1", "--out", str(tmp_path / "bench.json")]) == 0


def test_the_last_line_says_what_is_missed() -> None:
    def said(*rows: Row) -> str:
        return suite._last_line(suite.Results(list(rows)))

    good, bad = row(1.0, wanted="ratio <= 1.2"), row(1.3, wanted="ratio <= 1.2", name="loop.p99")
    assert said(row(1.0)) == "no figure is wanted of these rows"
    assert said(good, row(1.0)) == "all 1 wanted figures are met"
    assert said(good, bad) == "1 of 2 wanted figures missed: loop.p99"


@pytest.mark.usefixtures("probe")
def test_what_was_measured_is_written_read_and_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    assert suite.main(["clock", "--runs", "3", "--out", str(first)]) == 0
    (written,) = compare.load(first).rows
    assert len(written.values) == len(written.baselines) == 3
    body = json.loads(first.read_text())
    assert body["machine"]["versions"]["python"]
    # As if it had been a thousand times as fast then.
    body["rows"][0]["values"] = [1e-3 * value for value in written.values]
    first.write_text(json.dumps(body))
    assert suite.main(["clock", "--runs", "3", "--out", str(second), "--compare", str(first)]) == 1
    assert "clock: slower, 0.001 -> 1" in capsys.readouterr().out
    # Under other settings it would say nothing.
    first.write_text(json.dumps(body | {"machine": body["machine"] | {"RIG_REALTIME": "require"}}))
    assert suite.main(["clock", "--runs", "1", "--out", str(second), "--compare", str(first)]) == 2
    assert "was measured with RIG_REALTIME=require" in capsys.readouterr().err


@pytest.mark.usefixtures("probe")
def test_the_table_goes_between_the_marks_of_a_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, document = tmp_path / "bench.json", tmp_path / "performance.md"
    assert suite.main(["clock", "needs", "--runs", "3", "--out", str(results)]) == 0
    document.write_text(f"before\n{figures.BEGIN}\nold\n{figures.END}\nafter\n")
    assert suite.main(["--table", str(results), "--into", str(document)]) == 0
    text = document.read_text()
    assert text.startswith(f"before\n{figures.BEGIN}\nCommit ")
    assert text.endswith(f"{figures.END}\nafter\n")
    assert "| `clock` | the time |" in text
    assert "Not measured: `needs`: no camera on this machine" in text
    assert "old" not in text
    assert figures.markdown(compare.load(results)) in text
    document.write_text("no marks")
    assert suite.main(["--table", str(results), "--into", str(document)]) == 2
    assert "has no lines" in capsys.readouterr().err


def test_a_c_loop_that_is_refused_its_priority_says_so_and_runs() -> None:
    with native.program("wake") as wake:
        # There is no such priority, whoever asks.
        result = subprocess.run([str(wake), "1000", "3", "100"], capture_output=True, text=True, check=True)
    assert result.stderr == "no SCHED_FIFO 100: Invalid argument\n"
    wakes = Wakes(1e-6)
    wakes.take(result.stdout)
    assert (wakes.priority, len(wakes.late)) == (0, 3)


def test_a_compiler_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "/no/such/compiler")
    with pytest.raises(BenchError, match="/no/such/compiler cannot be run"), native.program("wake"):
        pass
    monkeypatch.setenv("CC", "false")
    with pytest.raises(BenchError, match=r"false cannot compile wake\.c"), native.program("wake"):
        pass


@given(
    stalls=st.lists(st.one_of(st.just(0.0), st.floats(0.0, 0.03)), min_size=1, max_size=60),
    begin=st.floats(-0.02, 0.08),
    length=st.floats(0.0, 0.02),
)
def test_a_loop_is_held_up_while_a_wake_up_is_overdue(stalls: list[float], begin: float, length: float) -> None:
    period, start, step = 1e-3, 5.0, 1e-5
    wakes = Wakes(period, start)
    woke = start
    for k, stall in enumerate(stalls, 1):
        # One that wakes late has missed those that were due meanwhile, and does them at once.
        woke = max(woke, start + period * k + stall)
        wakes.late.append(woke - (start + period * k))
    overdue = [(start + period * k, start + period * k + late) for k, late in enumerate(wakes.late, 1)]
    moments = start + begin + step * (np.arange(round(length / step)) + 0.5)
    seen = step * sum(any(due <= moment < until for due, until in overdue) for moment in moments)
    assert wakes.held_up(start + begin, start + begin + length) == pytest.approx(seen, abs=(2 * len(stalls) + 2) * step)


def test_a_loop_that_has_not_woken_was_held_up_by_nothing() -> None:
    assert Wakes(1e-3, 5.0).held_up(5.0, 6.0) == 0.0


def test_the_document_has_the_table_of_the_committed_file() -> None:
    docs = Path(__file__).parents[2] / "docs"
    said = (docs / "performance.md").read_text(encoding="utf-8")
    assert f"{figures.BEGIN}\n{figures.markdown(compare.load(docs / 'bench.json'))}\n{figures.END}\n" in said
