"""What a decision is made of."""

from __future__ import annotations

import re
from pathlib import Path

from shared_control.decision import Mode, Reason, Verdict

MESSAGE = Path(__file__).parents[2] / "src" / "mig_interfaces" / "msg" / "FilterDecision.msg"


def test_the_numbers_are_those_of_the_message():
    """Bags hold them, so that none may ever change."""
    numbers = dict(re.findall(r"^uint8 (\w+) = (\d+)", MESSAGE.read_text(), re.MULTILINE))
    ours = {f"{type(item).__name__.upper()}_{item.name}": item.value for item in (*Verdict, *Reason, *Mode)}
    assert ours == {name: int(number) for name, number in numbers.items()}
