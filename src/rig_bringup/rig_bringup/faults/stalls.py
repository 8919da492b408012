"""How long the machine stood still: beside a time that was measured, so that one can tell whose it is."""

from __future__ import annotations

import threading
import time


class Stalls(threading.Thread):
    """How late a sleep of a millisecond is: whether this process, and perhaps the machine, stood still meanwhile."""

    def __init__(self) -> None:
        super().__init__(name="stalls", daemon=True)
        self._over = threading.Event()
        #: [s] The latest since it was last set to zero.
        self.worst = 0.0

    def run(self) -> None:
        while not self._over.is_set():
            begin = time.monotonic()
            time.sleep(1e-3)
            self.worst = max(self.worst, time.monotonic() - begin - 1e-3)

    def end(self) -> None:
        self._over.set()
        self.join()
