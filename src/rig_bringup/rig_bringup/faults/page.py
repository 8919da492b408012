"""The hand of a person: a page of the display, as a client in a thread, that pushes as the good hand does."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import aiohttp

from rig_bringup.faults.hand import PUSH

#: [s] Between two forces, and between two looks for a display that is not there.
_PERIOD, _RETRY = 0.008, 0.1


class Page:
    """Connects to the display again and again, takes control and pushes while it is told to."""

    def __init__(self, port: int) -> None:
        self._origin = f"http://127.0.0.1:{port}"
        self._over = threading.Event()
        self._forces: Iterator[float] = cycle((PUSH, -PUSH))
        self._said: list[dict[str, Any]] = []
        #: Whether it is there at all, and whether it says what the hand does.
        self.open, self.pushing = True, True
        #: What the display last said of the trial, the hand and the faults; empty while it says nothing.
        self.status: dict[str, Any] = {}
        #: The newest answer to what it said.
        self.told = ""
        #: [s, steady clock] When the newest force was sent.
        self.last_push = 0.0
        self._thread = threading.Thread(target=asyncio.run, args=(self._live(),), name="page", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Close the page for good."""
        self._over.set()
        self._thread.join()

    def say(self, kind: str, **fields: Any) -> None:
        """Send a message of the display's protocol."""
        self._said.append({"type": kind, **fields})

    def start_trial(self) -> None:
        """Press Start."""
        self.say("start", subject="", group="", set="", trial=0, duration=0.0)

    @property
    def driving(self) -> bool:
        """Whether the display takes this page for the driver's."""
        return bool(self.status.get("driving"))

    async def _live(self) -> None:
        async with aiohttp.ClientSession() as session:
            while not self._over.is_set():
                if self.open:
                    with contextlib.suppress(aiohttp.ClientError, ConnectionError, asyncio.TimeoutError):
                        await self._visit(session)
                self.status = {}
                await asyncio.sleep(_RETRY)

    async def _visit(self, session: aiohttp.ClientSession) -> None:
        url, headers = f"{self._origin}/socket", {"Origin": self._origin}
        async with session.ws_connect(url, headers=headers, timeout=aiohttp.ClientWSTimeout(ws_close=0.2)) as socket:
            await socket.send_json({"type": "drive"})
            listening = asyncio.create_task(self._listen(socket))
            try:
                while self.open and not self._over.is_set() and not listening.done():
                    while self._said:
                        await socket.send_json(self._said.pop(0))
                    if self.pushing:
                        self.last_push = time.monotonic()
                        force = {"x": next(self._forces), "y": 0.0, "z": 0.0, "t": 1e3 * self.last_push, "age": None}
                        await socket.send_json({"type": "force", **force})
                    await asyncio.sleep(_PERIOD)
            finally:
                listening.cancel()

    async def _listen(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        async for message in socket:
            if message.type is aiohttp.WSMsgType.TEXT:
                content = json.loads(message.data)
                if content["type"] == "status":
                    self.status = content
                elif content["type"] == "note":
                    self.told = content["text"]
