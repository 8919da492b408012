"""The person's pages beside the loop: pointer to wrench, state to drawn frame, and what pages cost the loop.

The graph runs in separate processes, recorded, as `./rig up --display` has it; the page is in headless Chromium on the
same machine, so the loop shares the processors with a browser that draws in software.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import os
import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import loop
from browser import NO_BROWSER, browser_path, chromium
from live import LIMIT, in_own_domain
from rows import BenchError, NotHereError, Row, alternate, percentile

from mig_interfaces.msg import TrialState
from rig_bringup import scenario
from rig_bringup.graph_process import GraphProcess
from rig_bringup.monitor import Monitor
from rig_bringup.up import graph_command, scheduling

#: [s] A trial: about a thousand events of the pointer.
_DURATION = 10.0

#: Pages of people who only watch.
_WATCHERS = 10

#: [ms] Two frames of 60 in a second.
_TWO_FRAMES = 2000 / 60

#: Keeps what the page says of itself: once a second how long states took to the end of the frame that first shows them;
#: and of events of the pointer how long [ms] it took until the page's code ran, and until the force was sent.
_KEEP_STATS = """
window.stats = [];
window.told = [];
window.sent = [];
addEventListener("pointerrawupdate", (event) => window.told.push(performance.now() - event.timeStamp), true);
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  const message = JSON.parse(text);
  if (message.type === "stats") window.stats.push(message);
  if (message.type === "force" && message.age !== null) window.sent.push(message.age);
  return send.call(this, text);
};
"""

#: Where an event of the pointer has come to, stage by stage.
_STAGES = {
    "told": "pointer event to the page's code",
    "sent": "pointer event to the force sent by the page",
    "received": "pointer event to the force received by the node",
    "": "pointer event to wrench published, by the node",
}


@dataclass(frozen=True)
class Trial:
    """What a trial with a person's page was like."""

    missed: int
    #: [ms] p50 and p99 of each stage.
    pointer: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    stats: tuple[dict[str, float], ...] = ()


class Watcher:
    """A node beside the graph, served by a thread: what is the trial doing."""

    def __init__(self) -> None:
        self.monitor = Monitor("rig")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Watcher:
        self.monitor.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join(LIMIT)
        self.monitor.__exit__()

    def _serve(self) -> None:
        while not self._end.is_set():
            self.monitor.wait(0.1)

    @property
    def phase(self) -> int:
        """Of the trial."""
        return TrialState.PHASE_IDLE if self.monitor.trial is None else self.monitor.trial.phase


def _until(condition: Any, graph: GraphProcess, watcher: Watcher, page: Any = None, pause: float = 0.02) -> None:
    end = time.monotonic() + LIMIT
    while not condition():
        if graph.exit_code is not None or time.monotonic() > end:
            shown = "" if page is None else f"; the page shows: {page.locator('#veil').inner_text()!r}"
            raise BenchError(
                f"the graph did not come so far; the trial: {watcher.monitor.progress()}{shown}; "
                f"the graph said:\n{graph.last_words()}"
            )
        time.sleep(pause) if page is None else page.wait_for_timeout(1e3 * pause)


@contextmanager
def _graph(port: int | None) -> Iterator[tuple[GraphProcess, Watcher]]:
    """The graph, recorded, with a simulated user or a display on a port."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        person = port is not None
        files = loop.parameters(folder, record=True, autostart=not person, pacing="realtime", duration=_DURATION)
        environment = scheduling("realtime")
        if person:
            needed = ["display", "mig_filter", "admittance_sim", "recorder"]
            own = {"/**/task_sim": {"required_nodes": needed}, "/**/display": {"port": port, "countdown": 0.0}}
            files.append(folder / "person.yaml")
            files[-1].write_text(scenario.parameter_file(own))
            environment["RIG_USER"] = "display"
        command = graph_command(False, files, "rig")
        with GraphProcess(command, folder / "graph.log", environment) as graph, Watcher() as watcher:
            yield graph, watcher


def _simulated() -> Trial:
    with _graph(None) as (graph, watcher):
        _until(lambda: watcher.monitor.over, graph, watcher)
        assert watcher.monitor.trial is not None
        return Trial(watcher.monitor.trial.missed_deadlines)


def _person(browser: Any, watchers: int) -> Trial:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with _graph(port) as (graph, watcher), _page(browser) as page:
        _until(lambda: _listens(port), graph, watcher)
        with Crowd(port, watchers) if watchers else nullcontext():
            page.goto(f"http://127.0.0.1:{port}/")
            page.get_by_role("button", name="Take control").click()
            page.get_by_role("button", name="Start").click()
            _until(lambda: watcher.phase >= TrialState.PHASE_RUNNING, graph, watcher, page)
            _drag(page, watcher, graph)
            said = watcher.monitor.values["/rig/display"]
            assert watcher.monitor.trial is not None
            pointer = {stage: _percentiles(page.evaluate(f"window.{stage}")) for stage in ("told", "sent")}
            for stage, words in (("received", "pointer to display"), ("", "pointer to wrench")):
                pointer[stage] = (float(said[f"{words} p50 [ms]"]), float(said[f"{words} p99 [ms]"]))
            return Trial(watcher.monitor.trial.missed_deadlines, pointer, tuple(page.evaluate("window.stats")))


def _percentiles(values: Sequence[float]) -> tuple[float, float]:
    return percentile(values, 0.5), percentile(values, 0.99)


@contextmanager
def _page(browser: Any) -> Iterator[Any]:
    page = browser.new_page(viewport={"width": 1000, "height": 600})
    page.set_default_timeout(1e3 * LIMIT)
    page.add_init_script(_KEEP_STATS)
    yield page
    page.close()


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _drag(page: Any, watcher: Watcher, graph: GraphProcess) -> None:
    """Drag to and fro until the trial is over."""
    box = page.locator("#view").bounding_box()
    reach = 0.24 * min(box["width"], box["height"])
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    steps = itertools.count()

    def over() -> bool:
        page.mouse.move(x + round(0.9 * reach * math.sin(0.05 * next(steps))), y)
        return watcher.monitor.over

    _until(over, graph, watcher, page, 0.005)
    page.mouse.up()


class Crowd:
    """Pages that only watch, without a browser. Context manager."""

    def __init__(self, port: int, size: int) -> None:
        self._address = f"http://127.0.0.1:{port}"
        self._size = size
        self._loop = asyncio.new_event_loop()
        self._there = threading.Barrier(2)
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._watch(),), daemon=True)

    def __enter__(self) -> Crowd:
        self._thread.start()
        self._there.wait(LIMIT)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(LIMIT)
        self._loop.close()

    async def _watch(self) -> None:
        self._end = asyncio.Event()
        async with aiohttp.ClientSession() as session:
            connect = (
                session.ws_connect(f"{self._address}/socket", headers={"Origin": self._address})
                for _ in range(self._size)
            )
            sockets = await asyncio.gather(*connect)
            reading = [asyncio.create_task(_read(each)) for each in sockets]
            self._there.wait(LIMIT)
            await self._end.wait()
            for task in reading:
                task.cancel()
            await asyncio.gather(*reading, return_exceptions=True)


async def _read(page: aiohttp.ClientWebSocketResponse) -> None:
    async for _ in page:
        pass


def rows(runs: int) -> list[Row]:
    """Trials with a simulated user, with a driver's page, and with a driver's and ten others, one after the other."""
    if browser_path() is None:
        raise NotHereError(NO_BROWSER)
    os.environ.setdefault("RIG_ROOT", str(Path(__file__).resolve().parents[1]))
    os.environ.update(in_own_domain())
    with chromium() as browser:
        without, alone, watched = alternate(
            runs, _simulated, lambda: _person(browser, 0), lambda: _person(browser, _WATCHERS)
        )
    found = []
    for stage, what in _STAGES.items():
        for index, name, wanted in ((0, "p50", "value < 8"), (1, "p99", "value < 20")):
            found.append(
                Row(
                    *(f"display.pointer.{stage}{'.' * bool(stage)}{name}", f"{what}, {name}", "ms"),
                    tuple(trial.pointer[stage][index] for trial in alone),
                    wanted="" if stage else wanted,
                )
            )
    for name, key, wanted in (("p50", "drawn50", ""), ("p99", "drawn99", f"value <= {_TWO_FRAMES:.1f}")):
        values = tuple(statistics.median(each[key] for each in trial.stats) for trial in alone)
        what = f"state at the display to the end of the frame that shows it, {name} of a second, median"
        found.append(Row(f"display.drawn.{name}", what, "ms", values, wanted=wanted))
    frames = tuple(statistics.median(each["fps"] for each in trial.stats) for trial in alone)
    found.append(Row("display.frames", "frames drawn, headless", "1/s", frames, more_is_better=True))
    for name, who, trials in (("driver", "a driver's page", alone), ("watched", "a driver's page and ten", watched)):
        more = tuple(float(trial.missed - base.missed) for trial, base in zip(trials, without, strict=True))
        what = f"missed deadlines in 10 s at 100 Hz with {who}, more than with a simulated user"
        found.append(Row(f"display.missed.{name}", what, "ticks", more, wanted="value <= 0", counted=True))
    return found
