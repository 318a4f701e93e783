"""Tabular scatter data of FRED, and of VIAVI's (RPC Photonics') engineered diffusers.

FRED's help ("Tabulated BSDF") describes its text: the line ``type bsdf_data``, a line
such as ``format angles=deg bsdf=value scale=1``, then for each incidence a line with
the polar angle and the azimuth of the *specular* direction, and lines of polar angle
and azimuth from the normal and BSDF in 1/sr; cells are separated by tabs or commas, and
polar angles of scans in the plane are signed. ``angles=sin`` are direction cosines,
those of y before those of x; ``bsdf=log`` is the logarithm to the base of 10. VIAVI's
files ("BSDF Data Format") have two lines that begin with ``!!`` instead of that header,
and one incidence. None says whether its light is reflected or transmitted: FRED itself
takes it for reflected, and of transmission the specular direction is that straight on.
"""

import re
from typing import BinaryIO

import numpy as np

from ...array_types import Floats
from ...errors import SettingError, number_of
from ...files.checks import require
from .format import Format, Lines
from .scatter import Points

FORMAT = {"angles": ("deg", "sin"), "bsdf": ("value", "log")}


def read(stream: BinaryIO, quantity: str | None = None) -> Points:
    """Read the rows of a file of either kind.

    Azimuths of exit are turned by 180 degrees, so that light comes from the azimuth
    that the file gives to the specular direction.

    Raises
    ------
    ValueError
        If VIAVI's kind of file needs the quantity.
    FileFormatError
        If it is something else, damaged or cut.
    """
    lines = Lines(stream)
    first = lines.next()
    notes = ["incidences are given by their specular directions"]
    options = {"angles": "deg", "bsdf": "value", "scale": "1"}
    if first.startswith("!!"):
        require(lines.next() == "!!BSDF Data", "its second line must be !!BSDF Data")
        if quantity is None:
            raise SettingError(
                "it does not say whether its light is reflected or transmitted: say "
                "--quantity brdf or btdf"
            )
    else:
        require(re.fullmatch(r"type bsdf_data", first), "it is not a FRED file")
        line = lines.next().lower()
        require(line.startswith("format"), "its second line must be its format")
        options |= dict(re.findall(r"(\w+)=(\S+)", line))
        for key, known in FORMAT.items():
            only = f"and only {' and '.join(known)} are known"
            require(options[key] in known, f"its {key} are {options[key]:.20}, {only}")
        if quantity is None:
            notes.append("light is taken for reflected, as FRED does by default")
    (scale,) = lines.numbers(1, options["scale"])
    require(bool(np.isfinite(scale)), "its scale is not finite")
    blocks = _blocks(lines)
    notes += _cut(blocks, lines)
    angles, values = [], []
    for incident, rows in blocks:
        at = np.array([[*incident, 0.0], *rows])
        theta, phi, value = at.T
        if options["angles"] == "sin":
            sine, phi = np.hypot(theta, phi), np.degrees(np.arctan2(theta, phi))
            require(bool((sine <= 1).all()), "a direction cosine is above 1")
            theta = np.degrees(np.arcsin(sine))
        phi = np.where(theta < 0, phi + 180, phi)
        theta = np.abs(theta)
        n = len(rows)
        exit_theta = 180 - theta[1:] if quantity == "btdf" else theta[1:]
        pair = np.full((2, n), [[theta[0]], [phi[0]]])
        angles.append(np.stack([*pair, exit_theta, phi[1:] + 180]))
        # the table refuses values that are not finite
        with np.errstate(over="ignore", invalid="ignore"):
            linear = 10 ** value[1:] if options["bsdf"] == "log" else value[1:]
            values.append(scale * linear)
    of_all = np.concatenate(angles, axis=1).T
    lit = np.abs(of_all[:, 2] - 90) > 0
    lit &= (of_all[:, 2] > 90) == (quantity == "btdf")
    require(bool(lit.any()), "all its directions are at or below the horizon")
    if not lit.all():
        left = np.count_nonzero(~lit)
        notes.append(f"{number_of(left, 'row')} at or below the horizon left out")
    of_lit = np.concatenate(values)[lit, None]
    return Points(of_all[lit], of_lit, ("Y",), {}, tuple(notes))


def _blocks(lines: Lines) -> list[tuple[Floats, list[Floats]]]:
    """Angles of each specular direction, and the rows that follow it."""
    blocks: list[tuple[Floats, list[Floats]]] = []
    while line := lines.next():
        n = len(line.replace(",", " ").split())
        require(n in (2, 3), f"line {lines.number} must have 2 or 3 numbers")
        numbers = lines.numbers(n, line)
        if n == 2:
            blocks.append((numbers, []))
        else:
            require(bool(blocks), f"line {lines.number} comes before an incidence")
            blocks[-1][1].append(numbers)
    require(any(rows for _, rows in blocks), "it has no values")
    for incident, rows in blocks:
        angles = ", ".join(f"{angle:g}" for angle in incident)
        require(bool(rows), f"it has no values of the incidence {angles}: it is cut")
    return blocks


def _cut(blocks: list[tuple[Floats, list[Floats]]], lines: Lines) -> list[str]:
    """Note that the last incidence has fewer directions, where the others are alike."""
    last = blocks[-1][1]
    for _, rows in blocks[:-1]:
        longer = len(rows) > len(last)
        if longer and all((a[:2] == b[:2]).all() for a, b in zip(rows, last)):
            words = f"the last incidence has {len(last)} of {len(rows)} directions"
            require(lines.whole_lines, f"{words}, and no end of line: it is cut")
            return [f"{words}: the file may be cut"]
    return []


FORMATS = (
    Format(
        "FRED, VIAVI",
        (),
        begins=re.compile(r"\s*type\s+bsdf_data\s|!![^\n]*\n!!BSDF Data"),
        points=read,
    ),
)
