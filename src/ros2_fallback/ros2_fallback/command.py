"""What a command of the command line consists of: verbs, each with its arguments and what it does."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

__all__ = ["CommandError", "Outcome", "Verb", "add_verbs", "non_negative_int", "positive_float", "positive_int"]

#: None or 0: success; another number: the exit code; text: an error to show, with exit code 1.
Outcome = int | str | None


class CommandError(RuntimeError):
    """A command cannot do what was asked; the text is for the person who asked."""


def _no_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of a verb that takes none."""


@dataclass(frozen=True)
class Verb:
    """One verb of a command."""

    summary: str  #: one line for the help
    run: Callable[[argparse.Namespace], Outcome]
    arguments: Callable[[argparse.ArgumentParser], None] = _no_arguments


def add_verbs(parser: argparse.ArgumentParser, verbs: Mapping[str, Verb], argv: Sequence[str]) -> None:
    """Give the parser of a command its verbs; only the one that is asked for is given its arguments."""
    width = max(len(name) for name in verbs)
    subparsers = parser.add_subparsers(
        title="Commands",
        description="\n".join(f"{name.ljust(width)}  {verbs[name].summary}" for name in sorted(verbs)),
        metavar=f"Call `{parser.prog} <verb> -h` for more detailed usage.",
        dest="verb",
    )
    asked = next((argument for argument in argv if not argument.startswith("-")), None)
    for name in sorted(verbs):
        verb_parser = subparsers.add_parser(
            name, description=verbs[name].summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        verb_parser.set_defaults(run=verbs[name].run)
        if name == asked:
            verbs[name].arguments(verb_parser)


def positive_int(text: str) -> int:
    """A whole number above zero, for argparse."""
    value = _number(text, int, "a whole number")
    if value <= 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not above zero")
    return int(value)


def non_negative_int(text: str) -> int:
    """A whole number, zero or above, for argparse."""
    value = _number(text, int, "a whole number")
    if value < 0:
        raise argparse.ArgumentTypeError(f"'{text}' is below zero")
    return int(value)


def positive_float(text: str) -> float:
    """A finite number above zero, for argparse."""
    value = _number(text, float, "a number")
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a finite number above zero")
    return value


def _number(text: str, kind: Callable[[str], float], name: str) -> float:
    try:
        return kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not {name}") from None
