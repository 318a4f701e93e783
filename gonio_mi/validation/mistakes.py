"""What is found: its kind, guilty functions, and mistakes by code with a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, Flag, auto
from typing import Any

# What a finding is about: a property, or one aspect of it. The part of that name in
# `scripts` shows it.
Kind = Enum(
    "Kind",
    "ANSWERS RAISES OTHER_WHEN_CALLED_AGAIN OTHER_IN_ANOTHER_PLACE OTHER_IN_THE_WORLD "
    "OTHER_IN_ANOTHER_NUMBER ALBEDO DIRECTIONS LENGTH ETA_OF_REFLECTION SAMPLING "
    "WEIGHTS MASS MASS_OF_A_DARK_SIDE LIGHT_OF_A_DARK_SIDE ENERGY SAMPLED_PDF "
    "SAMPLED_WEIGHT EVAL_PDF EVAL_PDF_ANYWHERE EVAL_PDF_SAMPLE OTHER_SAMPLES ETA "
    "CONTINUITY JUMP_AT_NORMAL RECIPROCITY SYMMETRY SYMMETRY_OF_MICROFLAKES "
    "RECIPROCITY_OF_A_LOBE ADJOINT ADJOINT_OF_A_LOBE DELTA NULL_TRANSMISSION "
    "DIRECTION_OF_A_LOBE WEIGHTS_OF_A_LOBE TYPE_OF_A_COMPONENT DIFFERENTIALS FLAGS "
    "UNDECLARED_SIDE TYPE_MASK ANISOTROPIC COMPONENTS LOBE_OF_A_COMPONENT MASKS "
    "MASKS_OF_OTHERS ENDS LENGTH_AT_AN_END GRADIENT UPDATE PARAMETERS "
    "DENSITY_AFTER_A_CHANGE",
)

# The same of Mueller matrices.
MatrixKind = Enum(
    "MatrixKind",
    "ANSWERS FIRST_ELEMENT SAMPLED_WEIGHT EVAL_PDF REALISABLE ENERGY FRAMES JUMP "
    "WORLD RECIPROCITY ADJOINT",
)


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
