"""Values of a Radiance BSDF in any direction, and the blocks that hold those of ours.

Colours are linear sRGB here and CIE components in the files.
"""

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from . import radiance_xml, tensor_tree
from .header import require
from .tensor_tree import TensorTree

__all__ = ["RadianceBSDF", "XYZ", "matrices", "trees"]

# CIE XYZ of linear sRGB (IEC 61966-2-1).
XYZ = np.array(
    [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ]
)

MATRIX_NAMES = ("CIE-X", "Visible", "CIE-Z")
TREE_NAMES = ("Visible", "CIE-u", "CIE-v")

# u' and v' of equal energy, which black has in Radiance.
WHITE = (4 / 19, 9 / 19)


def matrices(values: Floats, direction: str) -> dict[tuple[str, str], Floats]:
    """Blocks of a Klems matrix ``(n, n, channels)`` in one direction."""
    if values.shape[-1] == 1:
        return {("Visible", direction): values[..., 0]}
    xyz = values @ XYZ.T
    return {(name, direction): xyz[..., i] for i, name in enumerate(MATRIX_NAMES)}


def trees(values: Floats, direction: str) -> dict[tuple[str, str], TensorTree]:
    """Blocks of tensor trees of a grid, ``(n, n, ..., channels)``."""
    if values.shape[-1] == 1:
        return {("Visible", direction): TensorTree.of(values[..., 0])}
    x, y, z = np.moveaxis(values @ XYZ.T, -1, 0)
    total = x + 15 * y + 3 * z
    lit = total > 0
    total = np.where(lit, total, 1)
    u = np.where(lit, 4 * x / total, WHITE[0])
    v = np.where(lit, 9 * y / total, WHITE[1])
    # Radiance takes diffuse light out cell by cell of u' and v', so that these must be
    # as fine as Y
    parts = TensorTree.of(y), TensorTree.of(u, flat=0), TensorTree.of(v, flat=0)
    return {(name, direction): part for name, part in zip(TREE_NAMES, parts)}


class RadianceBSDF:
    """A Radiance file, in grey or linear sRGB.

    Parameters
    ----------
    stream : binary stream

    Attributes
    ----------
    blocks : dict
        As `radiance_xml.read` returns.
    channels : tuple of str
        ``("Y",)`` or ``("R", "G", "B")``.
    rank : {None, 3, 4}
        Of tensor trees; None for Klems matrices.
    basis : Klems
        Of the matrices; None for tensor trees.

    Raises
    ------
    FileFormatError
        If the file is damaged or something else.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self.blocks: dict[tuple[str, str], Any] = radiance_xml.read(stream)
        first: Any = next(iter(self.blocks.values()))
        tree = isinstance(first, TensorTree)
        self.rank = first.rank if tree else None
        self.basis: Any = None if tree else radiance_xml.basis_of(first)
        self._names: tuple[str, ...] = MATRIX_NAMES if self.rank is None else TREE_NAMES
        held = {name for name, _ in self.blocks}
        coloured = held >= set(self._names)
        if not coloured:
            self._names = ("Visible",)
        self.channels = ("R", "G", "B") if coloured else ("Y",)
        if self.rank is None:
            blocks: Any = self.blocks.values()
            sizes = {len(block) for block in blocks}
            require(len(sizes) == 1, "its matrices are of several bases")
        for wavelength, direction in self.blocks:
            if wavelength == "Solar":
                continue
            missing = [n for n in self._names if (n, direction) not in self.blocks]
            require(not missing, f"its {direction} lacks {', '.join(missing)}")

    def holds(self, side: str, hemisphere: int) -> bool:
        """Whether there is reflection (0) or transmission (1) of a lit face."""
        return ("Visible", radiance_xml.DIRECTIONS[side, hemisphere]) in self.blocks

    def values(
        self,
        side: str,
        hemisphere: int,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        wo: Floats,
    ) -> Floats:
        """BRDF or BTDF in 1/sr, shape ``(n, channels)``.

        Parameters
        ----------
        side : {"front", "back"}
            The lit face.
        hemisphere : {0, 1}
            Reflection or transmission.
        theta_i, phi_i : float or ndarray, shape (n,)
            Incident directions in degrees, from the normal of the lit face.
        wo : ndarray, shape (n, 3)
            Unit vectors of exit; only the azimuth and the angle with the normal count.
        """
        direction = radiance_xml.DIRECTIONS[side, hemisphere]
        blocks = [self.blocks[name, direction] for name in self._names]
        if self.rank is None:
            rows = self.basis.patch(wo * [1, 1, 0] + np.abs(wo) * [0, 0, 1])
            columns = radiance_xml.incident_patch(theta_i, phi_i, self.basis)
            parts = np.stack([block[rows, columns] for block in blocks], axis=-1)
        else:
            points = tensor_tree.coordinates(self.rank, theta_i, phi_i, wo)
            parts = np.stack([block.at(points) for block in blocks], axis=-1)
            if len(self._names) == 3:
                parts = _xyz_of_yuv(*parts.T)
        return parts if len(self._names) == 1 else parts @ np.linalg.inv(XYZ).T


def _xyz_of_yuv(y: Floats, u: Floats, v: Floats) -> Floats:
    """CIE XYZ of luminance and the chromaticity u', v', shape ``(n, 3)``."""
    v = np.where(v > 0, v, WHITE[1])
    x = y * 9 * u / (4 * v)
    z = y * (12 - 3 * u - 20 * v) / (4 * v)
    return np.stack([x, y, z], axis=-1)
