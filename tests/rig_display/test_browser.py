"""The page in a browser, against the real graph: it shows what happens, and the hand on it is the force sensor.

One browser and one trial for all of them, in the order in which they stand here.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import pytest
from live_display import NO_BROWSER, LiveRig, browser_path, chromium

from mig_interfaces.msg import TrialState

pytestmark = [pytest.mark.skipif(browser_path() is None, reason=NO_BROWSER), pytest.mark.timeout(900)]


class Screen:
    """The driver's page and the operator's, and what went wrong on them."""

    def __init__(self, rig: LiveRig, browser: Any) -> None:
        self.rig = rig
        self.context = browser.new_context(viewport={"width": 640, "height": 400}, device_scale_factor=1.5)
        self.context.set_default_timeout(120_000)
        self.complaints: list[str] = []
        self.asked: set[str] = set()
        self.driver = self.open("")
        self.operator = self.open("operator")

    def open(self, path: str) -> Any:
        """One more page."""
        page = self.context.new_page()
        page.on("console", lambda message: self.complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.asked.add(request.url))
        page.goto(self.rig.display.address + path)
        return page

    def until(self, condition: Any) -> None:
        """Wait for it."""
        self.rig.until(condition, self.driver)

    def drag(self, share: float) -> float:
        """Press in the middle of the driver's view and drag so far to the limit; return the force [N] that is meant."""
        box = self.driver.locator("#view").bounding_box()
        x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.6 * box["height"]
        dx = round(share * 0.24 * min(box["width"], box["height"]))
        self.driver.mouse.move(x, y)
        self.driver.mouse.down()
        self.driver.mouse.move(x + dx, y, steps=4)
        return 40.0 * dx / (0.24 * min(box["width"], box["height"]))


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """Everything, once."""
    with LiveRig(tmp_path_factory.mktemp("live")) as rig, chromium() as browser:
        yield Screen(rig, browser)


def test_a_person_takes_control_and_starts_and_sees_it_move(screen: Screen) -> None:
    page = screen.driver
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Start").click()
    screen.until(lambda: screen.rig.trials[-1].phase == TrialState.PHASE_RUNNING)
    pixels = "document.getElementById('view').toDataURL()"
    page.keyboard.down("ArrowRight")
    screen.until(lambda: screen.rig.force == 20.0)
    before = page.evaluate(pixels)
    screen.until(lambda: page.evaluate(pixels) != before)
    page.keyboard.up("ArrowRight")
    screen.until(lambda: screen.rig.force == 0.0)
    # Sharp: as many pixels as the screen has.
    assert page.evaluate("document.getElementById('view').width") == 960


def test_a_drag_arrives_as_the_right_force(screen: Screen) -> None:
    expected = screen.drag(0.7)
    assert 10.0 < expected < 40.0
    screen.until(lambda: screen.rig.force == pytest.approx(expected, rel=0.01))
    screen.driver.mouse.move(0, 400)
    screen.until(lambda: screen.rig.force == -40.0)
    screen.driver.mouse.up()
    screen.until(lambda: screen.rig.force == 0.0)
    spread = screen.rig.display.latency.spread()
    assert spread.count > 4
    assert spread.p50 > 0.0


def test_the_operator_sets_the_filter_and_the_verdicts_are_shown(screen: Screen) -> None:
    screen.operator.get_by_role("button", name="Training").click()
    screen.until(lambda: screen.rig.display.feed.mode == "training")
    screen.operator.get_by_role("button", name="Driver sees verdicts").click()
    screen.until(lambda: screen.driver.locator("#how").get_attribute("class").split()[1:] == ["accepted"])
    screen.drag(-0.9)
    # To and fro: one of the two is bad wherever the pendulum is.
    places = itertools.cycle((620, 20))

    def rejected() -> bool:
        screen.driver.mouse.move(next(places), 200)
        return "rejected" in str(screen.driver.locator("#how").inner_text())

    screen.until(rejected)
    screen.driver.mouse.up()
    screen.operator.get_by_role("button", name="Driver sees verdicts").click()
    screen.operator.get_by_role("button", name="Off").click()
    screen.until(lambda: screen.rig.display.feed.mode == "off")


def test_a_hidden_page_pushes_nothing(screen: Screen) -> None:
    screen.drag(0.7)
    screen.until(lambda: screen.rig.force > 10.0)
    # What a browser does when the tab goes to the background; headless it shows all tabs at once.
    screen.driver.evaluate(
        "Object.defineProperty(document, 'hidden', { value: true, configurable: true });"
        "document.dispatchEvent(new Event('visibilitychange'))"
    )
    screen.until(lambda: screen.rig.force == 0.0)
    screen.until(lambda: "hidden" in screen.operator.locator("#link").inner_text())
    screen.driver.evaluate("delete document.hidden; document.dispatchEvent(new Event('visibilitychange'))")
    screen.driver.mouse.up()
    screen.drag(0.5)
    screen.until(lambda: screen.rig.force > 5.0)
    screen.driver.evaluate("window.dispatchEvent(new Event('blur'))")
    screen.until(lambda: screen.rig.force == 0.0)
    screen.driver.mouse.up()


def test_the_emergency_stop_holds(screen: Screen) -> None:
    screen.drag(0.7)
    screen.until(lambda: screen.rig.force > 10.0)
    screen.driver.keyboard.press("Escape")
    screen.until(lambda: screen.rig.force == 0.0)
    screen.driver.get_by_text("Emergency stop, pressed by").wait_for()
    ticks = len(screen.rig.wrenches)
    screen.until(lambda: len(screen.rig.wrenches) > ticks + 50)
    assert {wrench.wrench.force.x for wrench in screen.rig.wrenches[ticks:]} == {0.0}
    screen.operator.get_by_role("button", name="Release").click()
    screen.until(lambda: "let go" in screen.operator.locator("#link").inner_text())
    assert screen.rig.force == 0.0
    screen.driver.mouse.up()
    screen.drag(0.7)
    screen.until(lambda: screen.rig.force > 10.0)
    screen.driver.mouse.up()


def test_a_second_person_watches(screen: Screen) -> None:
    other = screen.open("")
    screen.until(lambda: screen.rig.display.seat.status(0)["watchers"] == 2)
    screen.until(lambda: other.locator("#title").inner_text() != "Connecting")
    assert other.get_by_role("button", name="Take control").count() == 0
    other.close()
    screen.until(lambda: screen.rig.display.seat.status(0)["watchers"] == 1)


def test_nothing_came_from_elsewhere_and_nothing_was_complained_of(screen: Screen) -> None:
    assert {url for url in screen.asked if not url.startswith(screen.rig.display.address)} == set()
    assert screen.complaints == []
