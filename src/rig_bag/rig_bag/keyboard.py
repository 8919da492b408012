"""Keys that control a player, as those of ``ros2 bag play``: space pauses and goes on, cursor right lets the next
message through, cursor up and down change the rate by a tenth.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from rig_bag.player import Player

__all__ = ["HELP", "keys"]

HELP = "SPACE: pause or go on.  CURSOR RIGHT: next message, while paused.  CURSOR UP, DOWN: 10 % faster, slower."

#: [s] between two looks at whether the play has ended.
_LOOK = 0.1


@contextmanager
def keys(player: Player, descriptor: int | None = None) -> Iterator[bool]:
    """Obey the keys of a terminal, by default of the standard input, while the player plays; the terminal is left as it
    was. Yields whether there is a terminal.
    """
    source = _standard_input() if descriptor is None else descriptor
    if not os.isatty(source):
        yield False
        return
    before = termios.tcgetattr(source)
    stopped = threading.Event()
    thread = threading.Thread(target=_read, args=(source, player, stopped), name="player-keys", daemon=True)
    # Keys at once and without echo; Ctrl-C stays a signal.
    tty.setcbreak(source)
    thread.start()
    try:
        yield True
    finally:
        stopped.set()
        thread.join()
        termios.tcsetattr(source, termios.TCSADRAIN, before)


def _standard_input() -> int:
    try:
        return sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):
        # It is closed, or no file.
        return -1


def _read(source: int, player: Player, stopped: threading.Event) -> None:
    while not stopped.is_set():
        if not select.select([source], [], [], _LOOK)[0]:
            continue
        try:
            pressed = os.read(source, 64)
        except OSError:
            return
        if not pressed:
            return
        _obey(pressed, player)


def _obey(pressed: bytes, player: Player) -> None:
    actions = {
        b" ": lambda: player.resume() if player.paused else player.pause(),
        b"\x1b[C": player.step,
        b"\x1b[A": lambda: player.set_rate(player.rate * 1.1),
        b"\x1b[B": lambda: player.set_rate(player.rate * 0.9),
    }
    while pressed:
        key = next((key for key in actions if pressed.startswith(key)), pressed[:1])
        pressed = pressed[len(key) :]
        action = actions.get(key)
        if action is not None:
            action()
            state = "paused" if player.paused else f"playing at rate {player.rate:.3g}"
            print(state, file=sys.stderr, flush=True)
