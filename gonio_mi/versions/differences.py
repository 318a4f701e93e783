"""What two versions say of one BSDF, function by function, and what it means."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

__all__ = ["Difference", "Differences"]


@dataclass(frozen=True)
class Difference:
    """One function, as two versions have it.

    Attributes
    ----------
    function : str
        ``eval``, ``pdf``, ``sample``, ``weights``, ``albedo``, ``flags`` or
        ``parameters``.
    differs : bool
        By more than errors explain.
    size : float
        In units of the error: for ``eval``, ``pdf`` and ``weights`` the most that
        rounding may leave, for ``albedo`` standard errors; 0 without a number.
    text : str
        By how much, and where.
    meaning : str
        What it does to images and scenes, if it differs.
    """

    function: str
    differs: bool
    size: float
    text: str
    meaning: str

    def __str__(self) -> str:
        word = "differs" if self.differs else "same"
        line = f"{word:<9}{self.function:<11} {self.text}"
        if self.differs:
            line += f"\n{'':<21}{self.meaning}"
        return line


@dataclass(frozen=True)
class Differences:
    """What two versions of Mitsuba say of one BSDF.

    Attributes
    ----------
    name : str
        Of the BSDF.
    versions : tuple of str
        Of Mitsuba: here, and there.
    parts : tuple of Difference
    """

    name: str
    versions: tuple[str, str]
    parts: tuple[Difference, ...]

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return not any(part.differs for part in self.parts)

    def __getitem__(self, function: str) -> Difference:
        return {part.function: part for part in self.parts}[function]

    def __str__(self) -> str:
        found = [part.function for part in self.parts if part.differs]
        said = f"differs in {', '.join(found)}" if found else "the same"
        title = (
            f"{self.name}: Mitsuba {self.versions[0]} and {self.versions[1]}: {said}"
        )
        return "\n".join(
            [title, *(f"  {part}".replace("\n", "\n  ") for part in self.parts)]
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON: name, versions, ``same``, and the parts with their attributes.

        A size is None where one version has no finite number.
        """
        return {
            "name": self.name,
            "versions": list(self.versions),
            "same": self.same,
            "parts": [
                {
                    "function": part.function,
                    "differs": part.differs,
                    "size": part.size if math.isfinite(part.size) else None,
                    "text": part.text,
                    "meaning": part.meaning if part.differs else None,
                }
                for part in self.parts
            ],
        }
