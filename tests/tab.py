"""A tab of the browser as a person has it: hidden when another comes before it. Playwright's own pages never are."""

from __future__ import annotations

import json
from typing import Any


class Tab:
    """In a window of its own, outside Playwright's contexts; spoken to through its browser. Context manager."""

    def __init__(self, browser: Any, pump: Any, address: str) -> None:
        self._protocol = browser.new_browser_cdp_session()
        self._pump = pump  # a page of Playwright's, which has messages delivered while one waits on it
        self._answers: dict[int, dict[str, Any]] = {}
        self._sent = 0
        self._protocol.on("Target.receivedMessageFromTarget", self._hear)
        created = self._protocol.send("Target.createTarget", {"url": address, "newWindow": True})
        self._targets = [created["targetId"]]
        attach = {**created, "flatten": False}
        self._session = self._protocol.send("Target.attachToTarget", attach)["sessionId"]

    def __enter__(self) -> Tab:
        return self

    def __exit__(self, *_: object) -> None:
        for target in self._targets:
            self._protocol.send("Target.closeTarget", {"targetId": target})
        self._protocol.detach()

    def _hear(self, event: dict[str, Any]) -> None:
        message = json.loads(event["message"])
        if "id" in message:
            self._answers[message["id"]] = message

    def send(self, method: str, **parameters: Any) -> Any:
        """A command of the DevTools protocol, and its result; None if it cannot be done."""
        self._sent += 1
        message = json.dumps({"id": self._sent, "method": method, "params": parameters})
        self._protocol.send("Target.sendMessageToTarget", {"sessionId": self._session, "message": message})
        while self._sent not in self._answers:
            self._pump.wait_for_timeout(5)
        return self._answers.pop(self._sent).get("result")

    def evaluate(self, expression: str) -> Any:
        """The value of an expression on the page; None if it has none, or no page is there yet."""
        found = self.send("Runtime.evaluate", expression=expression, returnByValue=True)
        return found and found["result"].get("value")

    def mouse(self, kind: str, x: float, y: float) -> None:
        """The left button: `mousePressed`, `mouseMoved` or `mouseReleased`."""
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def hide(self) -> None:
        """Open another tab in front of it."""
        self._targets.append(self._protocol.send("Target.createTarget", {"url": "about:blank"})["targetId"])

    def show(self) -> None:
        """To the front again."""
        self._protocol.send("Target.activateTarget", {"targetId": self._targets[0]})
