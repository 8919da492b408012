"""``bag record | info | play`` on a command line, with the syntax and the output of ``ros2 bag`` for Jazzy."""

from __future__ import annotations

import argparse
import datetime
import json
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial

import rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from rig_bag.describe import describe
from rig_bag.errors import BagError
from rig_bag.keyboard import HELP, keys
from rig_bag.player import Player
from rig_bag.player_services import serve, timing
from rig_bag.qos import load_overrides
from rig_bag.reader import info
from rig_bag.recorder import make_recorder
from rig_bag.selection import Selection
from rig_runtime.run import run

__all__ = ["main"]

_QOS_HELP = "YAML file of the quality of service to use by topic, as in /topic: {reliability: best_effort, depth: 5}"


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{value} is not in the valid range (> 0.0)")
    return value


def _not_negative(text: str) -> float:
    value = float(text)
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"Value {value} is less than zero.")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"Value {value} is less than zero.")
    return value


def _pair(text: str) -> str:
    if "=" not in text:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form KEY=VALUE")
    return text


def _remapping(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(":=")
    if not (separator and old and new):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form OLD:=NEW")
    return old, new


def _parser(program: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=program, description="Record, describe, check, repair, export and play bags.")
    verbs = parser.add_subparsers(dest="verb", metavar="verb", required=True)

    record = verbs.add_parser("record", help="Record topics into a bag, until interrupted")
    record.add_argument(
        "-o", "--output", help="Bag to create; by default a folder named by the time, in the current directory"
    )
    record.add_argument("topics_positional", nargs="*", default=[], metavar="TOPIC", help="Topics to record")
    record.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="Topics to record")
    record.add_argument("-a", "--all", action="store_true", help="Record all topics that are not hidden")
    record.add_argument("--all-topics", action="store_true", help="The same as --all")
    record.add_argument("-e", "--regex", default="", help="Record the topics that contain a match")
    record.add_argument("--exclude-regex", default="", help="Leave these out of what --all or --regex finds")
    record.add_argument(
        "--exclude-topics", nargs="+", default=[], metavar="TOPIC", help="Leave these topics out of what is found"
    )
    record.add_argument("--include-hidden-topics", action="store_true", help="Find hidden topics too")
    record.add_argument(
        "-b", "--max-bag-size", type=_count, default=0, metavar="BYTES", help="Begin another file at this size (never)"
    )
    record.add_argument(
        *("-d", "--max-bag-duration"),
        type=_not_negative,
        default=0.0,
        metavar="S",
        help="Begin another file after this time (never)",
    )
    record.add_argument("--qos-profile-overrides-path", default="", metavar="FILE", help=_QOS_HELP)
    record.add_argument(
        "--custom-data",
        nargs="+",
        type=_pair,
        default=[],
        metavar="KEY=VALUE",
        help="For the bag's metadata",
    )
    record.add_argument("-s", "--storage", default="mcap", choices=["mcap"], help="Storage (mcap is the only one)")
    record.add_argument("--node-name", default="rosbag2_recorder", help="Name of the recording node")

    describe_ = verbs.add_parser("info", help="Print what a bag says of itself")
    describe_.add_argument("bag_path", help="Bag to describe")
    describe_.add_argument("-t", "--topic-name", action="store_true", help="Only print the names of the topics")

    check = verbs.add_parser("verify", help="Check a bag from its bytes; the exit status is 0 if nothing is wrong")
    check.add_argument("bag_path", help="Bag to check")
    check.add_argument("--json", action="store_true", help="Print JSON instead of tables")

    mend = verbs.add_parser("repair", help="Make a valid bag of one that was cut; the original is only read")
    mend.add_argument("bag_path", help="Bag to repair")
    mend.add_argument("--out", metavar="DIR", help="Bag to create; by default beside the old one, with _repaired")
    mend.add_argument("--json", action="store_true", help="Print JSON instead of a table")

    save = verbs.add_parser("export", help="Write the topics as tables, a file for each")
    save.add_argument("bag_path", help="Bag to export")
    save.add_argument("--to", required=True, metavar="DIR", help="Folder of the files")
    save.add_argument("--format", default="csv", help="csv, npz or parquet")
    save.add_argument("--topics", nargs="+", metavar="TOPIC", help="Topics to export; by default all")

    play = verbs.add_parser("play", help="Play a bag")
    play.add_argument("bag_path", help="Bag to play")
    play.add_argument("-r", "--rate", type=_positive, default=1.0, help="Rate of play, above 0")
    play.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="Topics to play; by default all")
    play.add_argument("-e", "--regex", default="", help="Play the topics that contain a match")
    play.add_argument("-x", "--exclude-regex", default="", help="Leave out the topics that contain a match")
    play.add_argument("--exclude-topics", nargs="+", default=[], metavar="TOPIC", help="Leave these topics out")
    play.add_argument("--qos-profile-overrides-path", default="", metavar="FILE", help=_QOS_HELP)
    play.add_argument(
        *("--start-offset", "--start"),
        type=_not_negative,
        default=0.0,
        metavar="S",
        help="Start this many seconds into the bag",
    )
    play.add_argument(
        *("--playback-duration", "--duration"),
        type=_positive,
        metavar="S",
        help="Play this much of the bag's time; by default all",
    )
    play.add_argument(
        "-m", "--remap", nargs="+", type=_remapping, default=[], metavar="OLD:=NEW", help="Other names for topics"
    )
    play.add_argument(
        "--clock", nargs="?", type=_positive, const=40.0, default=0.0, metavar="HZ", help="Publish /clock (40 Hz)"
    )
    play.add_argument("-p", "--start-paused", action="store_true", help="Begin with a pause")
    play.add_argument("-l", "--loop", action="store_true", help="Start again at the end")
    play.add_argument(
        "-d", "--delay", type=_not_negative, default=0.0, metavar="S", help="Wait this long before playing"
    )
    play.add_argument(
        "--wait-for-all-acked",
        type=_count,
        default=1000,
        metavar="MS",
        help="At the end, wait this long for readers to have everything; 0: for ever (1000)",
    )
    play.add_argument("--disable-keyboard-controls", action="store_true", help="Obey no keys")
    return parser


def _record(arguments: argparse.Namespace) -> int:
    topics = [*arguments.topics_positional, *arguments.topics]
    everything = arguments.all or arguments.all_topics
    if not (topics or everything or arguments.regex):
        print("error: name the topics to record, or use --all or --regex", file=sys.stderr)
        return 1
    values = {
        "uri": arguments.output or datetime.datetime.now().astimezone().strftime("rosbag2_%Y_%m_%d-%H_%M_%S"),
        "topics": topics or [""],
        "regex": arguments.regex,
        "exclude_regex": arguments.exclude_regex,
        "all": everything,
        "exclude_topics": arguments.exclude_topics or [""],
        "include_hidden_topics": arguments.include_hidden_topics,
        "max_bag_size": arguments.max_bag_size,
        "max_bag_duration": arguments.max_bag_duration,
        "qos_profile_overrides_path": arguments.qos_profile_overrides_path,
        "custom_data": arguments.custom_data or [""],
        "per_tick_topics": [""],
        "follow_trial": False,
    }
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    recorder = partial(
        make_recorder, node_name=arguments.node_name, parameter_overrides=overrides, use_global_arguments=False
    )
    return run(recorder, args=[])


def _info(arguments: argparse.Namespace, about: Callable[[str], str] | None) -> int:
    bag = info(arguments.bag_path)
    if arguments.topic_name:
        for entry in bag.metadata.topics:
            print(entry.name)
    else:
        print(describe(bag))
        more = about(arguments.bag_path) if about is not None else ""
        if more:
            print(f"\n{more}")
    return 0


def _verify(arguments: argparse.Namespace) -> int:
    from rig_bag.verify import verify

    found = verify(arguments.bag_path)
    print(json.dumps(found.mapping(), indent=2) if arguments.json else found.text())
    return int(not found.ok)


def _repair(arguments: argparse.Namespace) -> int:
    from rig_bag.repair import repair

    done = repair(arguments.bag_path, arguments.out)
    print(json.dumps(done.mapping(), indent=2) if arguments.json else done.text())
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from rig_bag.export import export

    for path in export(arguments.bag_path, arguments.to, arguments.format, arguments.topics):
        print(path)
    return 0


def _topics(arguments: argparse.Namespace) -> list[str]:
    """The topics to play; none named stands for all."""
    if not (arguments.regex or arguments.exclude_regex or arguments.exclude_topics):
        return list(arguments.topics)
    selection = Selection(
        everything=not arguments.regex,
        regex=arguments.regex,
        exclude_regex=arguments.exclude_regex,
        exclude=arguments.exclude_topics,
        hidden=True,
    )
    there = [entry.name for entry in info(arguments.bag_path).metadata.topics]
    found = [name for name in there if selection.takes(name) and (not arguments.topics or name in arguments.topics)]
    if not found:
        raise BagError(f"{arguments.bag_path}: no topic is left to play of {', '.join(there)}")
    return found


def _play(arguments: argparse.Namespace) -> int:
    overrides = arguments.qos_profile_overrides_path
    stop = threading.Event()
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("rosbag2_player", use_global_arguments=False)
        try:
            player = Player(
                node,
                arguments.bag_path,
                topics=_topics(arguments),
                qos=load_overrides(overrides) if overrides else {},
                rate=arguments.rate,
                start_offset=arguments.start_offset,
                duration=arguments.playback_duration,
                remap=dict(arguments.remap),
                clock_rate=arguments.clock,
            )
            if arguments.start_paused:
                player.pause()
            with serve(node, player), keys(player, -1 if arguments.disable_keyboard_controls else None) as obeyed:
                if obeyed:
                    print(HELP, file=sys.stderr)
                stop.wait(arguments.delay)
                while not stop.is_set():
                    player.play(stop)
                    if not arguments.loop:
                        break
            player.drain(1e-3 * arguments.wait_for_all_acked or None)
            print(timing(player.lateness), file=sys.stderr)
        finally:
            node.destroy_node()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        rclpy.try_shutdown()
    return 0


def main(
    argv: Sequence[str] | None = None, program: str = "ros2 bag", about: Callable[[str], str] | None = None
) -> int:
    """Run one verb; returns the exit status (0, or 1 after an error, which is printed in one sentence).

    ``about``: what ``info`` prints of a bag after the text of ``ros2 bag info``, unless it is empty.
    """
    arguments = _parser(program).parse_args(argv)
    verbs = {
        "record": _record,
        "info": partial(_info, about=about),
        "verify": _verify,
        "repair": _repair,
        "export": _export,
        "play": _play,
    }
    try:
        return verbs[arguments.verb](arguments)
    except BagError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
