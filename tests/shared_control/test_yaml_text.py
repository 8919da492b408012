"""YAML from outside: plain values, or one sentence with the place."""

from __future__ import annotations

from pathlib import Path

import pytest

from shared_control.parameters import ParameterError, shown
from shared_control.yaml_text import MOST_BYTES, parse, read


def test_a_file_is_its_bytes_and_its_values(tmp_path: Path) -> None:
    path = tmp_path / "it.yaml"
    path.write_bytes(b"a: [1, 2.0, x]\n")
    assert read(path) == (b"a: [1, 2.0, x]\n", {"a": [1, 2.0, "x"]})
    for wrong in (tmp_path / "nowhere.yaml", tmp_path):
        with pytest.raises(ParameterError, match=f"^{wrong}: cannot be read: "):
            read(wrong)


@pytest.mark.parametrize(
    "text",
    ["2001-99-99", "!!timestamp x", "!!bool x", "!!float ''", "[" * 5000, "- " * 3000, "9" * 5000, "a: *b", "{a: 1",
     "\0", "!!python/object/apply:os.system [id]", "? {a: {b: [c]}}\n: d", b"\xff\xfe\xfd", "x" * (MOST_BYTES + 1)],
    ids=range(14),
)  # fmt: skip
def test_what_yaml_cannot_read_is_one_sentence(text: str | bytes) -> None:
    with pytest.raises(ParameterError) as caught:
        parse(text, "somewhere")
    assert str(caught.value).startswith("somewhere")
    assert len(str(caught.value)) < 400


def test_aliases_that_multiply_are_not_written_out() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 30)]
    assert len(shown(parse("\n".join(lines), "it"))) < 3000
