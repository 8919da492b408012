"""Who drives and who watches, and what becomes of what they do. Lives in the server's thread."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from rig_display.client import Client
from rig_display.feed import Feed
from rig_display.hand import Hand
from rig_display.latency import Spread, Window
from rig_display.parameters import DisplayConfig
from rig_display.protocol import COMMANDS, finite_or_none

__all__ = ["Desk", "Seat"]

_MILLISECOND = 1_000_000

Done = Callable[[bool, str], None]


class Desk(Protocol):
    """What people may do to the graph. Returns at once; `done(success, message)` is called from any thread."""

    def start(self, fields: dict[str, Any], done: Done) -> None: ...

    def abort(self, reason: str, done: Done) -> None: ...

    def set_mode(self, mode: str, done: Done) -> None: ...

    def clear_faults(self, nodes: Iterable[str], done: Done) -> None: ...

    def lead(self, what: str, done: Done) -> None: ...

    def choose(self, protocol: str, subject: str, done: Done) -> None: ...


class Seat:
    """One driver's seat, and everyone around it.

    Parameters
    ----------
    hand: the force sensor that the driver's page feeds.
    feed: what is shown.
    desk: how trials are begun and the filter is set.
    window: latencies from pointer to wrench, filled by the node.
    describe: the task as the pages need it.
    """

    def __init__(
        self,
        config: DisplayConfig,
        hand: Hand,
        feed: Feed,
        desk: Desk,
        window: Window,
        describe: Callable[[], dict[str, Any]],
    ) -> None:
        self._config = config
        self._hand = hand
        self.feed = feed
        self._desk = desk
        self._window = window
        self._describe = describe
        self.clients: list[Client] = []
        self.driver: Client | None = None
        self.feedback = config.feedback
        #: From pointer event to here; what is left to the wrench is the wait for a tick.
        self.arrival = Window()
        self.refused = 0
        self.on_change: Callable[[], None] = lambda: None
        self._last_refusal = ""
        self._countdown: asyncio.TimerHandle | None = None
        self._rate = (0, 0.0)

    # -- coming and going ----------------------------------------------------------------------------------------

    def join(self, client: Client) -> None:
        """A page has connected."""
        self.clients.append(client)
        client.send(self._describe())
        if client.operator:
            self._offer(client)
        self.on_change()

    def part(self, client: Client) -> None:
        """A page is gone."""
        self.clients.remove(client)
        if client is self.driver:
            self._vacate("the driver's page has disconnected")
        self.on_change()

    def describe_again(self) -> None:
        """What a page needs of the task has changed."""
        for client in self.clients:
            client.send(self._describe())

    def offer(self) -> None:
        """Whose session may be chosen has changed: operators see it, since it is more than a status."""
        for client in self.clients:
            if client.operator:
                self._offer(client)
        self.on_change()

    def _offer(self, client: Client) -> None:
        if self.feed.choices is not None:
            client.send({"type": "choices", **self.feed.choices})

    def close(self) -> None:
        """Nobody drives any more."""
        self._cancel_countdown()
        self._vacate("the display has ended")

    def refuse(self, client: Client, why: str) -> None:
        """Something came that no page of ours sends; its connection is being closed."""
        self.refused += 1
        self._last_refusal = f"{client.address}: {why}"
        if client is self.driver:
            self._vacate("the driver's page sent what is not allowed")

    def _vacate(self, reason: str) -> None:
        self.driver = None
        self._hand.zero(reason)

    # -- messages ------------------------------------------------------------------------------------------------

    def take(self, client: Client, message: dict[str, Any], now: int) -> None:
        """A checked message, received at `now` [ns]."""
        kind = message["type"]
        if kind == "force":
            self._force(client, message, now)
            return
        if kind == "sync":
            client.send({"type": "sync", "t": message["t"], "now": now})
            return
        if kind == "stats":
            client.drawn = Spread(1, message["drawn50"], message["drawn99"], message["drawnmax"])
            client.round_trip, client.frames = message["rtt"], message["fps"]
            client.clock.round_trip(message["rtt"])
            return
        if kind in COMMANDS and not client.commands.take(now):
            client.send({"type": "note", "good": False, "text": "too many commands at once; wait a second"})
            return
        getattr(self, f"_take_{kind}")(client, message)
        self.on_change()

    def _force(self, client: Client, message: dict[str, Any], now: int) -> None:
        if client is not self.driver:
            return
        client.forces += 1
        queueing = client.clock.queueing(round(message["t"] * _MILLISECOND), now)
        if queueing > 1e9 * self._config.stale_after:
            # It waited on the way: what the hand does now is behind it.
            return
        age = message["age"]
        event = None if age is None else client.clock.sent(now, queueing) - round(age * _MILLISECOND)
        if event is not None:
            self.arrival.add((now - event) / _MILLISECOND)
        self._hand.put((message["x"], message["y"], message["z"]), now, event)

    def _take_idle(self, client: Client, message: dict[str, Any]) -> None:
        if client is self.driver:
            self._hand.zero(f"the driver's page is {message['reason']}")

    def _take_drive(self, client: Client, _: dict[str, Any]) -> None:
        if self.driver is None and not client.operator:
            self.driver = client
            self._hand.zero("the hand has not moved yet")
        elif client is not self.driver:
            why = "an operator does not drive" if client.operator else "somebody else drives"
            client.send({"type": "note", "good": False, "text": f"{why}; you watch"})

    def _take_leave(self, client: Client, _: dict[str, Any]) -> None:
        if client is self.driver:
            self._vacate("nobody drives")

    def _take_stop(self, client: Client, _: dict[str, Any]) -> None:
        # Whoever sees danger may stop; only who is in charge may go on.
        self._cancel_countdown()
        self._hand.stop("the operator" if client.operator else "the driver" if client is self.driver else "a watcher")

    def _take_release(self, client: Client, _: dict[str, Any]) -> None:
        if self._in_charge(client):
            self._hand.release()
            if self.feed.faults:
                self._desk.clear_faults(tuple(self.feed.faults), self._answer(client))

    def _take_feedback(self, client: Client, message: dict[str, Any]) -> None:
        if self._in_charge(client):
            self.feedback = message["on"]

    def _take_mode(self, client: Client, message: dict[str, Any]) -> None:
        if self._in_charge(client, operator_only=True):
            self._desk.set_mode(message["mode"], self._answer(client))

    def _take_abort(self, client: Client, message: dict[str, Any]) -> None:
        if not self._in_charge(client):
            return
        if self._countdown is not None:
            self._cancel_countdown()
        else:
            self._desk.abort(message["reason"], self._answer(client))

    def _take_session(self, client: Client, message: dict[str, Any]) -> None:
        if self._in_charge(client, operator_only=True):
            self._desk.lead(message["do"], self._answer(client))

    def _take_choose(self, client: Client, message: dict[str, Any]) -> None:
        if self._in_charge(client, operator_only=True):
            self._desk.choose(message["protocol"], message["subject"], self._answer(client))

    def _take_start(self, client: Client, message: dict[str, Any]) -> None:
        if not self._in_charge(client) or self._countdown is not None:
            return
        refusal = self._why_not_start()
        if refusal:
            client.send({"type": "note", "good": False, "text": refusal})
            return
        fields = {key: value for key, value in message.items() if key != "type"}
        loop = asyncio.get_running_loop()
        self._countdown = loop.call_later(self._config.countdown, self._start, fields, client)

    def _start(self, fields: dict[str, Any], client: Client) -> None:
        self._countdown = None
        refusal = self._why_not_start()
        if refusal:
            client.send({"type": "note", "good": False, "text": refusal})
        else:
            self._desk.start(fields, self._answer(client))
        self.on_change()

    def _why_not_start(self) -> str:
        if self.driver is None:
            return "nobody drives: take control on the driver's page first"
        if self.feed.session is not None and not self.feed.session["over"]:
            return "a session is led here, and its conductor starts the trials: use Go on, Pause and Repeat"
        if self.feed.choices is not None:
            return "choose whose session is next; its conductor starts the trials"
        return "release the emergency stop first" if self._hand.stopped_by else ""

    def _in_charge(self, client: Client, operator_only: bool = False) -> bool:
        driver_may = self._config.driver_starts and not operator_only and client is self.driver
        if not client.operator and not driver_may:
            client.send({"type": "note", "good": False, "text": "only an operator may do this"})
            return False
        return True

    def _answer(self, client: Client) -> Done:
        loop = asyncio.get_running_loop()

        def tell(good: bool, text: str) -> None:
            client.send({"type": "note", "good": good, "text": text})
            self.on_change()

        return lambda good, text: None if loop.is_closed() else loop.call_soon_threadsafe(tell, good, text) and None

    def _cancel_countdown(self) -> None:
        if self._countdown is not None:
            self._countdown.cancel()
            self._countdown = None

    # -- status --------------------------------------------------------------------------------------------------

    def status(self, now: int) -> dict[str, Any]:
        """What every page is told five times a second and after each change."""
        driver, countdown = self.driver, self._countdown
        return {
            "type": "status",
            "trial": self.feed.trial,
            "countdown": None if countdown is None else max(countdown.when() - time.monotonic(), 0.0),
            "driver": None if driver is None else driver.address,
            "watchers": len(self.clients) - (driver is not None),
            "hand": {
                "reason": self._hand.reason(now),
                "stopped": self._hand.stopped_by,
                "clipped": self._hand.clipped,
                "rate": self._force_rate(now),
            },
            "faults": [f"{node}: {message}" for node, message in self.feed.faults.items()],
            "troubles": [f"{node}: {message}" for node, message in self.feed.troubles.items()],
            "loss": self.feed.loss,
            "decision": self.feed.decision,
            "session": self.feed.session,
            "choosing": self.feed.choices is not None,
            "feedback": self.feedback,
            "mode": self.feed.mode,
            "recorder": self.feed.recorder,
            "latency": self._latency(),
            "refused": self.refused,
            "refusal": self._last_refusal,
        }

    def _force_rate(self, now: int) -> float:
        """Force messages a second [1/s], counted over half a second or more."""
        since, rate = self._rate
        elapsed = 1e-9 * (now - since)
        if elapsed >= 0.5:
            forces = 0 if self.driver is None else self.driver.forces
            if self.driver is not None:
                self.driver.forces = 0
            rate = round(forces / elapsed, 1)
            self._rate = (now, rate)
        return rate

    def _latency(self) -> dict[str, Any]:
        driver = self.driver
        hand = self._window.spread()
        result: dict[str, Any] = {"hand": [finite_or_none(round(value, 2)) for value in hand[1:]]}
        if driver is not None:
            result["drawn"] = [finite_or_none(value) for value in driver.drawn[1:]]
            result["round_trip"] = finite_or_none(driver.round_trip)
            result["frames"] = finite_or_none(driver.frames)
        return result
