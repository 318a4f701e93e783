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

from typing import BinaryIO

import numpy as np

from ...files.checks import require
from .format import Format, Lines
from .scatter import Points

ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")


def read(stream: BinaryIO, _: str | None = None) -> Points:
    """Read rows from a binary stream.

    Raises
    ------
    FileFormatError
        If it is something else, is damaged or lacks rows.
    """
    lines = Lines(stream)
    keys: dict[str, str] = {}
    while "VARS" not in keys and (line := lines.next()):
        key, _, text = line.partition(" ")
        keys[key] = text
    require("VARS" in keys, "it has no line VARS that names its columns")
    names = [name.strip() for name in keys.pop("VARS").split(",")]
    angles, names = names[: len(ANGLES)], names[len(ANGLES) :]
    require(
        tuple(angles) == ANGLES and bool(names),
        f"its VARS must be {','.join(ANGLES)} and channels, got {','.join(angles):.60}",
    )
    n = len(ANGLES) + len(names)
    rows = []
    while line := lines.next():
        rows.append(lines.numbers(n, line))
    announced = keys.pop("NUM_POINTS", str(len(rows)))
    require(
        announced == str(len(rows)),
        f"it announces {announced:.20} points and holds {len(rows)}",
    )
    require(bool(rows), "it has no rows of values")
    table = np.array(rows)
    in_degrees = np.abs(table[:, : len(ANGLES)]).max() > 2 * np.pi
    unit = "degrees" if in_degrees else "radians"
    return Points(
        table[:, : len(ANGLES)] * (1.0 if in_degrees else np.degrees(1.0)),
        table[:, len(ANGLES) :],
        tuple(names),
        keys,
        (f"angles are in {unit}",),
    )


FORMATS = (
    Format(
        "ASTM E1392",
        (".astm",),
        points=read,
        reflection_only=True,
    ),
)
