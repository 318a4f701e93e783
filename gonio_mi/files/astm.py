"""BRDF as text after ASTM E1392, the way that Cornell University's archive has it.

The standard (E1392-96, withdrawn; now E2387) is not public. What is known of its data
format comes from two programs that read that archive, KimuraRyo/libbsdf (`AstmReader`)
and ALTA (`data_astm`), and agree: lines of a KEY in capitals and its value, of which
``NUM_POINTS`` counts the rows and ``VARS``, the last, names the columns; then rows of
numbers separated by commas. The first four are the polar angle and the azimuth of
incidence and of scattering in radians, ``theta_i,phi_i,theta_s,phi_s``; where one is
above 2 pi they are taken for degrees. The others are BRDF, named ``R``, ``G``, ``B`` or
by a wavelength such as ``550nm``, or one of any other name for grey. That values are in
1/sr without cosine, and that light mirrored from the azimuth 0 goes to pi, is inferred
from how those programs use them.
"""

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from ..array_types import Floats
from ..errors import FileFormatError
from .header import require
from .numbers import decimal

__all__ = ["ANGLES", "GREY", "read", "write"]

ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")

# ALTA takes a column for grey if its name begins so.
GREY = "Integrated"


def write(
    angles: Floats, values: Floats, names: Sequence[str], stream: BinaryIO, **keys: str
) -> None:
    """Write rows to a binary stream.

    Parameters
    ----------
    angles : ndarray, shape (n, 4)
        :data:`ANGLES` in radians.
    values : ndarray, shape (n, channels)
        BRDF in 1/sr.
    names : sequence of str
        Of the channels.
    **keys : str
        Further lines of the header.
    """
    keys = {name.upper(): " ".join(text.split()) for name, text in keys.items()}
    lines = [f"{key} {text}" for key, text in keys.items()]
    lines += [f"NUM_POINTS {len(angles)}", f"VARS {','.join([*ANGLES, *names])}"]
    rows = np.concatenate([angles, values], axis=1).tolist()
    lines += [",".join(map(repr, row)) for row in rows]
    stream.write(("\n".join(lines) + "\n").encode())


def read(stream: BinaryIO) -> tuple[Floats, Floats, list[str], dict[str, str]]:
    """Read rows from a binary stream.

    Returns
    -------
    angles : ndarray, shape (n, 4)
        In radians.
    values : ndarray, shape (n, channels)
    names : list of str
    keys : dict of str

    Raises
    ------
    FileFormatError
        If it is something else, is damaged or lacks rows.
    """
    content = stream.read()
    require(b"\0" not in content, "it is not text")
    lines = iter(enumerate(content.decode("latin-1").splitlines(), 1))
    keys = {}
    for _, line in lines:
        key, _, text = line.strip().partition(" ")
        if key:
            keys[key] = text.strip()
        if key == "VARS":
            break
    require("VARS" in keys, "it has no line VARS that names its columns")
    names = [name.strip() for name in keys.pop("VARS").split(",")]
    angles, names = names[: len(ANGLES)], names[len(ANGLES) :]
    require(
        tuple(angles) == ANGLES and bool(names),
        f"its VARS must be {','.join(ANGLES)} and channels, got {','.join(angles):.60}",
    )
    rows = [
        _row(number, line, len(ANGLES) + len(names)) for number, line in lines if line
    ]
    announced = keys.pop("NUM_POINTS", str(len(rows)))
    require(
        announced == str(len(rows)),
        f"it announces {announced:.20} points and holds {len(rows)}",
    )
    table = np.array(rows).reshape(len(rows), -1)
    return table[:, : len(ANGLES)], table[:, len(ANGLES) :], names, keys


def _row(number: int, line: str, n: int) -> list[float]:
    """Numbers of one line."""
    cells = line.split(",")
    require(
        len(cells) == n, f"line {number} must have {n} numbers, got {len(cells)} cells"
    )
    try:
        return [decimal(cell) for cell in cells]
    except ValueError as error:
        raise FileFormatError(f"line {number}: {error}") from None
