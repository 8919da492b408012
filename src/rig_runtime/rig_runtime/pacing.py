"""When tick k+1 follows tick k, and on which motion. Neither ROS nor a clock in here: time comes in as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Advance(Enum):
    """On what the task goes on to the next tick."""

    MOTION = "motion"  # the loop has closed: on the motion that came back
    HOLD = "hold"  # the motion is late: on the last one
    COAST = "coast"  # nothing came for command_timeout: on zero force


@dataclass
class Pacemaker:
    """Realtime: tick k+1 when its time has come. Lockstep: as soon as the loop and the recorder allow it.

    Parameters
    ----------
    realtime: whether wall time decides; otherwise the loop does.
    sample: t_s [ns].
    command_timeout: [ns] after this much silence the held motion gives way to zero force.
    recorder_window: [ticks] how far lockstep may run ahead of the recorder; 0 if there is none to wait for.
    """

    realtime: bool
    sample: int
    command_timeout: int
    recorder_window: int = 0

    tick: int = 0
    missed: int = 0
    late: int = 0
    _start: int = 0
    _newest: int = -1
    _recorded: int = -1

    def start(self, now: int) -> None:
        """Tick 0 is published at `now` [ns, steady clock]."""
        self.tick = self.missed = self.late = 0
        self._start = now
        self._newest = self._recorded = -1

    def due(self) -> int:
        """When the next tick is due in real time [ns, steady clock]."""
        return self._start + (self.tick + 1) * self.sample

    def take(self, tick: int) -> bool:
        """The motion of `tick` has come back; False if it is of no use: it is not the newest, or of no tick yet.

        One that comes after its tick has passed is counted as late, but it is what the robot did last, and is held.
        """
        news = self._newest < tick <= self.tick
        if tick != self.tick or not news:
            self.late += 1
        if news:
            self._newest = tick
        return news

    def recorded(self, tick: int) -> None:
        """The recorder has every message up to `tick`."""
        self._recorded = max(self._recorded, tick)

    def waits_for(self) -> str:
        """What lockstep waits for: `loop` or `recorder`."""
        return "recorder" if self._newest == self.tick else "loop"

    def advance(self, now: int) -> Advance | None:
        """Go on to the next tick if it may come now, and say on what; None if it may not."""
        closed = self._newest == self.tick
        if self.realtime:
            if now < self.due():
                return None
        elif not closed or (self.recorder_window and self.tick - self._recorded > self.recorder_window):
            return None
        self.tick += 1
        if closed:
            return Advance.MOTION
        self.missed += 1
        silent = self.tick - 1 - self._newest
        return Advance.COAST if silent * self.sample >= self.command_timeout else Advance.HOLD
