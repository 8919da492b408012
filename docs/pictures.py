"""The pictures of the pages in docs/pages, in both themes: `./rig run python docs/pictures.py [FOLDER]`.

The whole graph runs, and the scripted person of the tests pushes; needs Chromium (apt install chromium).
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "bench")]

from browser import NO_BROWSER, browser_path, chromium  # noqa: E402
from live_display import LiveRig  # noqa: E402
from playwright.sync_api import Error  # noqa: E402

from mig_interfaces.msg import TrialState  # noqa: E402

PERSON = (ROOT / "tests" / "rig_display" / "person.js").read_text()


def shoot(page: Any, file: Path) -> None:
    """One page in both themes."""
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)
        page.wait_for_timeout(300)
        target = file.with_name(f"{file.name}_{theme}.png")
        page.screenshot(path=target)
        print(f"{target}  {target.stat().st_size / 1000:.0f} kB")
    page.emulate_media(color_scheme="light")


def begin(rig: LiveRig, browser: Any) -> tuple[Any, Any]:
    """The driver's page and the operator's, with a trial running."""
    driver = browser.new_page(viewport={"width": 1100, "height": 560})
    operator = browser.new_page(viewport={"width": 1280, "height": 860})
    driver.goto(rig.display.address)
    operator.goto(f"{rig.display.address}operator")
    driver.get_by_role("button", name="Take control").click()
    driver.get_by_role("button", name="Start").wait_for()
    operator.get_by_label("Subject").fill("S07")
    operator.get_by_label("Set").fill("first")
    operator.get_by_label("Trial", exact=True).fill("3")
    return driver, operator


def press(page: Any) -> None:
    """Press in the picture and keep hold, and note where."""
    page.evaluate(
        "document.getElementById('view').addEventListener('pointerdown', (event) =>"
        " (window.press = { id: event.pointerId, x: event.clientX, y: event.clientY }), { once: true })"
    )
    page.mouse.move(550, 330)
    page.mouse.down()


def cart_pendulum(browser: Any, out: Path, folder: Path) -> None:
    """Ready, in the middle of a swing, and stopped."""
    filtered: dict[str, Any] = {"/**": {"duration": 30.0}, "/**/mig_filter": {"mode": "assistance"}}
    with LiveRig(folder, **filtered) as rig:
        driver, operator = begin(rig, browser)
        shoot(driver, out / "driver_ready")
        operator.get_by_role("button", name="Driver sees verdicts").click()
        operator.get_by_role("button", name="Start").click()
        rig.until(lambda: rig.trials[-1].phase == TrialState.PHASE_RUNNING, driver)
        press(driver)
        driver.evaluate(f"({PERSON})(window.press)")
        rig.until(lambda: bool(rig.states) and rig.states[-1].time > 5.0, driver)
        shoot(driver, out / "driver")
        rig.until(lambda: rig.states[-1].time > 11.0, driver)
        shoot(operator, out / "operator")
        driver.keyboard.press("Escape")
        driver.get_by_text("Emergency stop, pressed by").wait_for()
        shoot(driver, out / "driver_stopped")


def slip(browser: Any, out: Path, folder: Path) -> None:
    """The other task, ready."""
    with LiveRig(folder, **{"/**": {"task": "slip", "duration": 30.0}}) as rig:
        driver, _ = begin(rig, browser)
        shoot(driver, out / "driver_slip")


def session(browser: Any, out: Path, folder: Path) -> None:
    """A study's session as its command runs it: before the first trial, and during it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "rig_bringup", "study", "run", "demo", "--subject", "S01", "--display"]
    command += ["--port", str(port), "--out", str(folder / "study")]
    environment = {**os.environ, "RIG_REALTIME": "off", "RIG_ROOT": str(ROOT)}
    led = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        driver = browser.new_page(viewport={"width": 1100, "height": 560})
        operator = browser.new_page(viewport={"width": 1280, "height": 860})
        for page, path in ((driver, ""), (operator, "operator")):
            page.set_default_timeout(120_000)
            _open(page, f"http://127.0.0.1:{port}/{path}", led)
        driver.get_by_role("button", name="Take control").click()
        driver.get_by_text("Swing the pendulum up").wait_for()
        shoot(driver, out / "session_driver")
        operator.locator("#resume:enabled").click()
        driver.get_by_text("of 30 s").wait_for()
        while float(driver.locator("#clock").inner_text()) < 2.0:
            driver.wait_for_timeout(100)
        press(driver)
        driver.mouse.move(620, 330)
        shoot(operator, out / "session_operator")
    finally:
        led.send_signal(signal.SIGINT)
        led.wait(60.0)


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
