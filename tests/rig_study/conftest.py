"""Fixtures of whole graphs; what they are made of is in `whole_graph`."""

from whole_graph import run_composed

__all__ = ["run_composed"]
