"""BRDF look-up tables of ASAM OpenMATERIAL 3D, JSON.

Its schema (``material_brdf_schema.json``, version 1.0.0) has rows of wavelength in m,
angle of incidence, polar angle and azimuth of exit in radians, and BRDF in 1/sr, sorted
by their columns. The azimuth is "relative to the incident azimuth angle": 0 is the side
of the source. What the schema asks of the values that are written or read here is
checked: types, ranges, required keys and formats.
"""

import json
import re
import uuid
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from ...array_types import Floats
from ...errors import FileFormatError, abridged
from ...files.checks import require
from ...results.record import wavelengths_nm
from .format import MAX_NUMBERS, WAVELENGTHS, Format, without_mark
from .scatter import Block, Points, Scatter

SCHEMA = (
    "https://raw.githubusercontent.com/asam-ev/OpenMATERIAL-3D/refs/tags/v1.0.0/schemas/"
    "material_brdf_schema.json"
)
# What our files say beside a name and a UUID; the schema requires all of it.
METADATA = {
    "materialVersion": "1.0.0",
    "openMaterial3dVersion": "1.0.0",
    "copyrights": ["not stated"],
    "license": "not stated",
    "authors": ["gonio-mi"],
    "sources": "simulated",
}
PATTERNS = {
    "uuid": r"[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}",
    "materialVersion": r"\d+\.\d+\.\d+",
    "openMaterial3dVersion": r"\d+\.\d+\.\d+",
}

# Least and greatest value of each column.
MINIMA = np.array([1e-9, 0, 0, 0, 0])
MAXIMA = np.array([17.16e-3, 1.570796, 1.570796, 6.283185, np.inf])
COLUMNS = ("wavelength", "incident zenith", "exit zenith", "exit azimuth", "BRDF")

# Angles in degrees that differ by less are the same.
ANGLE_TOLERANCE = 1e-3

# Digits of angles, rounded down so that they stay in the schema's ranges.
STEPS_PER_RADIAN = 1e6

# What stands for a channel without a wavelength, in nm.
GREY = 550.0


def _rows(stream: BinaryIO) -> tuple[Floats, dict[str, str]]:
    """Rows of a table, shape (n, 5), angles in degrees and wavelengths in nm; metadata.

    Raises
    ------
    FileFormatError
        If it is no such table, or against the schema.
    """
    try:
        content = json.loads(without_mark(stream.read()).decode())
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"it is not JSON: {error!s:.80}") from None
    require(isinstance(content, Mapping), "it is not a JSON object")
    metadata, brdf = content.get("metadata"), content.get("brdf")
    require(
        isinstance(metadata, Mapping), "not an OpenMATERIAL table: it has no metadata"
    )
    require(isinstance(brdf, Mapping), "not an OpenMATERIAL table: it has no brdf")
    for key in ("name", "uuid", *METADATA):
        require(key in metadata, f"its metadata lack {key}")
    for key, pattern in PATTERNS.items():
        text = metadata[key]
        reason = f"its {key} does not match the format, got {text!r:.60}"
        require(isinstance(text, str) and re.fullmatch(pattern, text), reason)
    table = _table(brdf.get("lookupTable"))
    listed: Any = brdf.get("wavelengths")
    good = isinstance(listed, list) and all(type(nm) in (int, float) for nm in listed)
    require(good, "it has no list of wavelengths")
    stated, held = np.unique(np.array(listed, dtype=float)), np.unique(table[:, 0])
    good = stated.shape == held.shape and np.allclose(stated, held, rtol=1e-6, atol=0)
    require(good, "its wavelengths are not those of its lookupTable")
    known = {k: " ".join(v.split()) for k, v in metadata.items() if isinstance(v, str)}
    table[:, 0] *= 1e9
    # six digits of pi are all that the schema allows
    table[:, 1:4] = np.round(np.degrees(table[:, 1:4]), 4)
    return table, known


def _table(listed: Any) -> Floats:
    """Look-up table as it is written."""
    require(isinstance(listed, list) and len(listed) > 0, "it has no lookupTable")
    require(len(listed) * 5 <= MAX_NUMBERS, "it has more values than any file")
    numbers = (int, float)
    for index, row in enumerate(listed):
        good = isinstance(row, list) and len(row) == 5
        good = good and all(type(cell) in numbers for cell in row)
        require(good, f"row {index} of its lookupTable must have 5 numbers")
    try:
        table = np.array(listed, dtype=float)
    except OverflowError:
        raise FileFormatError("its lookupTable has an absurd number") from None
    good = (table >= MINIMA) & (table <= MAXIMA * (1 + 1e-6)) & np.isfinite(table)
    if not good.all():
        row, column = np.argwhere(~good)[0]
        raise FileFormatError(
            f"row {row} of its lookupTable has the {COLUMNS[column]} "
            f"{table[row, column]:g}"
        )
    return table


def points(stream: BinaryIO, _: str | None) -> Points:
    """Rows of a table, which need be no grid, without those at 90 degrees.

    Raises
    ------
    FileFormatError
        If it is no such table, or against the schema.
    """
    table, header = _rows(stream)
    inside = (table[:, 1] < 90) & (table[:, 2] < 90)
    require(bool(inside.any()), "it has no directions above the horizon")
    notes = ["azimuths count from the source"]
    if not inside.all():
        n, left = len(table), np.count_nonzero(~inside)
        notes.append(f"{left} of {n} rows, at 90 degrees, are left out")
    nm, channel = np.unique(table[inside, 0], return_inverse=True)
    table = table[inside]
    values = np.full((len(table), len(nm)), np.nan)
    values[np.arange(len(table)), channel] = table[:, 4]
    angles = np.insert(table[:, 1:4], 1, 0.0, axis=1)
    names = tuple(f"{one:.6g}nm" for one in nm)
    return Points(angles, values, names, header, tuple(notes), partial=True)


def read(stream: BinaryIO) -> Scatter:
    """Read a table that is a grid of exits for each incidence.

    Raises
    ------
    FileFormatError
        If it is no such table, against the schema, or no grid.
    """
    table, header = _rows(stream)
    wavelengths = np.unique(table[:, 0])
    blocks = []
    for theta_i in np.unique(table[:, 1]):
        here = table[np.abs(table[:, 1] - theta_i) < ANGLE_TOLERANCE]
        polar, azimuth = np.unique(here[:, 2]), np.unique(here[:, 3])
        azimuth = azimuth[azimuth < 360 - ANGLE_TOLERANCE]
        here = here[here[:, 3] < 360 - ANGLE_TOLERANCE]
        grid = np.full((len(polar), len(azimuth), len(wavelengths)), np.nan)
        axes = ((polar, 2), (azimuth, 3), (wavelengths, 0))
        place = tuple(np.searchsorted(axis, here[:, i]) for axis, i in axes)
        grid[place] = here[:, 4]
        pole = polar < ANGLE_TOLERANCE  # with a value for one azimuth or for all
        known_pole = ~np.isnan(grid[pole])
        n_known = known_pole.sum(axis=1, keepdims=True)
        known = np.nansum(grid[pole], axis=1, keepdims=True) / np.maximum(n_known, 1)
        grid[pole] = np.where(~known_pole & (n_known > 0), known, grid[pole])
        require(
            bool(np.isfinite(grid).all()) and len(azimuth) > 2,
            f"its exits for incidence at {theta_i:g} degrees form no grid over the "
            "hemisphere: it is a table to compare with, but no material",
        )
        turned = _from_the_other_side(azimuth)
        order = np.argsort(turned)
        if theta_i < 90 - ANGLE_TOLERANCE:
            values = grid[:, order]
            blocks.append(Block(float(theta_i), 0.0, 0, polar, turned[order], values))
    channels = tuple(f"{nm:.6g}nm" for nm in wavelengths)
    return Scatter(blocks, channels, header)


def write(scatter: Scatter, stream: BinaryIO, name: str) -> None:
    """Write the reflection of blocks about the normal.

    Parameters
    ----------
    scatter : Scatter
        Isotropic.
    stream : binary stream
    name : str
        Of the material.
    """
    nm = wavelengths_nm(scatter.channels)
    nm = np.array([GREY]) if nm is None else nm
    table = []
    for number in np.argsort(nm).tolist():
        wavelength = float(f"{nm[number] * 1e-9:.9g}")
        for block in sorted(scatter.of(0), key=lambda b: b.theta_i):
            azimuth = _from_the_other_side(block.azimuth)
            order = np.argsort(azimuth, kind="stable")
            for polar, row in zip(block.polar, block.values[..., number]):
                table += [
                    [wavelength, _radians(block.theta_i), _radians(polar),
                     _radians(azimuth[k]), float(f"{row[k]:.7g}")]
                    for k in (order[:1] if polar == 0 else order)
                ]  # fmt: skip
    unique = str(uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(table)))
    metadata = {"name": abridged(name, 80), "uuid": unique} | METADATA
    wavelengths = sorted({row[0] for row in table})
    brdf = {"wavelengths": wavelengths, "lookupTable": table}
    content = {"$schema": SCHEMA, "metadata": metadata, "brdf": brdf}
    stream.write(json.dumps(content, allow_nan=False).encode())


def _from_the_other_side(azimuth: Floats) -> Floats:
    """Azimuths from the mirror direction of azimuths from the source, and back."""
    return np.mod(azimuth + 180, 360)


def _radians(degrees: float) -> float:
    """Radians with the digits that the schema has, never above its limits."""
    return float(np.floor(np.radians(degrees) * STEPS_PER_RADIAN) / STEPS_PER_RADIAN)


FORMATS = (
    Format(
        "ASAM OpenMATERIAL 3D",
        (".json", ".xompt"),
        scatter=read,
        points=points,
        writes=(".json", ".xompt"),
        write=write,
        channels=(WAVELENGTHS,),
        isotropic=True,
        reflection_only=True,
        loses="transmission, azimuth of incidence",
    ),
)
