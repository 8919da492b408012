"""A study's report in a browser: it is drawn, asks for nothing, and fits a wide window and a telephone's."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import NO_BROWSER, browser_path, chromium
from made_up_study import cohort

from rig_study.analyze_cli import main

pytestmark = pytest.mark.skipif(browser_path() is None, reason=NO_BROWSER)


def test_a_report_is_drawn_and_fits(tmp_path: Path) -> None:
    cohort(0.06).to_parquet(tmp_path / "trials.parquet")
    assert main([str(tmp_path / "trials.parquet"), "--out", str(tmp_path / "out")]) == 0
    with chromium() as browser:
        for width in (1280, 390):
            page = browser.new_page(viewport={"width": width, "height": 800})
            complaints: list[str] = []
            asked: list[str] = []
            page.on("console", lambda said, to=complaints: to.append(said.text))
            page.on("pageerror", lambda error, to=complaints: to.append(str(error)))
            page.on("request", lambda request, to=asked: to.append(request.url))
            page.goto(f"file://{tmp_path}/out/report.html")
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            for figure in page.locator("svg").all():
                box = figure.bounding_box()
                assert box["width"] > 0.5 * min(width, 600)
                assert box["x"] + box["width"] <= width
            assert page.locator("table").count() >= 6
            assert complaints == []
            assert len(asked) == 1
            page.screenshot(path=tmp_path / f"report_{width}.png", full_page=True)
