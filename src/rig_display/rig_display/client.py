"""One connected page: what it is sent, how much it may say, how its clock runs."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from aiohttp import WSCloseCode, web

from rig_display.latency import LinkClock, Spread

__all__ = ["Bucket", "Client"]

#: Messages that wait for a page which reads too slowly; beyond that it is let go, and comes back fresh.
_QUEUE = 200


class Bucket:
    """So many a second on average, and as many at once."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._level, self._last = burst, 0

    def take(self, now: int) -> bool:
        """One more at `now` [ns]; False if it is one too many."""
        self._level = min(self._burst, self._level + 1e-9 * (now - self._last) * self._rate)
        self._last = now
        if self._level < 1.0:
            return False
        self._level -= 1.0
        return True


class Client:
    """A page on its socket. Sending never waits: a task of its own empties the queue."""

    def __init__(self, socket: web.WebSocketResponse, address: str, operator: bool, rate: float) -> None:
        self.socket = socket
        self.address = address
        self.operator = operator
        self.messages = Bucket(rate, rate)
        self.commands = Bucket(5.0, 10.0)
        self.clock = LinkClock()
        #: What the page measured of itself: state to drawn [ms], round trip [ms], frames a second.
        self.drawn = Spread(0, *(float("nan"),) * 3)
        self.round_trip = float("nan")
        self.frames = float("nan")
        #: Force messages since the last status.
        self.forces = 0
        self._queue: asyncio.Queue[str] = asyncio.Queue(_QUEUE)
        self._slow = False

    def send(self, message: dict[str, Any]) -> None:
        """Queue an object."""
        self.send_text(json.dumps(message, separators=(",", ":"), allow_nan=False))

    def send_text(self, text: str) -> None:
        """Queue what is JSON already."""
        try:
            self._queue.put_nowait(text)
        except asyncio.QueueFull:
            self._slow = True

    async def deliver(self) -> None:
        """Send what is queued, for as long as the page reads."""
        while not self._slow:
            await self.socket.send_str(await self._queue.get())
        await self.socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"this page reads too slowly")
