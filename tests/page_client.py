"""A page without a browser: a WebSocket client in a thread of its own, for tests of the display's server."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Coroutine
from typing import Any

import aiohttp
from std_srvs.srv import Trigger


class Web:
    """An event loop in a thread, and the pages on it. Context manager."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._session = self.run(self._open())

    async def _open(self) -> aiohttp.ClientSession:
        return aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True))

    def __enter__(self) -> Web:
        return self

    def __exit__(self, *_: object) -> None:
        self.run(self._session.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(30.0)
        self._loop.close()

    def run(self, work: Coroutine[Any, Any, Any]) -> Any:
        """The result of a coroutine on the loop."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(60.0)

    def get(self, url: str, **headers: str) -> tuple[int, str, Any]:
        """Status, text and headers of a page; redirects are followed."""

        async def fetch() -> tuple[int, str, Any]:
            async with self._session.get(url, headers=headers) as response:
                return response.status, await response.text(), response.headers

        return self.run(fetch())

    def page(self, node: Any, operator: bool = False, **headers: str) -> Page:
        """A page of a display node, connected."""
        url = node.address + ("socket?as=operator" if operator else "socket")
        headers = {"Origin": node.address.rstrip("/"), **headers}

        async def connect() -> aiohttp.ClientWebSocketResponse:
            return await self._session.ws_connect(url, headers=headers)

        return Page(self, self.run(connect()))


class Page:
    """One page: what it has heard, and what it says."""

    def __init__(self, web: Web, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._web = web
        self._socket = socket
        self._holding: dict[str, Any] | None = None
        self.heard: dict[str, Any] = {}
        self.notes: list[dict[str, Any]] = []
        self.ticks: list[list[Any]] = []
        self.decisions: list[list[Any]] = []
        self.over = False
        asyncio.run_coroutine_threadsafe(self._listen(), web._loop)

    @property
    def status(self) -> dict[str, Any]:
        """The newest status; empty before the first."""
        return self.heard.get("status", {})

    @property
    def close_code(self) -> int | None:
        """Why the server closed."""
        return self._socket.close_code

    async def _listen(self) -> None:
        async for message in self._socket:
            content = json.loads(message.data)
            self.heard[content["type"]] = content
            if content["type"] == "note":
                self.notes.append(content)
            elif content["type"] == "ticks":
                self.ticks += content["s"]
                self.decisions += content["d"]
        self.over = True

    def say(self, kind: str, **fields: Any) -> None:
        """Send a message of the protocol."""
        self.say_text(json.dumps({"type": kind, **fields}))

    def say_text(self, text: str) -> None:
        """Send anything."""
        self._web.run(self._socket.send_str(text))

    def push(self, x: float = 0.0, z: float = 0.0, age: float | None = None) -> None:
        """Send a force once."""
        self.say("force", x=x, y=0.0, z=z, t=1e3 * time.monotonic(), age=age)

    def hold(self, x: float = 0.0, z: float = 0.0) -> None:
        """Send a force again and again, as a page does, until :meth:`drop`."""
        holding = self._holding is not None
        self._holding = {"x": x, "z": z}
        if not holding:
            asyncio.run_coroutine_threadsafe(self._repeat(), self._web._loop)

    def drop(self) -> None:
        """Fall silent without a word."""
        self._holding = None

    async def _repeat(self) -> None:
        while self._holding is not None and not self._socket.closed:
            message = {"type": "force", "y": 0.0, "t": 1e3 * time.monotonic(), "age": 0.0, **self._holding}
            await self._socket.send_str(json.dumps(message))
            await asyncio.sleep(0.01)

    def close(self) -> None:
        """Leave."""
        self._holding = None
        self._web.run(self._socket.close())


def serve(graph: Any, names: tuple[str, ...]) -> list[str]:
    """Serve triggers in the place of other nodes; a list that fills with the names of those that are called."""
    called: list[str] = []

    def answer(name: str, response: Trigger.Response) -> Trigger.Response:
        called.append(name)
        response.success, response.message = True, "so be it"
        return response

    for name in names:
        graph.node.create_service(Trigger, name, lambda _, response, name=name: answer(name, response))
    return called


def drive(bench: Any, web: Web) -> Any:
    """A page that drives and holds nothing yet."""
    page = web.page(bench.node)
    page.say("drive")
    bench.until(lambda: page.status.get("driving"))
    return page
