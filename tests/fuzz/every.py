"""The list of boundaries."""

from __future__ import annotations

from fuzz import files, live
from fuzz.boundary import Boundary

__all__ = ["EVERY"]

EVERY: tuple[type[Boundary], ...] = (
    files.Parameters,
    files.Scenarios,
    files.Protocols,
    files.Cohorts,
    files.Sweeps,
    files.Bags,
    files.PageMessages,
    live.Messages,
    live.InATrial,
    live.Services,
    live.Pages,
)
