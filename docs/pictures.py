"""The pictures of the pages in docs/pages, in both themes: `./rig run python docs/pictures.py [FOLDER]`.

The commands run as they do for anybody, and the scripted person of the tests pushes; needs Chromium (apt install
chromium).
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "bench")]

from browser import NO_BROWSER, browser_path, chromium  # noqa: E402
from playwright.sync_api import Error  # noqa: E402

from rig_study.protocol import load_protocol  # noqa: E402
from rig_study.session import Session  # noqa: E402

PERSON = (ROOT / "tests" / "rig_display" / "person.js").read_text()

_DRIVER = {"width": 1100, "height": 560}
_OPERATOR = {"width": 1280, "height": 960}


def shoot(page: Any, file: Path) -> None:
    """One page in both themes."""
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)
        page.wait_for_timeout(300)
        target = file.with_name(f"{file.name}_{theme}.png")
        page.screenshot(path=target)
        print(f"{target}  {target.stat().st_size / 1000:.0f} kB")
    page.emulate_media(color_scheme="light")


@contextmanager
def pages(browser: Any, *command: str) -> Iterator[tuple[Any, Any]]:
    """The driver's page, in control, and the operator's, of a command that runs meanwhile."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = {**os.environ, "RIG_ROOT": str(ROOT)}
    words = [sys.executable, "-m", "rig_bringup", *command, "--display", "--port", str(port)]
    rig = subprocess.Popen(words, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        driver, operator = browser.new_page(viewport=_DRIVER), browser.new_page(viewport=_OPERATOR)
        for page, path in ((driver, ""), (operator, "operator")):
            page.set_default_timeout(120_000)
            _open(page, f"http://127.0.0.1:{port}/{path}", rig)
        driver.get_by_role("button", name="Take control").click()
        driver.get_by_role("button", name="Leave the seat").wait_for()
        yield driver, operator
        for page in (driver, operator):
            page.close()
    finally:
        rig.send_signal(signal.SIGINT)
        rig.wait(60.0)


def _open(page: Any, address: str, served_by: subprocess.Popen[bytes]) -> None:
    """Go there as soon as somebody serves it."""
    end = time.monotonic() + 120.0
    while True:
        try:
            page.goto(address)
            return
        except Error:
            if served_by.poll() is not None or time.monotonic() > end:
                raise
            page.wait_for_timeout(200)


def press(page: Any) -> None:
    """Press in the picture and keep hold, and note where."""
    page.evaluate(
        "document.getElementById('view').addEventListener('pointerdown', (event) =>"
        " (window.press = { id: event.pointerId, x: event.clientX, y: event.clientY }), { once: true })"
    )
    page.mouse.move(550, 330)
    page.mouse.down()


def until(page: Any, seconds: float) -> None:
    """Wait for a time of the trial, and then until the hand is in force: a busy machine makes it fall silent."""
    clock, how = page.locator("#clock"), page.locator("#how")
    while float(clock.inner_text()) < seconds or "warn" in how.get_attribute("class"):
        page.wait_for_timeout(50)


def cart_pendulum(browser: Any, out: Path, folder: Path) -> None:
    """Ready, in the middle of a swing, and stopped."""
    command = ("up", "cart_pendulum_noise_assistance", "--no-report", "--out", str(folder / "cart"))
    with pages(browser, *command) as (driver, operator):
        driver.get_by_role("button", name="Start").wait_for()
        shoot(driver, out / "driver_ready")
        for label, text in (("Subject", "S07"), ("Set", "first"), ("Trial", "3")):
            operator.get_by_label(label, exact=True).and_(operator.locator("input")).fill(text)
        operator.get_by_role("button", name="Driver sees verdicts").click()
        operator.get_by_role("button", name="Start").click()
        until(driver, 0.1)
        press(driver)
        driver.evaluate(f"({PERSON})(window.press)")
        until(driver, 5.0)
        shoot(driver, out / "driver")
        until(driver, 11.0)
        shoot(operator, out / "operator")
        driver.keyboard.press("Escape")
        driver.get_by_text("Emergency stop, pressed by").wait_for()
        shoot(driver, out / "driver_stopped")


def slip(browser: Any, out: Path, folder: Path) -> None:
    """The other task, ready."""
    command = ("up", "slip_noise_assistance", "--no-report", "--out", str(folder / "slip"))
    with pages(browser, *command) as (driver, _):
        driver.get_by_role("button", name="Start").wait_for()
        shoot(driver, out / "driver_slip")


def session(browser: Any, out: Path, folder: Path) -> None:
    """A study's sessions: the choice, before the first trial, and during it."""
    _do("S02", 3, folder / "study")
    with pages(browser, "study", "run", "--out", str(folder / "study")) as (driver, operator):
        driver.get_by_text("Your session begins soon").wait_for()
        operator.locator("#protocol").select_option("demo")
        operator.locator("#person").select_option("S02")
        shoot(operator, out / "session_choice")
        operator.locator("#person").select_option("S01")
        operator.get_by_role("button", name="Begin").click()
        driver.get_by_text("Swing the pendulum up").wait_for()
        shoot(driver, out / "session_driver")
        operator.locator("#resume:enabled").click()
        until(driver, 2.0)
        press(driver)
        driver.mouse.move(600, 330)
        until(driver, 2.5)
        shoot(operator, out / "session_operator")


def _do(subject: str, trials: int, folder: Path) -> None:
    """Have a subject of the demonstration done some trials already."""
    with Session(load_protocol("demo"), subject, folder / "study_demo" / subject) as done:
        for _ in range(trials):
            trial = done.progress.next()
            assert trial is not None
            done.start(trial)
            done.finish(trial, "")


def main() -> int:
    """All of them."""
    if browser_path() is None:
        print(f"error: {NO_BROWSER}", file=sys.stderr)
        return 1
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pages"
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        cart_pendulum(browser, out, Path(folder))
        slip(browser, out, Path(folder))
        session(browser, out, Path(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
