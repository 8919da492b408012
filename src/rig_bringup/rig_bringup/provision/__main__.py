"""`python3 -m rig_bringup.provision ROOT`: set up what is missing, show each step, do nothing if nothing is to do."""

from __future__ import annotations

import fcntl
import json
import os
import sys
import threading
import time
from pathlib import Path

from rig_bringup.provision.machine import MachineError, needed_to_build, require
from rig_bringup.provision.steps import Places, Step, failure_reason, run_logged, steps, write_environment


def main() -> int:
    """Run the steps whose inputs have changed. Exit code 1 with one sentence if the machine or a step fails."""
    places = Places(Path(sys.argv[1]).resolve())
    places.state.mkdir(exist_ok=True)
    done_file = places.state / "done.json"
    # Two commands at once set up one after the other; the second then finds nothing to do.
    lock = (places.state / "lock").open("w")
    fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        done = _read(done_file)
        todo = _to_do(steps(places), done, places)
        if todo:
            require(needed_to_build(places.root))
        for number, step in enumerate(todo, 1):
            done.pop(step.name, None)
            _write(done_file, done)
            _perform(step, number, len(todo), places)
            done[step.name] = step.digest
            _write(done_file, done)
        write_environment(places)
    except MachineError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nset-up interrupted; the next call goes on where it stopped", file=sys.stderr)
        return 130
    return 0


def _read(path: Path) -> dict[str, str]:
    try:
        return dict(json.loads(path.read_text()))
    except (FileNotFoundError, ValueError):
        return {}


def _write(path: Path, done: dict[str, str]) -> None:
    # Replaced whole, so that an interruption never leaves half a file.
    temporary = path.with_suffix(".new")
    temporary.write_text(json.dumps(done, indent=1))
    temporary.replace(path)


def _to_do(every: list[Step], done: dict[str, str], places: Places) -> list[Step]:
    """The steps that are out of date. A new virtual environment makes all that follows out of date."""
    if not places.python.exists():
        done.clear()
    todo = [step for step in every if done.get(step.name) != step.digest]
    if todo and todo[0].name == "venv":
        return every
    return todo


def _perform(step: Step, number: int, count: int, places: Places) -> None:
    log = places.state / f"{step.name}.log"
    log.write_bytes(b"")
    # Tools of the set-up write byte code as usual, whatever the caller's shell says: it makes every later start faster.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment["RIG_PROVISIONING"] = "1"

    def run(command: list[str]) -> None:
        if run_logged(command, log, environment) != 0:
            text = log.read_text(errors="replace")
            tail = "\n".join(f"    {line}" for line in text.splitlines()[-15:])
            raise MachineError(f"{step.title} failed: {failure_reason(text)}\n{tail}\n  whole log: {log}")

    with _Progress(f"[{number}/{count}] {step.title}", log):
        step.act(run)


class _Progress:
    """A line that shows what runs and for how long; on a terminal it also shows the newest line of the log."""

    def __init__(self, title: str, log: Path) -> None:
        self._title, self._log = title, log
        self._begin = time.monotonic()
        self._over = threading.Event()
        self._terminal = sys.stderr.isatty()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __enter__(self) -> None:
        if not self._terminal:
            print(f"{self._title} ...", file=sys.stderr, flush=True)
        else:
            self._thread.start()

    def __exit__(self, kind: object, *_: object) -> None:
        self._over.set()
        if self._terminal:
            self._thread.join()
        clear = "\r\033[K" if self._terminal else ""
        verdict = "done" if kind is None else "FAILED"
        print(f"{clear}{self._title}: {verdict} in {time.monotonic() - self._begin:.0f} s", file=sys.stderr, flush=True)

    def _show(self) -> None:
        while not self._over.wait(0.5):
            print(
                f"\r\033[K{self._title} {time.monotonic() - self._begin:4.0f} s  {self._newest()}",
                end="",
                file=sys.stderr,
                flush=True,
            )

    def _newest(self) -> str:
        with self._log.open("rb") as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - 400))
            lines = log.read().decode(errors="replace").split("\n")
        return next((line.strip()[:70] for line in reversed(lines) if line.strip()), "")


if __name__ == "__main__":
    sys.exit(main())
