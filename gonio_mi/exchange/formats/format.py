"""What formats of this room share: texts read line by line, and their interface.

ALTA, Mitsuba and TracePro have no module: their files are only refused. Nor have the
files of arrays, and text with columns, which `tables` reads under any headings.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from ...array_types import Floats
from ...errors import FileFormatError
from ...files.checks import require
from ...files.numbers import decimal
from ...files.tensor_file import MAGIC
from ...results.patch_means import PatchMeans
from .scatter import Points, Scatter

# Longest line, which is one of values; numbers that a text may announce.
MAX_LINE, MAX_NUMBERS = 10**6, 10**8

# Kinds of channels, in words.
COLOURS, WAVELENGTHS = "R, G, B", "wavelengths"


def without_mark(content: bytes) -> bytes:
    """Text without a byte-order mark, of two bytes a character as one."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", "replace").encode("utf-8")
    return content.removeprefix(b"\xef\xbb\xbf")


class Lines:
    """Lines of a text, one after the other, and the numbers in them.

    Parameters
    ----------
    stream : binary stream
    comment : str
        What lines begin with that are passed over, and kept in `comments`.
    not_text : str
        What to say of a file that is none.

    Raises
    ------
    FileFormatError
        If it is no text; and, of each method, with the number of the line.
    """

    def __init__(
        self, stream: BinaryIO, comment: str = "", not_text: str = "it is not text"
    ) -> None:
        content = without_mark(stream.read())
        require(b"\0" not in content, not_text)
        self.size = len(content)
        self.whole_lines = content.endswith((b"\n", b"\r"))
        text = content.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
        self._text, self._at, self.number = text, 0, 0
        longest = max(map(len, text.split("\n")))
        require(longest <= MAX_LINE, "it has an endless line")
        self._comment = comment
        self.comments: list[str] = []

    def row(self) -> str:
        """Text of the next line, empty ones too."""
        require(self._at < len(self._text), "it ends too soon")
        end = self._text.find("\n", self._at)
        end = len(self._text) if end < 0 else end
        text = self._text[self._at : end]
        self._at, self.number = end + 1, self.number + 1
        return text

    def next(self) -> str:
        """Words of the next line that holds some, single blanks between; or nothing."""
        while self._at < len(self._text):
            text = " ".join(self.row().split())
            if self._comment and text.startswith(self._comment):
                self.comments.append(text.strip(f"{self._comment} "))
            elif text:
                return text
        return ""

    def skip(self, n: int) -> None:
        """Skip n characters."""
        require(0 <= n <= len(self._text) - self._at, "it ends within its header")
        self.number += self._text.count("\n", self._at, self._at + n)
        self._at += n

    def numbers(self, n: int, text: str | None = None) -> Floats:
        """Numbers of the next line, or of a `text` of this one: `n` of them."""
        cells = (self.row() if text is None else text).replace(",", " ").split()
        reason = f"line {self.number} must have {n} numbers, got {len(cells)}"
        require(len(cells) == n, reason)
        try:
            return np.array([decimal(cell) for cell in cells], dtype=float)
        except ValueError as error:
            raise FileFormatError(f"line {self.number}: {error}") from None

    def whole(self, n: int, text: str | None = None) -> list[int]:
        """The same, whole numbers."""
        values = self.numbers(n, text)
        good = (values == np.round(values)) & (np.abs(values) < 1e15)
        require(good.all(), f"line {self.number} must have whole numbers")
        return [int(value) for value in values]

    def counted_numbers(self) -> Floats:
        """Numbers of the next line, which the one before it counts."""
        (n,) = self.whole(1)
        check_size(n)
        return self.numbers(n)


def check_size(*counts: int) -> int:
    """Product of counts that a header announces, if a file can hold as many.

    Raises
    ------
    FileFormatError
        If one is below 1 or the product beyond what any file has.
    """
    product = 1
    for count in counts:
        require(count >= 1, f"it announces a count of {count}")
        product *= count
        require(product <= MAX_NUMBERS, "it announces more values than any file has")
    return product


# ------------------------------------------------------------------------ the interface


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
    writes : tuple of str
        Endings that a record is written to; empty if it is only read.
    write : callable, optional
        Writes `Scatter` to a binary stream, with a comment; without it a format that
        writes needs a renderer, and has its function in `exporting`.
    specular : bool
        Whether it writes grids about the specular direction.
    in_parts : bool
        Whether a file holds one quantity and channel.
    channels : tuple of str
        Kinds of several channels that a file holds: :data:`COLOURS` or
        :data:`WAVELENGTHS`; any if empty.
    polarised : bool
        Whether it holds Mueller matrices.
    isotropic : bool
        Whether it holds one azimuth of incidence only.
    reflection_only : bool
    n_incidences : int
        Angles of incidence that a file needs at least.
    loses : str
        Properties of a record that it cannot hold, in words; empty of a format that is
        only read, since `gonio-mi export --help` prints it.
    refused : str
        Why no reader takes it, in a sentence; empty if one does.
    """

    program: str
    endings: tuple[str, ...]
    begins: re.Pattern[str] | None = None
    scatter: Callable[[BinaryIO], Scatter] | None = None
    points: Callable[[BinaryIO, str | None], Points] | None = None
    material: Callable[[BinaryIO, str], PatchMeans] | None = None
    writes: tuple[str, ...] = ()
    write: Callable[[Scatter, BinaryIO, str], None] | None = None
    specular: bool = False
    in_parts: bool = False
    channels: tuple[str, ...] = ()
    polarised: bool = False
    isotropic: bool = False
    reflection_only: bool = False
    n_incidences: int = 1
    loses: str = ""
    refused: str = ""


FORMATS = (
    Format("text with columns", (), writes=(".csv",), in_parts=True, polarised=True),
    Format("NetCDF", (), writes=(".nc",), polarised=True),
    Format("HDF5", (), writes=(".h5",), polarised=True),
    Format(
        "Mitsuba",
        (".bsdf",),
        begins=re.compile(MAGIC.decode()),
        writes=(".bsdf",),
        channels=(COLOURS, WAVELENGTHS),
        reflection_only=True,
        refused="it is a material of Mitsuba: measure the specimen "
        "measured:filename={path}",
    ),
    Format(
        "ALTA",
        (),
        begins=re.compile(
            r"^#[ \t]*(DIM[ \t]+\d+[ \t]+\d+|PARAM_(IN|OUT)[ \t])", re.MULTILINE
        ),
        refused="it is a data file of ALTA, whose parametrisations of directions have "
        "no reader here: write it as a table of theta_i, phi_i, theta_o, phi_o, value",
    ),
    Format(
        "TracePro",
        (),
        begins=re.compile(r"\*?TracePro Surface Property"),
        refused="it is a surface property of TracePro, whose angles relative to the "
        "specular direction have no reader here: write its BSDF data as a table of "
        "theta_i, phi_i, theta_o, phi_o, value",
    ),
)
