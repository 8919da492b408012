"""The arithmetic of ``ros2 topic hz`` and ``bw``, and of parameter files; no graph."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ros2_fallback.command import CommandError
from ros2_fallback.param import values_for
from ros2_fallback.topic_rate import Bandwidth, Rate

MS = 1_000_000


def test_rate_form_and_value() -> None:
    rate = Rate(window=10000)
    assert rate.report() is None
    reports = []
    for tick in range(102):
        rate.add(tick * 10 * MS)
        reports.append(rate.report())
    assert [i for i, text in enumerate(reports) if text] == [101]
    assert reports[-1] == "average rate: 100.000\n\tmin: 0.010s max: 0.010s std dev: 0.00000s window: 101"
    assert rate.report() is None, "not twice for the same messages"


def test_rate_window_forgets() -> None:
    rate = Rate(window=4)
    for stamp in [0, 10, 2000, 2100, 2200, 2300, 2400]:
        rate.add(stamp * MS)
    rate.report()
    for stamp in range(2500, 3500, 100):
        rate.add(stamp * MS)
    assert rate.report() == "average rate: 10.000\n\tmin: 0.100s max: 0.100s std dev: 0.00000s window: 4"


@given(st.lists(st.integers(1, 10**9), min_size=2, max_size=50))
def test_rate_is_messages_over_time(intervals: list[int]) -> None:
    rate = Rate(window=1000)
    stamp = 0
    rate.add(stamp)
    rate.add(stamp := stamp + 1)
    rate.report()
    for interval in [*intervals, 10**9]:
        rate.add(stamp := stamp + interval)
    text = rate.report()
    assert text is not None
    count = len(intervals) + 2
    assert f"average rate: {count / stamp * 1e9:.3f}" in text
    assert text.endswith(f"window: {count}")


def test_rate_starts_afresh_when_the_clock_goes_back() -> None:
    rate = Rate(window=100)
    for stamp in (0, 1000, 2000, 100, 200):
        rate.add(stamp * MS)
    assert rate.report() is None
    for stamp in range(300, 1400, 100):
        rate.add(stamp * MS)
    assert rate.report() == "average rate: 10.000\n\tmin: 0.100s max: 0.100s std dev: 0.00000s window: 12"


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (100, "200 B/s from 4 messages\n\tMessage size mean: 100 B min: 100 B max: 100 B"),
        (1500, "3.00 KB/s from 4 messages\n\tMessage size mean: 1.50 KB min: 1.50 KB max: 1.50 KB"),
        (2_500_000, "5.00 MB/s from 4 messages\n\tMessage size mean: 2.50 MB min: 2.50 MB max: 2.50 MB"),
    ],
)
def test_bandwidth(size: int, text: str) -> None:
    bandwidth = Bandwidth(window=4)
    bandwidth.add(0, 10**9)
    assert bandwidth.report(1) is None
    for stamp in (0, 500, 1000, 1500):
        bandwidth.add(stamp * MS, size)
    assert bandwidth.report(2000 * MS) == text


def test_parameter_file_sections() -> None:
    def section(**values: object) -> dict[str, object]:
        return {"ros__parameters": values}

    sections = {
        "/**": section(a=1, nested={"b": 2}),
        "/rig/demo": section(a=3),
        "/**/demo": section(c=4),
        "/*/demo": section(d=5),
        "other": section(e=6),
        "/*": section(f=7),
    }
    assert values_for("/rig/demo", sections) == {"a": 3, "nested.b": 2, "c": 4, "d": 5}
    assert values_for("/rig/demo", sections, use_wildcard=False) == {"a": 3, "c": 4, "d": 5}
    assert values_for("/other", sections)["e"] == 6
    with pytest.raises(CommandError, match=r"no section for /a/b .*demo"):
        values_for("/a/b", sections, use_wildcard=False)
    for wrong in (None, [], {"/demo": 3}, {"/demo": {"a": 1}}):
        with pytest.raises(CommandError):
            values_for("/demo", wrong)
