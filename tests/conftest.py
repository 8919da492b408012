"""What tests of nodes share: a graph of nodes on one executor, destroyed at the end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings
from node_graph import Graph

# A machine that stalls is no fault of the code: no test has a deadline.
settings.register_profile("rig", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("rig")


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
