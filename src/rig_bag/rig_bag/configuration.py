"""Parameters of the recorder, declared once."""

from __future__ import annotations

from dataclasses import dataclass

from rig_runtime import topics
from shared_control.parameters import parameter

__all__ = ["QUEUE_DEPTH", "RecorderConfig"]

_PER_TICK = tuple(topic.name for topic in topics.PER_TICK)
_BY_VERDICT = tuple(topic.name for topic in topics.BY_VERDICT)
_VIEW = (topics.JOINT_STATES.name, topics.MARKERS.name)
_BESIDES = (topics.TRIAL_STATE.name, topics.NODE_REPORT.name, *_VIEW, "/diagnostics")

#: [messages] of a topic that wait in the middleware between two takes; it drops older ones and does not say so. In
#: lockstep the pacemaker stays within it.
QUEUE_DEPTH = 2000

#: [ticks] between two words on how far it is: as few as let the pacemaker never wait for one.
_PROGRESS = topics.RECORDER_WINDOW // 2


@dataclass(frozen=True)
class RecorderConfig:
    """What is recorded, where to, and how progress is reported. An empty string in a list stands for nothing."""

    uri: str = parameter("", "directory of the bag; empty: rosbag2_ and the time, in the current directory")
    split: str = parameter(
        "none",
        "none: one bag, from the start; trial: each trial in a bag of its own in the directory uri, named by subject, "
        "set, trial and attempt",
        choices=("none", "trial"),
    )
    topics: tuple[str, ...] = parameter(
        (*_PER_TICK, *_BY_VERDICT, *_BESIDES),
        "topics to record; relative names are taken in the node's namespace",
    )
    regex: str = parameter("", "record also the topics whose full name contains a match of this")
    exclude_regex: str = parameter("", "of the topics found by regex or all, leave these out")
    exclude_topics: tuple[str, ...] = parameter(("",), "the same, by their names")
    all: bool = parameter(False, "record every topic that is not hidden")
    include_hidden_topics: bool = parameter(False, "let regex and all find hidden topics too")
    qos_profile_overrides_path: str = parameter(
        "",
        "file of the quality of service that topics are subscribed with, as ros2 bag record takes it; by default it "
        "is that of their publishers",
    )
    max_bag_size: int = parameter(0, "a file that has reached this is followed by another; 0: no limit", unit="B", ge=0)
    max_bag_duration: float = parameter(
        0.0, "the same, by the time from a file's first message on; 0: no limit", unit="s", ge=0.0
    )
    per_tick_topics: tuple[str, ...] = parameter(
        (*_PER_TICK, "|".join(_BY_VERDICT)),
        "topics with one message a tick, whose stamps define progress; a|b: one on either, checked only",
    )
    follow_trial: bool = parameter(True, "record trial/state, and close the bag when the trial has ended")
    progress_ticks: int = parameter(
        _PROGRESS,
        "ticks between two messages on recorder/state in lockstep, besides the one each second",
        ge=1,
        le=100_000,
    )
    settle_limit: float = parameter(
        5.0,
        "how long an ended trial that lacks ticks must be silent before the bag is closed",
        unit="s",
        ge=0.0,
        le=3600.0,
    )
    custom_data: tuple[str, ...] = parameter(("",), "key=value, for the bag's metadata")
    attachments: tuple[str, ...] = parameter(("",), "files to store in the bag, such as the scenario")
