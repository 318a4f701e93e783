"""Scatter files of Zemax OpticStudio, ``.bsdf``, also called BSDF data interchange.

The format is that of Radiant's Imaging Sphere (R. Rykowski, "BSDF Data Interchange File
Format Specification", Zemax knowledge base, 2008): lines of a keyword, then of angles,
and for each sample rotation and angle of incidence the line ``TIS`` with the total
integrated scatter and one line of values for each azimuth. Angles are in degrees;
values are BRDF or BTDF in 1/sr. ``ScatterRadial`` counts from the specular direction,
``ScatterAzimuth`` about it from the side of the normal; of ``PlaneSymmetrical`` files
the azimuths 0 to 180 stand for both sides. Where the radial angles end before the
horizon, the last value is taken to go on. For transmission the axis is the direction
straight on, and ``AngleOfIncidence`` is its angle, as if nothing were refracted.
``SampleRotation`` is the azimuth of incidence, and azimuths of exit turn counter-
clockwise about the axis, as R. Kimura's libbsdf reads them.
"""

import re
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from ...array_types import Floats
from ...errors import FileFormatError, abridged
from ...files.checks import require
from .format import Format, Lines, check_size
from .scatter import Block, Scatter, total_of

AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
WORDS = ("Source", "Symmetry", "SpectralContent", "ScatterType")
PLANE_SYMMETRICAL, GREY, KINDS = "PlaneSymmetrical", "Monochrome", ("BRDF", "BTDF")
SPECTRA = {
    GREY: (GREY,),
    "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ"),
}


def read(stream: BinaryIO) -> Scatter:
    """Read a file.

    Raises
    ------
    FileFormatError
        If it is something else, damaged, or announces more than it holds.
    """
    lines = Lines(stream, comment="#")
    words, axes = _header(lines)
    kind = words["ScatterType"].upper()
    require(kind in KINDS, f"its ScatterType is {kind:.20}")
    spectrum = words["SpectralContent"]
    require(spectrum in SPECTRA, f"its SpectralContent is {spectrum:.20}")
    symmetric = words["Symmetry"].lower() == PLANE_SYMMETRICAL.lower()
    n = [len(axes[name]) for name in AXES]
    n_values = check_size(*n, len(SPECTRA[spectrum]))
    # a number takes two bytes at least
    require(2 * n_values <= lines.size, "it announces more values than it holds")
    values = np.empty((len(SPECTRA[spectrum]), n[0], n[1], n[3], n[2]))
    totals = np.empty((len(SPECTRA[spectrum]), n[0], n[1]))
    for index, name in enumerate(SPECTRA[spectrum]):
        for expected in (name, "DataBegin"):
            _expect(lines, expected)
        for rotation, incidence in np.ndindex(n[0], n[1]):
            head, _, total = lines.next().partition(" ")
            require(head == "TIS", f"line {lines.number} must begin with TIS")
            totals[index, rotation, incidence] = lines.numbers(1, total)[0]
            for azimuth in range(n[2]):
                row = lines.numbers(n[3], lines.next())
                values[index, rotation, incidence, :, azimuth] = row
        _expect(lines, "DataEnd")
    azimuths = axes["ScatterAzimuth"]
    if symmetric:
        require(
            len(azimuths) == 1 or (azimuths[0] == 0 and azimuths[-1] == 180),
            "it is PlaneSymmetrical, and its azimuths must go from 0 to 180, got "
            f"{azimuths[0]:g} to {azimuths[-1]:g}",
        )
    blocks = [
        Block(
            theta_i=float(axes["AngleOfIncidence"][incidence]),
            phi_i=float(axes["SampleRotation"][rotation]),
            hemisphere=KINDS.index(kind),
            polar=axes["ScatterRadial"],
            azimuth=azimuths,
            values=np.moveaxis(values[:, rotation, incidence], 0, -1),
            specular=True,
            total=totals[:, rotation, incidence],
        )
        for rotation, incidence in np.ndindex(n[0], n[1])
    ]
    channels = ("Y",) if spectrum == GREY else ("X", "Y", "Z")
    comment = abridged("; ".join(filter(None, lines.comments)), 2000)
    notes = ("angles of exit count from the specular direction",)
    return Scatter(blocks, channels, {"comment": comment} if comment else {}, notes)


def write(scatter: Scatter, stream: BinaryIO, comment: str) -> None:
    """Write blocks about the specular direction, all on one grid, of one channel.

    Parameters
    ----------
    scatter : Scatter
        Of reflection or of transmission.
    stream : binary stream
    comment : str
        What was measured.
    """
    first = scatter.blocks[0]
    rotations = sorted({block.phi_i for block in scatter.blocks})
    incidences = sorted({block.theta_i for block in scatter.blocks})
    by_angles = {(block.phi_i, block.theta_i): block for block in scatter.blocks}
    symmetry = "Asymmetrical" if len(rotations) == 1 else "Asymmetrical4D"
    symmetry = PLANE_SYMMETRICAL if first.holds_one_side else symmetry
    words = "Measured", symmetry, GREY, KINDS[first.hemisphere]
    lines = [f"# gonio-mi: {' '.join(comment.split())}, {scatter.channels[0]}"]
    lines += [f"{key}  {word}" for key, word in zip(WORDS, words)]
    grid: list[Sequence[float]] = [rotations, incidences]
    grid += [first.azimuth.tolist(), first.polar.tolist()]
    for name, angles in zip(AXES, grid):
        lines += [f"{name}  {len(angles)}", "\t".join(f"{a:.9g}" for a in angles)]
    lines += ["", GREY, "DataBegin"]
    for rotation in rotations:
        for incidence in incidences:
            block = by_angles[rotation, incidence]
            total = total_of(block) if block.total is None else block.total
            lines.append(f"TIS  {total[0]:.6f}")
            rows = block.values[..., 0].T
            lines += ["\t".join(f"{value:.5e}" for value in row) for row in rows]
    lines.append("DataEnd")
    stream.write(("\n".join(lines) + "\n").encode("ascii", "replace"))


def _expect(lines: Lines, word: str) -> None:
    """Raise FileFormatError unless the next line is a word."""
    require(lines.next() == word, f"line {lines.number} must be {word}")


def _header(lines: Lines) -> tuple[dict[str, str], dict[str, Floats]]:
    """Words and angles of the header."""
    words: dict[str, str] = {}
    axes: dict[str, Floats] = {}
    while text := lines.next():
        key, _, setting = text.partition(" ")
        if key in WORDS:
            words[key] = setting
        else:
            known = key in AXES
            require(known, f"line {lines.number} has the unknown keyword {key:.30}")
            (count,) = lines.whole(1, setting)
            check_size(count)
            axes[key] = lines.numbers(count, lines.next())
        if len(words) == len(WORDS) and len(axes) == len(AXES):
            return words, axes
    missing = [name for name in (*WORDS, *AXES) if name not in words | dict(axes)]
    raise FileFormatError(f"it has no line {' or '.join(missing)}")


FORMATS = (
    Format(
        "Zemax OpticStudio",
        (".bsdf",),
        begins=re.compile(r"^[ \t]*ScatterType\s", re.MULTILINE),
        scatter=read,
        writes=(".zemax.bsdf",),
        write=write,
        specular=True,
        in_parts=True,
        loses="detail finer than its grid",
    ),
)
