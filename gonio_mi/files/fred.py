"""Tabular scatter data of FRED, text that begins with ``type bsdf_data``.

What is known of it comes from FRED's help ("Tabulated BSDF") and from a file that was
written beside one for Zemax from the same measurement (ua-loft/bsdf-tools): a line
``format angles=deg bsdf=value scale=1``, then for each incidence a line with the polar
angle and the azimuth of the *specular* direction, and lines of polar angle and azimuth
from the normal and BSDF in 1/sr.
"""

import re
from typing import BinaryIO

import numpy as np

from ..array_types import Floats
from ..errors import FileFormatError
from .header import require
from .numbers import decimal

__all__ = ["is_fred", "read"]

FORMAT = {"angles": "deg", "bsdf": "value"}


def is_fred(content: bytes) -> bool:
    """Whether a file begins as such files do."""
    return re.match(rb"\s*type\s+bsdf_data\s", content) is not None


def read(stream: BinaryIO) -> Floats:
    """Rows of theta_i, phi_i, theta_o, phi_o in degrees and BSDF in 1/sr, shape (n, 5).

    Azimuths of exit are turned by 180 degrees, so that light comes from the azimuth
    that the file gives to the specular direction.

    Raises
    ------
    FileFormatError
        If it is something else, or damaged.
    """
    lines = stream.read().decode("latin-1").splitlines()
    require(len(lines) > 1 and is_fred(lines[0].encode() + b"\n"), "it is none of FRED")
    scale = _scale(lines[1])
    incident = None
    rows = []
    for number, line in enumerate(lines[2:], 3):
        cells = line.split()
        require(len(cells) in (0, 2, 3), f"line {number} must have 2 or 3 numbers")
        try:
            numbers = [decimal(cell) for cell in cells]
        except ValueError as error:
            raise FileFormatError(f"line {number}: {error}") from None
        if len(numbers) == 2:
            incident = numbers
        elif numbers:
            require(incident is not None, f"line {number} comes before an incidence")
            theta, phi, value = numbers
            rows.append([*(incident or []), theta, phi + 180, scale * value])
    require(bool(rows), "it has no values")
    return np.array(rows)


def _scale(line: str) -> float:
    """Factor of all values, from the line of the format."""
    words = dict(re.findall(r"(\w+)=(\S+)", line.lower()))
    require(line.lower().startswith("format"), "its second line must be its format")
    for key, known in FORMAT.items():
        said = words.get(key, known)
        require(said == known, f"its {key} are {said:.20}, and only {known} is known")
    try:
        scale = decimal(words.get("scale", "1"))
    except ValueError as error:
        raise FileFormatError(f"its scale {error}") from None
    require(bool(np.isfinite(scale)), "its scale is not finite")
    return scale
