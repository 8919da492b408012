"""The list of a bag's pieces on the disk, against a list in memory."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from rig_bag.mcap_pieces import Piece, Pieces

SHORT, LONG = st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)
PIECES = st.builds(
    Piece,
    opcode=st.integers(0, 255),
    offset=LONG,
    crc=SHORT,
    start_time=LONG,
    end_time=LONG,
    counts=st.dictionaries(st.integers(0, 2**16 - 1), SHORT, max_size=4),
    summary=st.binary(max_size=40),
)


@given(st.lists(st.one_of(PIECES, st.none())))
def test_it_is_a_list_that_grows_and_shrinks_at_its_end(steps: list[Piece | None]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        on_disk, in_memory = Pieces(Path(folder)), list[Piece]()
        assert not list(Path(folder).iterdir())
        for piece in steps:
            if piece is not None:
                on_disk.append(piece)
                in_memory.append(piece)
            elif in_memory:
                assert on_disk.pop() == in_memory.pop()
            assert list(on_disk) == in_memory
