"""The web server: pages, and a socket for each. It lives in a thread with an event loop of its own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aiohttp import WebSocketError, WSCloseCode, WSMsgType, web

from rig_display.client import Client
from rig_display.gate import HEADERS, Gate
from rig_display.parameters import DisplayConfig
from rig_display.protocol import MAX_BYTES, ProtocolError, parse
from rig_display.seat import Seat

__all__ = ["PageServer", "ServerError"]

_PAGE = Path(__file__).parent / "page"
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}

#: [s] Between two statuses, and between two batches of ticks for those who watch.
_STATUS_PERIOD = 0.2
_WATCH_PERIOD = 1 / 30

#: [s] After this much silence a page is asked whether it is there; a hand is given up much sooner, after `stale_after`.
_HEARTBEAT = 10.0


class ServerError(OSError):
    """The server cannot listen; the message is for a person."""


class PageServer:
    """Serves the pages of a :class:`Seat`.

    Parameters
    ----------
    seat: who drives, what people do, what they are shown.
    """

    def __init__(self, config: DisplayConfig, gate: Gate, seat: Seat) -> None:
        self._config = config
        self._gate = gate
        self._seat = seat
        self._files = {path.name: path for path in _PAGE.iterdir() if path.suffix in _TYPES}
        self._loop = asyncio.new_event_loop()
        #: By which hands come in.
        self.thread = threading.Thread(target=self._run, name="pages", daemon=True)
        self._started: threading.Event = threading.Event()
        self._error: OSError | None = None
        self._end = asyncio.Event()
        self._woken = False
        self._rows: tuple[list[Any], list[Any]] = ([], [])
        self.port = config.port

    # -- from other threads --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Listen.

        Raises
        ------
        ServerError: the address cannot be listened on.
        """
        self.thread.start()
        self._started.wait()
        if self._error is not None:
            raise ServerError(
                f"display: cannot listen on {self._config.host} port {self._config.port}: "
                f"{self._error.strerror or self._error}; name another with --port"
            ) from self._error

    def stop(self) -> None:
        """Close every socket and wait for the thread. Idempotent."""
        if self.thread.is_alive():
            self.call(self._end.set)
            self.thread.join(10.0)

    def call(self, action: Callable[..., None], *arguments: Any) -> None:
        """Have something done in the server's thread; does not wait for it."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody is left to be told
            self._loop.call_soon_threadsafe(action, *arguments)

    def wake(self) -> None:
        """A tick has come. Cheap: several ticks that come before the server looks are one call."""
        if not self._woken:
            self._woken = True
            self.call(self._push_ticks)

    # -- life ----------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._started.set()
            self._loop.close()

    async def _serve(self) -> None:
        app = web.Application(client_max_size=MAX_BYTES)
        app.router.add_get("/", self._page("index.html"))
        app.router.add_get("/operator", self._page("operator.html"))
        app.router.add_get("/static/{name}", self._static)
        app.router.add_get("/socket", self._socket)
        app.on_response_prepare.append(_add_headers)
        runner = web.AppRunner(app, handle_signals=False, access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        site = web.TCPSite(runner, self._config.host, self._config.port)
        try:
            await site.start()
        except OSError as error:
            self._error = error
            await runner.cleanup()
            return
        self.port = runner.addresses[0][1]
        self._seat.on_change = self._push_status
        self._started.set()
        tasks = [asyncio.create_task(self._repeat(_STATUS_PERIOD, self._push_status))]
        tasks.append(asyncio.create_task(self._repeat(_WATCH_PERIOD, self._push_watched)))
        await self._end.wait()
        self._seat.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for client in list(self._seat.clients):
            await client.socket.close(code=WSCloseCode.GOING_AWAY, message=b"the rig has ended")
        await runner.cleanup()

    async def _repeat(self, period: float, action: Callable[[], None]) -> None:
        while True:
            await asyncio.sleep(period)
            action()

    # -- what is sent --------------------------------------------------------------------------------------------

    def _push_ticks(self) -> None:
        """New ticks: at once to who drives, and kept for the next batch of those who watch."""
        self._woken = False
        states, decisions = self._seat.feed.take()
        self._rows[0].extend(states)
        self._rows[1].extend(decisions)
        driver = self._seat.driver
        if driver is not None:
            driver.send_text(_ticks(states, decisions))

    def _push_watched(self) -> None:
        states, decisions = self._rows
        if not states and not decisions:
            return
        self._rows = ([], [])
        text = _ticks(states, decisions)
        for client in self._seat.clients:
            if client is not self._seat.driver:
                client.send_text(text)

    def _push_status(self) -> None:
        status = self._seat.status(time.monotonic_ns())
        for client in self._seat.clients:
            client.send({**status, "driving": client is self._seat.driver})

    # -- requests ------------------------------------------------------------------------------------------------

    def _page(self, name: str) -> Callable[[web.Request], Any]:
        async def answer(request: web.Request) -> web.StreamResponse:
            self._gate.admit(request)
            return web.FileResponse(self._files[name])

        return answer

    async def _static(self, request: web.Request) -> web.StreamResponse:
        # These are the same for everyone and everywhere: no secret, and the page that asks for the token needs a style.
        path = self._files.get(request.match_info["name"])
        if path is None or path.suffix == ".html":
            raise web.HTTPNotFound(text="no such file\n")
        return web.FileResponse(path, headers={"Content-Type": _TYPES[path.suffix]})

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        self._gate.admit(request)
        self._gate.check_origin(request)
        if len(self._seat.clients) >= self._config.max_clients:
            raise web.HTTPServiceUnavailable(text=f"{self._config.max_clients} pages are connected already\n")
        socket = web.WebSocketResponse(max_msg_size=MAX_BYTES, heartbeat=_HEARTBEAT, compress=False)
        await socket.prepare(request)
        operator = request.query.get("as") == "operator"
        client = Client(socket, request.remote or "", operator, self._config.message_rate)
        delivery = asyncio.create_task(client.deliver())
        self._seat.join(client)
        try:
            await self._listen(client)
        finally:
            self._seat.part(client)
            delivery.cancel()
            await asyncio.gather(delivery, return_exceptions=True)
        return socket

    async def _listen(self, client: Client) -> None:
        async for message in client.socket:
            now = time.monotonic_ns()
            if message.type is WSMsgType.ERROR:  # too long, or no frame at all, or silence; aiohttp has closed it
                if isinstance(message.data, WebSocketError):
                    self._seat.refuse(client, str(message.data))
                return
            try:
                if message.type is not WSMsgType.TEXT:
                    raise ProtocolError("only text is understood")
                if not client.messages.take(now):
                    raise ProtocolError("too many messages")
                self._seat.take(client, parse(message.data), now)
            except ProtocolError as error:
                self._seat.refuse(client, str(error))
                reason = str(error).encode()[:120].decode(errors="ignore").encode()
                await client.socket.close(code=WSCloseCode.POLICY_VIOLATION, message=reason)
                return


async def _add_headers(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)


def _ticks(states: list[Any], decisions: list[Any]) -> str:
    return json.dumps({"type": "ticks", "s": states, "d": decisions}, separators=(",", ":"), allow_nan=False)
