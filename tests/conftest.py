"""What all tests share: which may run side by side; and a graph of nodes on one executor, destroyed at the end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings
from node_graph import Graph

# A machine that stalls is no fault of the code: no test has a deadline.
settings.register_profile("rig", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("rig")

#: Tests without a live graph, but for the files that run one to have a bag.
_QUIET = ("shared_control", "rig_study", "acceptance")
_LIVE = ("test_graph", "test_rederive")


def pytest_itemcollected(item: pytest.Item) -> None:
    """Group the tests for `-n 2 --dist loadgroup`: live graphs one after the other, each other file as a whole."""
    live = item.path.parent.name not in _QUIET or item.path.stem in _LIVE
    item.add_marker(pytest.mark.xdist_group("live graphs" if live else item.path.stem))


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
