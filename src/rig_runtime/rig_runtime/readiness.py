"""Proof that a graph is complete before the first tick.

A reliable writer sends only to the readers that it has matched, so the first message of a graph that is still being
discovered is lost without an error. Each node therefore reports what it publishes and subscribes and how much of it is
matched; the pacemaker compares the reports and starts when every reader that reported is matched by every writer.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Report:
    """What one node has matched (mig_interfaces/NodeReport without ROS)."""

    node: str
    armed_uid: int
    error: str
    publishes: dict[str, int]
    subscribes: dict[str, int]
    ticks_done: int = 0


class ReadinessGate:
    """Collects reports and says what is missing, in words."""

    def __init__(self, required: Iterable[str]) -> None:
        """`required`: fully qualified names of the nodes without which no trial starts."""
        self.required = tuple(required)
        self.reports: dict[str, Report] = {}

    def put(self, report: Report) -> None:
        """Take a node's newest report."""
        self.reports[report.node] = report

    def forget(self, node: str) -> None:
        """Drop what a vanished node reported."""
        self.reports.pop(node, None)

    def missing(self, uid: int) -> list[str]:
        """What trial `uid` still waits for, one sentence each; empty if every endpoint is matched."""
        problems = []
        present = [self.reports[name] for name in self.required if name in self.reports]
        for name in self.required:
            report = self.reports.get(name)
            if report is None:
                problems.append(f"{name} has not reported")
            elif report.error:
                problems.append(f"{name} cannot take part: {report.error}")
            elif report.armed_uid != uid:
                problems.append(f"{name} has not reset itself for trial {uid}")
        readers: dict[str, list[str]] = {}
        for report in present:
            for topic in report.subscribes:
                readers.setdefault(topic, []).append(report.node)
        for report in present:
            for topic, matched in report.publishes.items():
                expected = readers.get(topic, [])
                if matched < len(expected):
                    problems.append(
                        f"{report.node} has matched {matched} of {len(expected)} readers of {topic} "
                        f"({', '.join(expected)})"
                    )
            for topic, matched in report.subscribes.items():
                if matched < 1:
                    problems.append(f"{report.node} waits for a publisher of {topic}")
        return problems

    def slowest(self, order: Iterable[str], tick: int) -> str:
        """Name the first node, in the order of the loop, that has not answered `tick`, for a loop that stands still."""
        for name in order:
            report = self.reports.get(name)
            if report is None:
                return f"{name} has never reported"
            if report.ticks_done <= tick:
                return f"{name} has answered {report.ticks_done} of {tick + 1} ticks"
        return "every node has answered, so a message was lost on the way"
