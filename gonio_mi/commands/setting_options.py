"""Options of the command line that are settings of a measurement."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Mapping
from typing import Any

from ..settings import Declaration, Kind, MeasurementSettings, declarations
from .arguments import number, number_or_word

__all__ = ["add_group", "add_setting", "given_settings"]

# How the words of an option are read; the measurement checks what they say.
READERS: dict[Kind, dict[str, Any]] = {
    Kind.COUNT: {"type": number},
    Kind.NUMBER: {"type": number},
    Kind.WORD: {},
    Kind.WORD_OR_NUMBER: {"type": number_or_word},
    Kind.NUMBERS: {"type": number, "nargs": "+"},
    Kind.FLAG: {"action": "store_true", "default": None},
}


@functools.cache
def _declared() -> Mapping[str, Declaration]:
    return declarations(MeasurementSettings)


def add_group(parser: argparse.ArgumentParser, title: str, before: str = "") -> Any:
    """Group `title` of a parser, described by `before`, with its settings' options."""
    group = parser.add_argument_group(title, before or None)
    for name, declared in _declared().items():
        if declared.group == title:
            add_setting(group, name)
    return group


def add_setting(group: Any, name: str, default: str | None = None) -> None:
    """Add the option of one setting, with its declared sentence and default.

    A command whose `default` is another says so.
    """
    declared = _declared()[name]
    reader = dict(READERS[declared.kind])
    if declared.kind is not Kind.FLAG:
        reader["metavar"] = declared.metavar
    sentence = declared.sentence.replace("``", "").replace("`", "").replace("*", "")
    help_text = f"{sentence} Default: {default or declared.shown_default}."
    group.add_argument(declared.option, help=help_text.replace("%", "%%"), **reader)


def given_settings(options: argparse.Namespace) -> dict[str, Any]:
    """Values of all settings that the command has options for; None if not given."""
    return {
        name: getattr(options, name) for name in _declared() if hasattr(options, name)
    }
