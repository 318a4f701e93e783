"""Records as Radiance's BSDF files, and those files at the record's patches."""

from os import PathLike
from typing import Any

import numpy as np

from ..array_types import Floats
from ..errors import SettingError, checked_choice
from ..files import radiance_bsdf, radiance_xml, replacing
from ..files.radiance_bsdf import RadianceBSDF
from ..results.record import Record
from .loss import Loss, losses
from .resampling import Material, klems_matrix, tensor_grid

__all__ = ["BASES", "write_radiance"]

# Cells per axis of tensor trees; those of rank 3 are cheap enough to be finer.
TREE_SIZES = {3: 64, 4: 32}

RANKS = {"klems": None, "tensor3": 3, "tensor4": 4}
BASES = tuple(RANKS)

# Points per side of a patch of the record at which the file is read back.
POINTS = 8


def write_radiance(
    record: Record, path: str | PathLike[str], basis: str = "klems"
) -> list[Loss]:
    """Write a record to an XML file of Radiance, and return its losses.

    Parameters
    ----------
    record : Record
        Of one channel or of R, G, B.
    path : str or path
    basis : {"klems", "tensor3", "tensor4"}
        Klems full basis, or a tensor tree for isotropic (3) or any (4) materials.

    Raises
    ------
    ValueError
        For another basis or other channels, for `tensor3` if the record has several
        azimuths of incidence or colours, or if its incident directions are no grid.
    """
    checked_choice("basis", basis, BASES)
    rank = RANKS[basis]
    if len(record.channels) > 1 and record.channels != ("R", "G", "B"):
        raise SettingError(
            "Radiance's files take records of one channel or of R, G, B, got "
            f"{', '.join(record.channels)[:80]}"
        )
    material = Material(record)
    if rank == 3:
        _check_isotropic_grey(material)
    side = record.settings.get("side", "front")
    blocks: dict[tuple[str, str], Any] = {}
    for hemisphere in range(1 + record.has_lower):
        direction = radiance_xml.DIRECTIONS[side, hemisphere]
        if rank is None:
            matrix = klems_matrix(material, hemisphere)
            blocks |= radiance_bsdf.matrices(matrix, direction)
        else:
            grid = tensor_grid(material, hemisphere, rank, TREE_SIZES[rank])
            blocks |= radiance_bsdf.trees(grid, direction)
    name = record.settings.get("specimen", "a record")
    with replacing(path) as stream:
        radiance_xml.write(blocks, stream, name)
    with open(path, "rb") as stream:
        written = RadianceBSDF(stream)
    return losses(record, _fractions(written, record, side))


def _check_isotropic_grey(material: Material) -> None:
    """Raise ValueError unless the material fits into a tensor tree of rank 3."""
    if len(material.phi_i) > 1:
        raise SettingError(
            "the basis tensor3 is for isotropic materials, and the record has "
            f"{len(material.phi_i)} azimuths of incidence: take tensor4"
        )
    # it drops their chromaticity with their diffuse light (seen in version 6.0a)
    if len(material.channels) > 1:
        raise SettingError(
            "Radiance loses the colours of tensor trees of rank 3: take tensor4"
        )


def _fractions(bsdf: RadianceBSDF, record: Record, side: str) -> Floats:
    """Flux fractions of a file in the patches and incident directions of a record."""
    patches = record.subdivision
    points = patches.points(POINTS)
    shape = *patches.shape, -1
    fractions = [
        [
            bsdf.values(side, hemisphere, theta, phi, points.reshape(-1, 3))
            .reshape(*points.shape[:2], -1)
            .mean(axis=1)
            .reshape(shape)
            for hemisphere in range(1 + record.has_lower)
        ]
        for theta, phi in zip(record.theta_i, record.phi_i)
    ]
    return np.array(fractions) * patches.projected_solid_angles[..., None]
