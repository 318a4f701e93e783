"""SPECIMEN after options that take several values: ``--theta-i 0 30 diffuse``.

argparse gives such an option all words up to the next one. Where an argument is missing
then, the last word of one of them is meant for it.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

__all__ = ["with_positionals_first"]


@dataclass
class _Run:
    """Option that takes several values, and the place of the last of them."""

    action: argparse.Action
    last: int
    words: Sequence[str]

    @property
    def is_misplaced(self) -> bool:
        """Whether the last word cannot be a value of the option."""
        if not callable(self.action.type):
            return False
        try:
            self.action.type(self.words[-1])
        except (ValueError, TypeError, argparse.ArgumentTypeError):
            return True
        return False


def with_positionals_first(
    parser: argparse.ArgumentParser, words: Sequence[str]
) -> list[str]:
    """Arguments in an order that argparse understands.

    If fewer than the required arguments stand alone, the word that an option of several
    values cannot take, or else the last word of the last option that takes any, goes to
    the front. Values that convert stay with their option.
    """
    required = sum(
        not action.option_strings and action.nargs not in ("?", "*")
        for action in parser._actions
    )
    alone, runs = _sorted(parser, words)
    if alone >= required or not runs:
        return list(words)
    misplaced = [run for run in runs if run.is_misplaced]
    free = [run for run in runs if run.action.type is None]
    if not (misplaced or free):
        return list(words)
    at = (misplaced or free)[-1].last
    return [words[at], *words[:at], *words[at + 1 :]]


def _sorted(
    parser: argparse.ArgumentParser, words: Sequence[str]
) -> tuple[int, list[_Run]]:
    """Number of words that belong to no option, and options of at least two words."""
    alone, runs = 0, []
    for action, start, end in _pieces(parser, words):
        n = end - start
        if action is None:
            alone += n
        elif action.nargs == "+":
            if n > 1:
                runs.append(_Run(action, end - 1, words[start:end]))
        else:
            takes = {None: 1, "?": 1, 0: 0}.get(action.nargs, n)
            alone += max(0, n - takes)
    return alone, runs


def _pieces(
    parser: argparse.ArgumentParser, words: Sequence[str]
) -> Iterator[tuple[argparse.Action | None, int, int]]:
    """Options and the places of the words up to the next one; None at the beginning."""
    action, start = None, 0
    for number, word in enumerate(words):
        name, sign, _ = word.partition("=")
        found = parser._option_string_actions.get(name)
        if found is not None:
            yield action, start, number
            # a value after = leaves none to be taken from behind
            action, start = (None if sign else found), number + 1
    yield action, start, len(words)
