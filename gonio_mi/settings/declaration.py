"""Declarations of settings, and the rows of manual pages."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from types import MappingProxyType
from typing import Any


class Kind(Enum):
    """How a value is written: in Python, and as a property of a Mitsuba plugin."""

    COUNT = "int", "|int|"
    NUMBER = "float", "|float|"
    WORD = "str", "|string|"
    WORD_OR_NUMBER = "str or float", "|string| or |float|"
    NUMBERS = "sequence of float", "|string|"
    WORDS = "sequence of str", "|string|"
    FLAG = "bool", "|bool|"

    @property
    def python(self) -> str:
        """Type in Python, as numpydoc has it."""
        return self.value[0]

    @property
    def mitsuba(self) -> str:
        """Type of a plugin's property, as Mitsuba's manual has it."""
        return self.value[1]


@dataclass(frozen=True, slots=True)
class Declaration:
    """Declaration of one setting: default, check, unit, sentence.

    Attributes
    ----------
    default : object
        What it is if nobody says anything; parsed.
    check : callable
        ``check(label, value)`` returns the parsed value, or raises a TypeError or
        ValueError that begins with `label`.
    kind : Kind
    sentence : str
        What it means, with its unit; without the default.
    group : str
        Heading of the command line's options, None for what has no option.
    metavar : str
        What stands for the value in the command line's help.
    form : str
        Type in Python; that of `kind`, unless another one is given.
    plugin : str
        Mitsuba plugin that has it as a property, None for none; most often the
        integrator.
    key : str
        Name of that property; that of the setting, unless another one is given.
    text : callable
        Parsed value as a number or text, for properties and records.
    shown_default : str
        How documentation writes the default.
    name : str
        In Python and in records; on the command line with dashes.
    """

    default: Any
    check: Callable[[str, Any], Any]
    kind: Kind
    sentence: str
    group: str | None = None
    metavar: str = "N"
    form: str = ""
    plugin: str | None = "goniophotometer"
    key: str = ""
    text: Callable[[Any], Any] = lambda value: value
    shown_default: str = ""
    name: str = ""

    @property
    def option(self) -> str:
        """Option of the command line."""
        return "--" + self.name.replace("_", "-")

    def named(self, name: str) -> Declaration:
        """Declaration of the field `name`, with all that follows from it."""
        return dataclasses.replace(
            self,
            name=name,
            form=self.form or self.kind.python,
            key=self.key or name,
            shown_default=self.shown_default or str(self.default),
        )


def setting(default: Any, *declared: Any, **more: Any) -> Any:
    """Field of a dataclass of settings; arguments as of :class:`Declaration`."""
    declaration = Declaration(default, *declared, **more)
    return dataclasses.field(default=default, metadata={"declared": declaration})


def declarations(settings: Any) -> Mapping[str, Declaration]:
    """Declarations of a dataclass of settings by name, in their order."""
    return _declarations(settings)


@cache
def _declarations(settings: Any) -> Mapping[str, Declaration]:
    """The same, which are put together once."""
    return MappingProxyType(
        {
            field.name: field.metadata["declared"].named(field.name)
            for field in dataclasses.fields(settings)
        }
    )


def numpydoc(settings: Any) -> str:
    """Rows of a numpydoc section `Parameters`, one for each setting."""
    rows = []
    for declared in declarations(settings).values():
        sentence = f"{declared.sentence} Default ``{declared.shown_default}``."
        body = textwrap.fill(sentence, 80, break_on_hyphens=False)
        rows.append(f"{declared.name} : {declared.form}, optional")
        rows.append(textwrap.indent(body, "    "))
    return textwrap.indent("\n".join(rows), "    ").lstrip()


def plugin_table(text: str | None, settings: Any, plugin: str) -> str:
    """Docstring of `plugin` with a row of its table for each declared property.

    They take the place of ``{parameters}`` below Mitsuba's ``.. pluginparameters::``.
    """
    rows = []
    for declared in declarations(settings).values():
        if declared.plugin == plugin:
            sentence = f"{declared.sentence} (Default: ``{declared.shown_default}``)"
            body = textwrap.fill(sentence, 77, break_on_hyphens=False)
            rows.append(
                f"     * - {declared.key}\n"
                f"       - {declared.kind.mitsuba}\n"
                f"       - {textwrap.indent(body, ' ' * 9).lstrip()}\n"
            )
    return (text or "").replace("{parameters}", "\n".join(rows).strip())
