"""The whole graph with a person's page in the place of the user, in a thread: for tests with a browser."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from node_graph import Graph

from mig_interfaces.msg import TrialState
from rig_bringup.compose import graph as graph_of
from rig_runtime import topics


class LiveRig:
    """The nodes on one executor, served by a thread. Context manager."""

    def __init__(self, folder: Path, **sections: dict[str, Any]) -> None:
        content = {
            # A machine that stalls must not look like a hand or a node that has fallen silent.
            "/**": {"pacing": "realtime", "duration": 3600.0, "command_timeout": 5.0},
            "/**/mig_filter": {"mode": "off"},
            "/**/task_sim": {
                "autostart": False,
                "required_nodes": ["display", "mig_filter", "admittance_sim"],
            },
            "/**/display": {"port": 0, "stale_after": 5.0, "countdown": 0.1},
        }
        for section, values in sections.items():
            content.setdefault(section, {}).update(values)
        file = folder / "live.yaml"
        file.write_text(yaml.safe_dump({name: {"ros__parameters": values} for name, values in content.items()}))
        self._graph = Graph("events")
        self.trials: list[TrialState] = self._graph.collect(topics.TRIAL_STATE)
        self.wrenches: list[Any] = self._graph.collect(topics.WRENCH)
        self.states: list[Any] = self._graph.collect(topics.TASK_STATE)
        self.decisions: list[Any] = self._graph.collect(topics.DECISION)
        nodes = [self._graph.make(factory, params_file=file) for factory in graph_of(record=False, person=True)]
        self.display: Any = nodes[0]
        self.filter: Any = next(node for node in nodes if node.get_name() == "mig_filter")
        # What is loaded by now need not be looked through again each time that a node is armed.
        gc.freeze()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._graph.until, args=(self._end.is_set, 1e5), daemon=True)
        self._thread.start()

    def __enter__(self) -> LiveRig:
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(60.0)
        self._graph.close()
        gc.unfreeze()

    @property
    def force(self) -> float:
        """The newest force along x [N]."""
        return float(self.wrenches[-1].wrench.force.x) if self.wrenches else 0.0

    @staticmethod
    def until(condition: Callable[[], bool], page: Any, limit: float = 60.0) -> None:
        """Wait for a condition while the browser's page goes on."""
        end = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < end, "the condition did not come true in time"
            page.wait_for_timeout(20)
