"""What a text of columns leaves open, which is asked for in one sentence."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, abridged
from .column_names import ANGLES, Column
from .measured_table import QUANTITIES
from .text_table import TextTable

__all__ = [
    "OpenQuestionsError",
    "angle_units",
    "channel_question",
    "check_nothing_open",
    "missing_columns",
    "quantity_question",
    "quantity_said",
    "titled_quantity",
]

# What titles and names of files call the quantities.
HINTS = (
    (r"\b(BRF|reflectance factors?|radiance factors?)\b", "reflectance_factor"),
    (r"\b(cosine.corrected BRDF|CCBRDF|BRDF ?[*x] ?cos)", "brdf_cos"),
    (r"\bBTDF\b", "btdf"),
    (r"\bBRDF\b", "brdf"),
)


class OpenQuestionsError(FileFormatError):
    """A text that leaves questions open."""

    def __init__(self, message: str, place: str, questions: Sequence[str]) -> None:
        super().__init__(message)
        self.place, self.questions = place, list(questions)


def check_nothing_open(place: str, questions: Sequence[str]) -> None:
    """Raise OpenQuestionsError with all that is to be said of the text at `place`.

    Several questions leave no room for the folder: a long message loses its middle.
    """
    if not questions:
        return
    said = f"{place}: {questions[0]}"
    if len(questions) > 1:
        each = "; ".join(f"({i}) {one}" for i, one in enumerate(questions, 1))
        said = f"{Path(place).name} leaves open: {each}"
    raise OpenQuestionsError(said, place, questions)


def titled_quantity(text: TextTable) -> str | None:
    """The one quantity that the lines before the columns name, if they do."""
    title = "\n".join(line for _, line in (*text.titles, *text.comments))
    found = {
        q for pattern, q in HINTS if re.search(pattern, title.replace("_", " "), re.I)
    }
    return found.pop() if len(found) == 1 else None


def quantity_said(text: TextTable, values: Sequence[Column]) -> bool:
    """Whether the names of columns of values, or the title, say what they are."""
    named = any(column.quantity for column in values)
    return named or titled_quantity(text) is not None


def quantity_question(name: str = "") -> str:
    """Question what the values are, of the column of that name if it is known."""
    called = f" ({name.strip()!r:.40})" if name else ""
    return (
        f"it does not say what its values{called} are: say --quantity "
        f"{', '.join(QUANTITIES[:-1])} or {QUANTITIES[-1]}"
    )


def missing_columns(
    known: Sequence[Column | None], constants: Mapping[str, float]
) -> list[str]:
    """Question for the columns that no text can do without."""
    needed = ["theta_i", "theta_o", "value"]
    own = {column.role for column in known if column is not None} - set(constants)
    there = own | set(constants)
    if "phi_i" in own:
        needed.append("phi_o")
    if "delta_phi" in there:
        there.add("phi_o")
    lacks = [role for role in needed if role not in there]
    if not lacks:
        return []
    said = " ".join(f"{role}=NAME" for role in lacks)
    if len(lacks) == 1:
        what = f"the column {lacks[0]} is missing; if another name stands for it"
    else:
        names = f"{', '.join(lacks[:-1])} and {lacks[-1]}"
        what = f"the columns {names} are missing; if other names stand for them"
    return [f"{what}, say --columns {said}"]


def channel_question(names: Iterable[str]) -> str:
    """Question which channel is meant."""
    known = abridged(", ".join(names), 120)
    return f"channel must be one of {known}: say --channel"


def angle_units(arrays: Mapping[str, Any], picked: Mapping[str, Column]) -> list[str]:
    """Question for angles that may be in either of two units."""
    silent = [r for r in ANGLES if r in picked and not picked[r].unit]
    if not silent:
        return []
    largest = max(np.abs(arrays[role]).max() for role in silent)
    whole = all((arrays[role] == np.round(arrays[role])).all() for role in silent)
    if not 0 < largest <= 2 * np.pi or whole:
        return []
    role = silent[0]
    return [
        f"angles up to {largest:.4g} may be degrees or radians: say --columns "
        f"{role}='{picked[role].name.strip()}:rad' (or :deg), and so of each"
    ]
