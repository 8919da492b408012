"""Reading a bag against rosbags' deserialise, on the same file and in the same run; checking it; re-deriving it.

    ./rig run python bench/bag.py BAG

Times are of the processor, of this process alone, best of several: other load on the machine does not count. That of
re-deriving is wall time, without reading the bag and loading the kernels.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rows import Row, alternate

import rig_bag
from rig_bag.verify import verify


def deserialise(bag: Path) -> int:
    """Decode every message with rosbags; returns how many."""
    count = 0
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            count += 1
    return count


def best(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Least processor time [s] of a call, and what it returned."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        result = call()
        times.append(time.process_time() - begin)
    return min(times), result


def rows(runs: int) -> list[Row]:
    """Reading and checking a trial of 30 s, recorded for it in lockstep."""
    import loop

    with tempfile.TemporaryDirectory() as folder:
        loop.run(Path(folder), record=True, pacing="lockstep", duration=30.0)
        bag = Path(folder) / "bag"
        calls = (lambda: rig_bag.read(bag), lambda: verify(bag), lambda: deserialise(bag))
        read, checked, theirs = alternate(runs, *(lambda call=call: 1e3 * best(call, 2)[0] for call in calls))
    baseline = "rosbags, every message deserialised"
    return [
        Row("reader.read", "a trial of 30 s as arrays, processor time", "ms", read, baseline, theirs),
        Row("reader.verify", "every record of it checked, processor time", "ms", checked, baseline, theirs),
    ]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    bag, repeats = arguments.bag, arguments.repeats
    ours, tables = best(lambda: rig_bag.read(bag), repeats)
    theirs, count = best(lambda: deserialise(bag), repeats)
    checked, found = best(lambda: verify(bag), max(1, repeats // 2))
    print(f"{bag}: {count} messages, {sum(map(len, tables.values()))} rows")
    print(f"rig_bag.read           {1e3 * ours:9.1f} ms")
    print(f"rosbags, deserialise   {1e3 * theirs:9.1f} ms   {theirs / ours:.1f} times as long")
    print(f"verify                 {1e3 * checked:9.1f} ms   {'ok' if found.ok else 'NOT ok'}")

    from rig_study.recorded import TrialError
    from rig_study.recorded_inputs import load_inputs
    from rig_study.rederive import rederive

    try:
        inputs = load_inputs(bag)
    except TrialError as error:
        print(f"re-derive              left out: {error}")
        return
    # Once for the kernels; they are compiled, or loaded, only then.
    rederive(inputs)
    runs = [rederive(inputs) for _ in range(repeats)]
    derived, spent = runs[0], min(run.seconds for run in runs)
    same = "identical" if derived.difference() is None else "NOT identical"
    print(f"re-derive              {1e3 * spent:9.1f} ms   {len(derived.decisions)} decisions, {same}")


if __name__ == "__main__":
    main()
