"""Bases of Radiance's BSDF files: patches, incident light and colours, both ways.

Radiance names the incident patch by the azimuth of flight. Klems matrices are rows of
exit and columns of incidence; :mod:`.tensor_tree` has the axes of trees.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats, Integers
from ...collector.borders import Borders
from ...collector.directions import angles, direction as unit_vectors
from ...collector.hemisphere import Subdivision
from ...collector.klems import KLEMS
from ...collector.shirley_chiu import ShirleyChiu
from ...results.record import XYZ
from .tensor_tree import (
    MERGE_TOLERANCE,
    TensorTree,
    coordinates,
    isotropic_coordinate,
    isotropic_incidence,
)

# Ranks of tensor trees by our names.
RANKS = {"tensor3": 3, "tensor4": 4}

# What a file may be written in.
BASES = (*KLEMS, *RANKS)

# Names of the blocks of three colours.
MATRIX_NAMES = ("CIE-X", "Visible", "CIE-Z")
TREE_NAMES = ("Visible", "CIE-u", "CIE-v")

# u' and v' of equal energy, which black has in Radiance.
WHITE = (4 / 19, 9 / 19)

# Azimuth of incidence in degrees of light that flies to +x, which trees of rank 3 hold,
# and half the width of those over which they average if they are measured.
TO_X, HALF_WEDGE = 180.0, 0.05


@dataclass(frozen=True)
class Basis:
    """What the blocks of a file are made of: matrices, or trees.

    Attributes
    ----------
    rank : {None, 3, 4}
        Of tensor trees; None for Klems matrices.
    size : int
        Cells per axis of trees, and of matrices the number of patches.
    """

    rank: int | None
    size: int

    @classmethod
    def of(cls, block: Floats | TensorTree) -> "Basis":
        """Basis of a block."""
        if isinstance(block, TensorTree):
            return cls(block.rank, block.size)
        return cls(None, len(block))

    @classmethod
    def named(cls, name: str, cells: int) -> "Basis":
        """One of :data:`BASES`, whose trees have so many cells per axis."""
        if name in KLEMS:
            return cls(None, KLEMS[name].n_patches)
        return cls(RANKS[name], cells)

    @cached_property
    def patches(self) -> Any:
        """Patches of exit."""
        if self.rank is not None:
            return ShirleyChiu(self.size)
        return next(one for one in KLEMS.values() if one.n_patches == self.size)

    # ----------------------------------------------------------------------- incidence

    @property
    def incident(self) -> Subdivision:
        """Patches that incident light fills where a file is measured."""
        if self.rank != 3:
            return self.patches
        # equal steps of the sine, in the plane of flight to +x
        sines = np.arange(1, self.size // 2) * (2 / self.size)
        theta = (0, *np.degrees(np.arcsin(sines)), 90)
        return Borders(theta, (0, TO_X - HALF_WEDGE, TO_X + HALF_WEDGE, 360))

    def incident_patch(self, theta_i: ArrayLike, phi_i: ArrayLike) -> Integers:
        """Numbers that blocks have for incident patches, of directions in degrees."""
        if self.rank == 3:
            return (isotropic_coordinate(theta_i) * self.size).astype(int)
        flight = np.radians(phi_i) + np.pi
        return self.patches.patch(unit_vectors(np.radians(theta_i), flight))

    def incident_points(self, n: int) -> tuple[Floats, Floats]:
        """Incident directions in degrees, ``(n_incident, points)``, `n` per side."""
        if self.rank == 3:
            theta_i = isotropic_incidence(self.size, n)
            return theta_i, np.full_like(theta_i, TO_X)
        theta_i, phi_i = np.degrees(angles(self.patches.points(n) * [-1, -1, 1]))
        return theta_i, phi_i

    # ------------------------------------------------------------------------- blocks

    def blocks(self, values: Floats, direction: str) -> dict[tuple[str, str], Any]:
        """Blocks in one direction of values, incident times exit times channels."""
        if self.rank is None:
            grid = np.swapaxes(values, 0, 1)
        else:
            shape = [self.size] * (self.rank - 1)
            grid = values.reshape(-1, *shape, values.shape[-1])
        if self.rank == 3:  # its unused half holds the mean of the other
            unused = np.broadcast_to(grid.mean(axis=(0, 1, 2)), grid.shape)
            grid = np.concatenate([grid, unused])
        return blocks_of(grid, direction)

    def values(
        self,
        blocks: Sequence[Any],
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        wo: Floats,
    ) -> Floats:
        """Values of one block, or linear sRGB of three, shape ``(n, channels)``.

        Directions are those of :meth:`RadianceBSDF.values`, `wo` above the horizon.
        """
        if self.rank is None:
            rows = self.patches.patch(wo)
            columns = self.incident_patch(theta_i, phi_i)
            parts = [block[rows, columns] for block in blocks]
        else:
            points = coordinates(self.rank, theta_i, phi_i, wo)
            parts = [block.at(points) for block in blocks]
        if len(parts) == 1:
            return parts[0][:, None]
        xyz = parts if self.rank is None else xyz_of(*parts)
        return np.stack(xyz, axis=-1) @ np.linalg.inv(XYZ).T

    def diffuse_total(self, block: Floats | TensorTree) -> float:
        """Fraction of diffuse light, from all of a hemisphere, that leaves."""
        if isinstance(block, TensorTree):
            return block.diffuse_total()
        solid = self.patches.projected_solid_angles.ravel()
        return float(solid @ block @ solid / np.pi)


def blocks_of(grid: Floats, direction: str) -> dict[tuple[str, str], Any]:
    """Blocks of a matrix, or of a tree's grid; the last axis has the channels."""
    is_matrix = grid.ndim == 3
    if grid.shape[-1] == 1:
        grey = grid[..., 0]
        return {("Visible", direction): grey if is_matrix else TensorTree.of(grey)}
    xyz = np.moveaxis(grid @ XYZ.T, -1, 0)
    if is_matrix:
        return {(name, direction): part for name, part in zip(MATRIX_NAMES, xyz)}
    # Radiance takes diffuse light out cell by cell of u' and v', so that these must be
    # as fine as Y
    flat = MERGE_TOLERANCE, 0, 0
    parts = map(TensorTree.of, yuv_of(*xyz), flat)
    return {(name, direction): part for name, part in zip(TREE_NAMES, parts)}


def yuv_of(x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats]:
    """Luminance and chromaticity, u' and v' of CIE 1976; see :func:`xyz_of`."""
    total = x + 15 * y + 3 * z
    lit = total > 0
    total = np.where(lit, total, 1)
    u = np.where(lit, 4 * x / total, WHITE[0])
    v = np.where(lit, 9 * y / total, WHITE[1])
    return y, u, v


def xyz_of(y: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """Tristimulus values of luminance, u' and v'."""
    v = np.where(v > 0, v, WHITE[1])
    return y * 9 * u / (4 * v), y, y * (12 - 3 * u - 20 * v) / (4 * v)
