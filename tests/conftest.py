"""What all tests share: which may run side by side; and a graph of nodes on one executor, destroyed at the end."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from node_graph import Graph
from xdist.scheduler import LoadScopeScheduling

# What tests start must never run before everything else on the machine.
os.environ["RIG_REALTIME"] = "off"

# A machine that stalls is no fault of the code: no test has a deadline.
settings.register_profile("rig", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("rig")

#: Tests without a live graph, but for the files that run one to have a bag.
_QUIET = ("tests/shared_control/", "tests/rig_study/", "tests/acceptance/")
_LIVE = ("tests/acceptance/test_graph.py", "tests/rig_study/test_rederive.py")


class _Scheduling(LoadScopeScheduling):  # type: ignore[misc]
    """With `-n`: all live graphs one after the other in one process, and beside them each other file as a whole."""

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.split("::", maxsplit=1)[0]
        return path if path.startswith(_QUIET) and path not in _LIVE else "live graphs"


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    return _Scheduling(config, log)


@pytest.fixture(params=["events", "single"])
def graph(request: pytest.FixtureRequest) -> Iterator[Graph]:
    """A graph, once with each executor."""
    made = Graph(request.param)
    yield made
    made.close()


@pytest.fixture
def single_graph() -> Iterator[Graph]:
    """A graph on the reference executor, for what does not depend on the executor."""
    made = Graph("single")
    yield made
    made.close()
