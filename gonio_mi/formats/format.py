"""The interface of this room: what a format is; and one that is only refused: ALTA."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO

from .scatter import PatchMeans, Points, Scatter


@dataclass(frozen=True)
class Format:
    """A format: how its files are recognised, read and written, and their limits.

    Each module of this room lists its own in `FORMATS`; `reading` finds them there.
    Those that read raise FileFormatError with a sentence on the file.

    Attributes
    ----------
    program : str
        Whose it is.
    endings : tuple of str
        Of the names of its files.
    begins : pattern, optional
        Matches the beginning of its texts; without it the ending decides. A format that
        has it and is `refused` is never known by an ending alone.
    scatter : callable, optional
        Grids of a binary stream: a material, and a table of its nodes.
    points : callable, optional
        Values at pairs of directions, which need be no grid, of a binary stream and the
        quantity that is asked for: None, ``"brdf"`` or ``"btdf"``.
    material : callable, optional
        Means over patches of a binary stream and a lit face, where these are not those
        of `scatter`.
    write : callable, optional
        Writes `Scatter` to a binary stream, with a comment.
    specular : bool
        Whether it writes grids about the specular direction.
    isotropic : bool
        Whether it holds one azimuth of incidence only.
    reflection_only : bool
    n_incidences : int
        Angles of incidence that a file needs at least.
    loses : str
        Properties of a record that it cannot hold, in words.
    refused : str
        Why no reader takes it, in a sentence; empty if one does.
    """

    program: str
    endings: tuple[str, ...]
    begins: re.Pattern[str] | None = None
    scatter: Callable[[BinaryIO], Scatter] | None = None
    points: Callable[[BinaryIO, str | None], Points] | None = None
    material: Callable[[BinaryIO, str], PatchMeans] | None = None
    write: Callable[[Scatter, BinaryIO, str], None] | None = None
    specular: bool = False
    isotropic: bool = False
    reflection_only: bool = False
    n_incidences: int = 1
    loses: str = ""
    refused: str = ""


FORMATS = (
    Format(
        "ALTA",
        (),
        begins=re.compile(
            r"^#[ \t]*(DIM[ \t]+\d+[ \t]+\d+|PARAM_(IN|OUT)[ \t])", re.MULTILINE
        ),
        refused="it is a data file of ALTA, whose parametrisations of directions have "
        "no reader here: write it as a table of theta_i, phi_i, theta_o, phi_o, value",
    ),
)
