"""The page in a browser, against the real graph: it shows what happens, and the hand on it is the force sensor.

One browser and one trial for all of them but the last.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import NO_BROWSER, browser_path, chromium
from cable import Cable
from live_display import LiveRig
from rclpy.parameter import Parameter
from tab import Tab

from mig_interfaces.msg import FilterDecision, TaskState, TrialState

pytestmark = [pytest.mark.skipif(browser_path() is None, reason=NO_BROWSER), pytest.mark.timeout(900)]

#: What a machine without a gamepad and without a vibrating body has to be given: both note what is done to them.
DEVICES = """
window.pads = [];
window.pulses = [];
navigator.getGamepads = () => window.pads;
Navigator.prototype.vibrate = (time) => window.pulses.push(`body ${time}`);
window.plugIn = (x, y) => (window.pads = [{ axes: [x, y], vibrationActuator: {
  playEffect: (kind, { duration }) => window.pulses.push(`pad ${duration}`) } }]);
"""

MIDDLE = (
    "(() => { const box = document.getElementById('view').getBoundingClientRect();"
    " return [box.left + 0.5 * box.width, box.top + 0.5 * box.height]; })()"
)


class Screen:
    """The driver's page and the operator's, and what went wrong on them."""

    def __init__(self, rig: LiveRig, browser: Any) -> None:
        self.rig = rig
        self.browser = browser
        self.context = browser.new_context(viewport={"width": 640, "height": 400}, device_scale_factor=1.5)
        self.context.set_default_timeout(120_000)
        self.context.add_init_script(DEVICES)
        self.complaints: list[str] = []
        self.asked: set[str] = set()
        self.driver = self.open("")
        self.operator = self.open("operator")

    def open(self, path: str, address: str = "") -> Any:
        """One more page; through another address its complaints do not count, since that one is cut."""
        page = self.context.new_page()
        if not address:
            page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)
            page.on("pageerror", lambda error: self.complaints.append(str(error)))
            page.on("request", lambda request: self.asked.add(request.url))
        page.goto((address or self.rig.display.address) + path)
        return page

    def until(self, condition: Any) -> None:
        """Wait for it."""
        self.rig.until(condition, self.driver)

    def go(self, driving: bool = True) -> None:
        """Have a trial running, and the driver's page in the seat or out of it."""
        leave = self.driver.get_by_role("button", name="Leave the seat")
        self.until(lambda: self.driver.locator("#title").inner_text() != "Connecting")
        if not leave.is_visible():
            self.driver.get_by_role("button", name="Take control").click()
            leave.wait_for()
        if self.rig.trials[-1].phase != TrialState.PHASE_RUNNING:
            self.driver.get_by_role("button", name="Start").click()
            self.until(lambda: self.rig.trials[-1].phase == TrialState.PHASE_RUNNING)
        if not driving:
            leave.click()
            self.seat_is(taken=False)

    def seat_is(self, taken: bool) -> None:
        """Wait until somebody drives, or nobody."""
        self.until(lambda: (self.rig.display.seat.driver is not None) is taken)

    def drag(self, share: float, page: Any = None) -> float:
        """Press in the middle of the driver's view and drag so far to the limit; return the force [N] that is meant."""
        page = page or self.driver
        box = page.locator("#view").bounding_box()
        x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.6 * box["height"]
        dx = round(share * 0.24 * min(box["width"], box["height"]))
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + dx, y, steps=4)
        return 40.0 * dx / (0.24 * min(box["width"], box["height"]))

    def pushes_nothing(self) -> None:
        """Watch twenty ticks."""
        ticks = len(self.rig.wrenches)
        self.until(lambda: len(self.rig.wrenches) > ticks + 20)
        assert {wrench.wrench.force.x for wrench in self.rig.wrenches[ticks:]} == {0.0}

    def release(self) -> None:
        """The operator ends the emergency stop."""
        self.operator.get_by_role("button", name="Release").click()
        self.until(lambda: self.rig.display.hand.stopped_by == "")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, once."""
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def screen(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """Everything else, once."""
    with LiveRig(tmp_path_factory.mktemp("live")) as rig:
        yield Screen(rig, browser)


def picture(page: Any) -> str:
    """What is drawn of the task, two frames from now."""
    return str(
        page.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() =>"
            " done(document.getElementById('view').toDataURL()))))"
        )
    )


def test_a_person_takes_control_and_starts_and_sees_it_move(screen: Screen) -> None:
    page = screen.driver
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Start").wait_for()
    still = picture(page)
    assert picture(page) == still
    page.get_by_role("button", name="Start").click()
    screen.until(lambda: screen.rig.trials[-1].phase == TrialState.PHASE_RUNNING)
    page.keyboard.down("ArrowRight")
    screen.until(lambda: screen.rig.force == 20.0)
    page.keyboard.up("ArrowRight")
    screen.until(lambda: screen.rig.force == 0.0)
    # No hand is drawn now: what changes is the task.
    before = picture(page)
    screen.until(lambda: picture(page) != before)
    assert screen.rig.force == 0.0
    # Sharp: as many pixels as the screen has.
    assert page.evaluate("document.getElementById('view').width") == 960


def test_a_drag_arrives_as_the_right_force(screen: Screen) -> None:
    screen.go()
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


#: What a hand says of itself, with a link of ours: after a message of its own pace, and after two events at once.
HURRY = """async () => {
  const { Hand } = await import("/static/hand.js");
  const said = [];
  const hand = new Hand({ say: (_, force) => said.push(force) }, document.createElement("div"), null, () => null);
  Object.assign(hand, { task: { limits: [40, 0, 0] }, driving: true, here: true });
  hand.send();
  const event = performance.now();
  // However long this takes, it is one moment.
  performance.now = () => event;
  hand.note({ timeStamp: event });
  const atOnce = said.map(({ age }) => age !== null);
  hand.note({ timeStamp: event + 1e-3 });
  hand.note({ timeStamp: event + 2e-3 });
  const held = said.length;
  delete performance.now;
  while (!said.slice(held).some(({ age }) => age !== null)) await new Promise((done) => setTimeout(done, 1));
  const { t, age } = said.slice(held).find(({ age }) => age !== null);
  return { atOnce, held, oldest: t - age - event };
}"""


def test_an_event_waits_for_no_other_message(screen: Screen) -> None:
    found = screen.driver.evaluate(HURRY)
    assert found["atOnce"] == [False, True]
    # A second one so soon after the first goes out a little later, and counts from the oldest that it holds.
    assert found["held"] == 2
    assert found["oldest"] == pytest.approx(1e-3, abs=5e-4)


def test_keys_and_a_gamepad_push_too(screen: Screen) -> None:
    screen.go()
    page = screen.driver
    page.keyboard.down("Shift")
    page.keyboard.down("KeyA")
    screen.until(lambda: screen.rig.force == -40.0)
    page.keyboard.up("KeyA")
    page.keyboard.up("Shift")
    screen.until(lambda: screen.rig.force == 0.0)
    page.evaluate("plugIn(0.25, 0)")
    screen.until(lambda: screen.rig.force == 10.0)
    page.evaluate("plugIn(0.05, 0)")  # a stick that does not quite return
    screen.until(lambda: screen.rig.force == 0.0)


def test_the_operator_sets_the_filter_and_the_verdicts_are_shown_and_felt(screen: Screen) -> None:
    screen.go()
    page, how = screen.driver, screen.driver.locator("#how")
    screen.operator.get_by_role("button", name="Training").click()
    screen.until(lambda: screen.rig.display.feed.mode == "training")
    assert page.evaluate("pulses") == []  # not switched on: nothing is shown or felt
    screen.operator.get_by_role("button", name="Driver sees verdicts").click()
    screen.until(lambda: how.get_attribute("class").split()[1:] == ["accepted"])
    screen.drag(-0.9)
    # To and fro: one of the two is bad wherever the pendulum is.
    places = itertools.cycle((620, 20))

    def rejected() -> bool:
        page.mouse.move(next(places), 200)
        return "rejected" in str(how.inner_text())

    screen.until(rejected)
    screen.until(lambda: {"body 30", "pad 40"} <= set(page.evaluate("pulses")))
    # Each verdict has a colour of its own, and the word beside it.
    colours = page.evaluate(
        "['accepted', 'rejected', 'replaced'].map((name) => { const how = document.getElementById('how');"
        " const was = how.className; how.className = 'how ' + name;"
        " const found = getComputedStyle(how).color; how.className = was; return found; })"
    )
    assert len(set(colours)) == 3
    page.mouse.up()
    screen.operator.get_by_role("button", name="Driver sees verdicts").click()
    screen.operator.get_by_role("button", name="Off", exact=True).click()
    screen.until(lambda: screen.rig.display.feed.mode == "off")


def test_why_there_is_no_force_is_on_both_pages(screen: Screen) -> None:
    screen.go()
    why, decision = "no force for ", screen.operator.locator("#decision")
    place = screen.driver.locator("#view").bounding_box()
    both = [page.locator("#how") for page in (screen.driver, screen.operator)]
    screen.rig.filter.set_parameters([Parameter("max_force", value=1.0)])
    screen.drag(0.7)
    for how in both:
        screen.until(lambda how=how: why in how.inner_text() and "beyond max_force" in how.inner_text())
        assert "warn" in how.get_attribute("class")
    assert screen.driver.locator("#view").bounding_box() == place, "words must not move what the hand pushes at"
    assert decision.inner_text() == "rejected: the wrench is beyond max_force"
    screen.rig.filter.set_parameters([Parameter("max_force", value=1e4)])
    for how in both:
        screen.until(lambda how=how: "no force" not in how.inner_text())
    screen.until(lambda: decision.inner_text() == "accepted: the filter is off")
    screen.driver.mouse.up()


def test_the_emergency_stop_holds(screen: Screen) -> None:
    screen.go()
    screen.drag(0.7)
    screen.until(lambda: screen.rig.force > 10.0)
    screen.driver.keyboard.press("Escape")
    screen.until(lambda: screen.rig.force == 0.0)
    screen.driver.get_by_text("Emergency stop, pressed by the driver").wait_for()
    screen.pushes_nothing()
    screen.release()
    screen.until(lambda: "let go" in screen.operator.locator("#link").inner_text())
    assert screen.rig.force == 0.0
    screen.driver.mouse.up()
    screen.drag(0.7)
    screen.until(lambda: screen.rig.force > 10.0)
    screen.operator.keyboard.press("Space")
    screen.until(lambda: screen.rig.force == 0.0)
    screen.driver.get_by_text("Emergency stop, pressed by the operator").wait_for()
    screen.driver.mouse.up()
    screen.release()


def test_a_second_person_watches(screen: Screen) -> None:
    screen.go()
    other = screen.open("")
    screen.until(lambda: screen.rig.display.seat.status(0)["watchers"] == 2)
    screen.until(lambda: other.locator("#title").inner_text() != "Connecting")
    assert other.get_by_role("button", name="Take control").count() == 0
    other.close()
    screen.until(lambda: screen.rig.display.seat.status(0)["watchers"] == 1)


def test_a_page_without_focus_pushes_nothing(screen: Screen) -> None:
    screen.go()
    screen.drag(0.5)
    screen.until(lambda: screen.rig.force > 5.0)
    # Playwright's pages all have the focus for ever: the event alone.
    screen.driver.evaluate("window.dispatchEvent(new Event('blur'))")
    screen.until(lambda: screen.rig.force == 0.0)
    screen.until(lambda: "out of focus" in screen.operator.locator("#link").inner_text())
    screen.driver.mouse.up()


def test_a_hidden_page_pushes_nothing_and_shown_again_waits_for_the_hand(screen: Screen) -> None:
    screen.go(driving=False)
    with Tab(screen.browser, screen.driver, screen.rig.display.address) as tab:
        screen.until(lambda: tab.evaluate("document.getElementById('act')?.textContent") == "Take control")
        tab.evaluate("document.getElementById('act').click()")
        screen.seat_is(taken=True)
        tab.evaluate("navigator.getGamepads = () => [{ axes: [1, 0] }]")
        x, y = tab.evaluate(MIDDLE)
        tab.mouse("mousePressed", x, y)
        screen.until(lambda: screen.rig.force == 40.0)
        tab.hide()
        screen.until(lambda: tab.evaluate("document.visibilityState") == "hidden")
        screen.until(lambda: screen.rig.force == 0.0)
        screen.until(lambda: "hidden" in screen.operator.locator("#link").inner_text())
        # Shown again, beside a window that has the focus: the stick means nothing.
        # Headless, the focus comes back with the tab: here it is said to be away.
        tab.evaluate("document.hasFocus = () => false")
        tab.show()
        screen.until(lambda: tab.evaluate("document.visibilityState") == "visible")
        screen.until(lambda: "out of focus" in screen.operator.locator("#link").inner_text())
        screen.pushes_nothing()
        tab.mouse("mouseReleased", x, y)
        tab.mouse("mousePressed", x, y)
        screen.until(lambda: screen.rig.force == 40.0)
    screen.until(lambda: screen.rig.force == 0.0)
    screen.seat_is(taken=False)


def test_a_stop_without_a_link_is_said_to_be_on_its_way_and_arrives(screen: Screen) -> None:
    screen.go(driving=False)
    with Cable(screen.rig.display.server.port) as cable:
        page, operator = screen.open("", cable.address), screen.open("operator", cable.address)
        page.get_by_role("button", name="Take control").click()
        screen.seat_is(taken=True)
        screen.drag(0.6, page)
        screen.until(lambda: screen.rig.force > 10.0)
        screen.until(lambda: "messages/s" in operator.locator("#link").inner_text())
        cable.cut()
        # Nothing has been heard of the stop yet; the hand is gone with the link.
        screen.until(lambda: screen.rig.force == 0.0)
        screen.until(lambda: operator.locator("#link").inner_text().split() == ["rig", "⚠", "does", "not", "answer"])
        assert operator.get_by_role("button", name="Abort").is_disabled()
        page.keyboard.press("Escape")
        page.get_by_text("Not delivered: the link to the rig is lost").wait_for()
        operator.keyboard.press("Escape")
        operator.get_by_text("stop NOT delivered").wait_for()
        assert screen.rig.display.hand.stopped_by == ""
        cable.mend()
        screen.until(lambda: screen.rig.display.hand.stopped_by != "")
        page.get_by_text("Emergency stop, pressed by").wait_for()
        screen.until(lambda: "stopped by" in operator.locator("#how").inner_text())
        assert screen.rig.force == 0.0
        screen.release()
        for each in (page, operator):
            each.close()
    screen.seat_is(taken=False)


def test_a_link_that_lets_nothing_through_is_noticed_at_both_ends(screen: Screen) -> None:
    screen.go(driving=False)
    with Cable(screen.rig.display.server.port) as cable:
        page = screen.open("", cable.address)
        page.get_by_role("button", name="Take control").click()
        screen.seat_is(taken=True)
        screen.drag(0.6, page)
        screen.until(lambda: screen.rig.force > 10.0)
        cable.hold()
        page.get_by_text("Connecting").wait_for()
        page.keyboard.press("Escape")
        page.get_by_text("Not delivered: the link to the rig is lost").wait_for()
        screen.until(lambda: screen.rig.force == 0.0)
        screen.until(lambda: "fallen silent" in screen.operator.locator("#link").inner_text())
        page.close()
    screen.seat_is(taken=False)


def test_nothing_came_from_elsewhere_and_nothing_was_complained_of(screen: Screen) -> None:
    assert {url for url in screen.asked if not url.startswith(screen.rig.display.address)} == set()
    assert screen.complaints == []


def test_a_person_swings_it_up_with_the_filter_assisting(browser: Any, tmp_path: Path) -> None:
    """The whole chain: pixels, a controller that knows only them, pointer events, wrench, filter, robot, task."""
    filtered: dict[str, Any] = {"/**/mig_filter": {"mode": "assistance"}}
    with LiveRig(tmp_path, **filtered) as rig:
        page = browser.new_page(viewport={"width": 1100, "height": 480})
        page.set_default_timeout(120_000)
        page.goto(rig.display.address)
        page.get_by_role("button", name="Take control").click()
        page.get_by_role("button", name="Start").click()
        rig.until(lambda: rig.trials[-1].phase == TrialState.PHASE_RUNNING, page)
        page.evaluate(
            "document.getElementById('view').addEventListener('pointerdown', (event) =>"
            " (window.press = { id: event.pointerId, x: event.clientX, y: event.clientY }), { once: true })"
        )
        page.mouse.move(550, 300)
        page.mouse.down()
        page.evaluate(f"({Path(__file__).with_name('person.js').read_text()})(window.press)")
        page.get_by_text("✓ held").wait_for()
        rig.until(lambda: any(state.outcome == TaskState.OUTCOME_SUCCESS for state in rig.states), page)
        # Without a person nothing would have moved: the filter does nothing about a hand that does nothing.
        accepted = [each for each in rig.decisions if each.verdict == FilterDecision.VERDICT_ACCEPTED]
        assert sum(abs(each.admitted_force.x) > 1.0 for each in accepted) > 100
        page.evaluate("window.personLeaves = true")
        page.mouse.up()
