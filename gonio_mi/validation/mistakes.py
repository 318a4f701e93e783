"""What is found: a claim, guilty functions, and mistakes by code with a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, Flag, auto
from typing import Any


@dataclass(frozen=True)
class Claim:
    """A property as a function states it, by whose source a script shows a finding.

    Attributes
    ----------
    stated : callable
        Takes a BSDF, a context, interactions, random numbers and what is `given`;
        returns what should be equal.
    judge : callable
        Takes that, and prints two numbers and how far apart they are.
    given : tuple
        Functions, text and numbers.
    """

    stated: Callable[..., Any]
    judge: Callable[..., None]
    given: tuple[Any, ...] = ()

    def of(self, *given: Any) -> Claim:
        """The same mistake of the object named after it."""
        return Claim(self.stated, self.judge, (*self.given, *given))


class Function(Flag):
    """Functions of a plugin; of several, nothing tells which is wrong."""

    FLAGS = auto()
    EVAL = auto()
    SAMPLE = auto()
    PDF = auto()
    EVAL_PDF = auto()
    EVAL_PDF_SAMPLE = auto()
    EVAL_DIFFUSE_REFLECTANCE = auto()
    EVAL_NULL_TRANSMISSION = auto()
    PROJECTED_AREA = auto()
    TRAVERSE = auto()
    PARAMETERS_CHANGED = auto()
    TO_STRING = auto()
    OTHER = auto()

    @classmethod
    def named(cls, name: str) -> Function:
        """The one function of a name."""
        return cls.__members__.get(name.upper(), cls.OTHER)

    @property
    def names(self) -> list[str]:
        """Name of each, as the plugin has it."""
        return [one.name.lower() for one in type(self) if one.name and one in self]

    @property
    def quoted(self) -> str:
        """All of them in a sentence."""
        return " or ".join(f"`{name}`" for name in self.names)

    def __str__(self) -> str:
        return " or ".join(self.names)


EVAL, SAMPLE, PDF, FLAGS = Function.EVAL, Function.SAMPLE, Function.PDF, Function.FLAGS
EVAL_PDF = Function.EVAL_PDF


class Mistake(Enum):
    """Mistakes by their codes, each with a sentence about the functions {who}.

    What varies stands in braces; a module of a check has those that it finds.
    """

    def __init__(self, sentence: str) -> None:
        self.sentence = " ".join(sentence.split())

    def __call__(self, functions: Function, **fields: Any) -> Guess:
        """The mistake of some functions, with what varies."""
        return Guess(functions, self, fields)


@dataclass(frozen=True)
class Guess:
    """Functions that are likely guilty, and their mistake.

    Attributes
    ----------
    functions : Function
    mistake : Mistake
    fields : dict
        What varies in its sentence.
    """

    functions: Function
    mistake: Mistake
    fields: Mapping[str, Any]

    def __str__(self) -> str:
        return self.mistake.sentence.format(who=self.functions.quoted, **self.fields)
