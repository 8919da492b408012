"""The operator chooses on the page whose session is led: the command as a person starts it, and pages in a browser."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import NO_BROWSER, browser_path, chromium
from playwright.sync_api import Error

from rig_study.session import LOG, events

pytestmark = [pytest.mark.skipif(browser_path() is None, reason=NO_BROWSER), pytest.mark.timeout(900)]

PROTOCOL = """
study: {title: Two short trials, scenario: cart_pendulum_study, duration: 1.5}
groups: {all: {subjects: 2, modes: ["off"]}}
sets: {only: {trials: 2, instructions: Hold it up.}}
"""


TOKEN = "a-token-of-the-tests"


class Command:
    """`./rig study run --display`, with a folder of protocols beside those of the checkout."""

    def __init__(self, folder: Path, *more: str) -> None:
        protocols = folder / "protocols"
        protocols.mkdir()
        (protocols / "short.yaml").write_text(PROTOCOL)
        (protocols / "broken.yaml").write_text(PROTOCOL.replace("trials: 2", "trails: 2"))
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.address = f"http://127.0.0.1:{port}/"
        self.sessions = folder / "out" / "study_short"
        given = {"--port": str(port), "--protocols": str(protocols), "--out": str(folder / "out")}
        command = [sys.executable, "-m", "rig_bringup", "study", "run", "--display", *more]
        self.said = (folder / "said.txt").open("w+")
        self._process = subprocess.Popen(
            [*command, *(part for pair in given.items() for part in pair)],
            env={**os.environ, "ROS_DOMAIN_ID": str(62 + os.getpid() % 30)},
            stdin=subprocess.DEVNULL,
            stdout=self.said,
            stderr=subprocess.STDOUT,
        )

    def show(self, page: Any, path: str = "") -> Any:
        """Go there as soon as somebody serves it."""
        end = time.monotonic() + 120.0
        while True:
            try:
                page.goto(self.address + path)
                return page
            except Error:
                assert self._process.poll() is None, Path(self.said.name).read_text()
                assert time.monotonic() < end, "nobody serves the page"
                page.wait_for_timeout(100)

    def interrupt(self) -> int:
        self._process.send_signal(signal.SIGINT)
        code = self._process.wait(120.0)
        self.said.close()
        return code

    def log(self, subject: str) -> list[tuple[str, int]]:
        """Trials of a session that began and ended: what, and at which position."""
        kinds = ("started", "finished", "aborted")
        found = events(self.sessions / subject / LOG)
        return [(event["event"], event["position"]) for event in found if event["event"] in kinds]


@pytest.fixture
def command(tmp_path: Path) -> Iterator[Command]:
    made = Command(tmp_path)
    yield made
    if made._process.poll() is None:
        made.interrupt()


def test_for_other_machines_the_pages_ask_for_the_token(tmp_path: Path) -> None:
    command = Command(tmp_path, "--host", "0.0.0.0", "--token", TOKEN)
    try:
        with chromium() as browser:
            context = browser.new_context()
            context.set_default_timeout(120_000)
            operator = command.show(context.new_page(), "operator")
            operator.get_by_text("This page needs a token").wait_for()
            operator.goto(f"{command.address}operator?token=not-this-token-but-another")
            operator.get_by_text("not the right one").wait_for()
            operator.goto(f"{command.address}operator?token={TOKEN}")
            operator.get_by_text("waiting for a choice").wait_for()
            operator.locator("#protocol option", has_text="short").wait_for(state="attached")
            assert TOKEN not in operator.url
    finally:
        assert command.interrupt() == 130
    assert f"operator?token={TOKEN}" in Path(command.said.name).read_text()


def test_the_operator_chooses_one_session_after_another_and_resumes_the_first(command: Command) -> None:
    with chromium() as browser:
        context = browser.new_context()
        context.set_default_timeout(120_000)
        driver, operator = command.show(context.new_page()), command.show(context.new_page(), "operator")
        driver.get_by_role("button", name="Take control").click()
        driver.get_by_text("Your session begins soon").wait_for()
        protocol, person, chosen = (operator.locator(f"#{name}") for name in ("protocol", "person", "chosen"))
        begin = operator.locator("#choose")
        # What there is to choose from comes at once, but to each page on its own.
        protocol.locator("option", has_text="short").wait_for(state="attached")
        assert {"broken", "demo", "paper", "short"} <= set(protocol.locator("option").all_inner_texts())
        protocol.select_option("broken")
        assert "did you mean trials" in chosen.inner_text()
        assert begin.is_disabled()
        protocol.select_option("short")
        assert person.locator("option").all_inner_texts() == ["S01, not begun", "S02, not begun"]
        assert chosen.inner_text() == "Two short trials · all · not begun"
        assert operator.get_by_role("button", name="Start").count() == 0

        begin.click()
        operator.get_by_text("S01: 0 of 2 trials").wait_for()
        # The driver's page takes its seat again by itself.
        driver.get_by_text("Hold it up.").wait_for()
        assert begin.is_disabled()
        operator.get_by_role("button", name="Go on").click()
        operator.get_by_text("S01: 1 of 2 trials").wait_for()
        person.locator("option", has_text="S01, 1 of 2 trials").wait_for(state="attached")
        person.select_option("S02")
        operator.locator("#choose:enabled").click()
        operator.get_by_text("S02: 0 of 2 trials").wait_for()
        person.select_option("S01")
        assert begin.inner_text() == "Resume"
        begin.click()
        operator.get_by_text("S01: 1 of 2 trials").wait_for()
        operator.locator("#resume:enabled").click()
        operator.get_by_text("S01: 2 of 2 trials").wait_for()
        operator.locator("#progress", has_text="done").wait_for()
        # Who is through is not offered again; the next one is.
        person.locator("option", has_text="S01, finished").wait_for(state="attached")
        assert person.input_value() == "S02"
        assert not begin.is_disabled()
    assert command.interrupt() == 130
    assert command.log("S01") == [("started", 1), ("finished", 1), ("started", 2), ("finished", 2)]
    assert command.log("S02") == []
