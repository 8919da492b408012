"""A few inputs at each boundary, other ones than `./rig fuzz` begins with; that command runs as many as wanted."""

from __future__ import annotations

import pytest
from fuzz.boundary import Boundary
from fuzz.every import EVERY
from fuzz.garbage import Garbage
from fuzz.runner import run, table

SEED = 20
#: Of each boundary; live nodes take longer over one than files.
INPUTS = 150
LIVE_INPUTS = 40


@pytest.mark.parametrize("kind", EVERY, ids=lambda kind: kind.name)
def test_nothing_crashes_hangs_or_is_refused_without_a_clear_error(kind: type[Boundary]) -> None:
    outcome = run(kind, range(LIVE_INPUTS if kind.__module__ == "fuzz.live" else INPUTS), SEED)
    assert not outcome.crashes, outcome.crashes[0][1]
    # Garbage that is all refused, or never, tries nothing.
    assert outcome.counts["refused"], table([outcome])
    assert outcome.counts["accepted"], table([outcome])


def test_the_same_seed_is_the_same_garbage() -> None:
    def some(seed: int) -> list[object]:
        garbage = Garbage(f"{seed}")
        return [repr(garbage.value()), garbage.bent_text("a: 1"), garbage.bent_bytes(b"abcdefgh")]

    assert some(3) == some(3) != some(4)


class _Broken(Boundary):
    """What the runner must find."""

    name = "broken"

    def send(self, garbage: Garbage) -> str:
        if garbage.maybe(0.2):
            raise KeyError("it")
        return "accepted"


def test_a_crash_is_found_counted_and_kept() -> None:
    outcome = run(_Broken, range(50), 0)
    assert 0 < len(outcome.crashes) < 25
    assert outcome.inputs == 50
    assert "KeyError" in outcome.crashes[0][1]
    assert run(_Broken, [outcome.crashes[0][0]], 0).crashes, "a crash is seen again by its number alone"
