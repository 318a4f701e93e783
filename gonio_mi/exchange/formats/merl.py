"""Isotropic BRDFs in the ``.binary`` files of the MERL database.

The layout is that of the database's own reader (W. Matusik et al., "A data-driven
reflectance model", 2003; ``BRDFRead.cpp`` of 2005): three int32 with the numbers of
cells, 90, 90 and 180, then float64 for red, green and blue, each with the half angle
slowest and the azimuth of the difference angle fastest. Cells of the half angle grow
as its square root; red is stored 1500 times, green 1500 / 1.15 and blue 1500 / 1.66
times as large as the BRDF in 1/sr. Negative values mark cells that were not measured.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from ...array_types import Floats
from ...collector.directions import angles, direction
from ...files.checks import require, size_of
from .format import COLOURS, Format
from .scatter import AROUND, RADIAL, Block, Scatter

CELLS = (90, 90, 180)
SCALES = np.array([1.0, 1.15, 1.66]) / 1500

# Incident directions that the table is taken at.
THETA_I = tuple(range(0, 90, 5))

# Values that are asked for at once.
CELLS_AT_ONCE = 2**16


def read(stream: BinaryIO, incidences: Sequence[float] = THETA_I) -> Scatter:
    """Read a file at some angles of incidence in degrees, about the mirror direction.

    Raises
    ------
    FileFormatError
        If the file has other numbers of cells, another size, or values not finite.
    """
    size = size_of(stream)
    n = int(np.prod(CELLS))
    require(size == 12 + 3 * 8 * n, f"it has {size} bytes instead of {12 + 24 * n}")
    cells = tuple(np.frombuffer(stream.read(12), "<i4").tolist())
    require(cells == CELLS, f"it has {cells} cells instead of {CELLS}")
    table = np.frombuffer(stream.read(), "<f8").reshape(3, *CELLS)
    require(bool(np.isfinite(table).all()), "a value is not finite")
    blocks = []
    for theta_i in incidences:
        empty = np.zeros((len(RADIAL), len(AROUND), 1))
        frame = Block(float(theta_i), 0.0, 0, RADIAL, AROUND, empty, specular=True)
        wo = frame.directions()
        # below the horizon as on it, so that nothing is interpolated towards black
        wo[..., 2] = np.maximum(wo[..., 2], 1e-3)
        wo /= np.linalg.norm(wo, axis=-1, keepdims=True)
        wi = direction(np.radians(theta_i), 0.0)
        row, column, turn = _cells(wi, wo)
        values = table[:, row, column, turn]
        values = np.moveaxis(np.maximum(values, 0), 0, -1) * SCALES
        blocks.append(replace(frame, values=values))
    return Scatter(blocks, ("R", "G", "B"))


def write(value: Callable[[Floats, Floats], Floats], stream: BinaryIO) -> None:
    """Write the values of a function in the middles of the cells.

    A cell holds both senses of a pair of directions: their mean is written.

    Parameters
    ----------
    value : callable
        BRDF in 1/sr, shape ``(n, 3)``, of angles of incidence in degrees, shape
        ``(n,)``, at the azimuth 0, and unit vectors of exit, shape ``(n, 3)``.
    stream : binary stream
    """
    n = int(np.prod(CELLS))
    table = np.full((3, n), -1.0)
    for begin in range(0, n, CELLS_AT_ONCE):
        index = np.arange(begin, min(begin + CELLS_AT_ONCE, n))
        row, column, turn = np.unravel_index(index, CELLS)
        sums = np.zeros((len(index), 3))
        for half_turn in (0, CELLS[2]):
            theta_i, wo = _directions(row, column, turn + half_turn)
            above = (wo[:, 2] > 0) & (theta_i < 90)
            sums[above] += value(theta_i[above], wo[above]) / 2
        table[:, index[above]] = (sums[above] / SCALES).T
    stream.write(np.array(CELLS, "<i4").tobytes() + table.astype("<f8").tobytes())


def _cells(wi: Floats, wo: Floats) -> tuple[np.ndarray, ...]:
    """Indices of the cells that pairs of directions fall into."""
    half = wi + wo
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    theta_h = np.arccos(np.clip(half[..., 2], -1, 1))
    phi_h = np.arctan2(half[..., 1], half[..., 0])
    # wi turned so that the half vector is +z
    x = wi[0] * np.cos(phi_h) + wi[1] * np.sin(phi_h)
    y = wi[1] * np.cos(phi_h) - wi[0] * np.sin(phi_h)
    x, z = (
        x * np.cos(theta_h) - wi[2] * np.sin(theta_h),
        x * np.sin(theta_h) + wi[2] * np.cos(theta_h),
    )
    theta_d = np.arccos(np.clip(z, -1, 1))
    phi_d = np.mod(np.arctan2(y, x), np.pi)
    rows = np.sqrt(theta_h / (np.pi / 2)) * CELLS[0]
    columns = theta_d / (np.pi / 2) * CELLS[1]
    turns = phi_d / np.pi * CELLS[2]
    return tuple(
        np.clip(cell.astype(int), 0, count - 1)
        for cell, count in zip((rows, columns, turns), CELLS)
    )


def _directions(
    row: np.ndarray, column: np.ndarray, turn: np.ndarray
) -> tuple[Floats, Floats]:
    """Angles of incidence in degrees, and exits for incidence from the azimuth 0."""
    from scipy.spatial.transform import Rotation  # slow to import, and rarely needed

    theta_h = ((row + 0.5) / CELLS[0]) ** 2 * (np.pi / 2)
    theta_d = (column + 0.5) / CELLS[1] * (np.pi / 2)
    phi_d = (turn + 0.5) / CELLS[2] * np.pi
    wi = direction(theta_d, phi_d)
    wo = wi * [-1, -1, 1]
    tilt = Rotation.from_euler("y", theta_h[:, None])
    theta_i, phi_i = angles(tilt.apply(wi))
    back: Any = Rotation.from_euler("z", -phi_i[:, None])
    return np.degrees(theta_i), back.apply(tilt.apply(wo))


FORMATS = (
    Format(
        "MERL database",
        (".binary",),
        scatter=read,
        writes=(".binary",),
        channels=(COLOURS,),
        isotropic=True,
        reflection_only=True,
        loses="transmission, anisotropy, non-reciprocity",
    ),
)
