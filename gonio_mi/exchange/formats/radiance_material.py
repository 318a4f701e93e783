"""Radiance's BSDF files as materials: means over patches for incident directions."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, BinaryIO, cast

import numpy as np

from ...array_types import Floats
from ...collector.borders import Borders
from ...collector.directions import direction as unit_vectors
from ...collector.hemisphere import Subdivision
from ...collector.shirley_chiu import ShirleyChiu
from ...files.checks import require
from ...results.patch_means import PatchMeans
from .format import COLOURS, WAVELENGTHS, Format
from .radiance import (
    DIRECTIONS,
    OTHER,
    RadianceBSDF,
)
from .tensor_tree import TensorTree

# Rings of cells in which tensor trees are read at most, by their rank; tilted incident
# directions of rank 4; fewest and most cells per axis of the square of exit.
MAX_RINGS, MAX_INCIDENT = {3: 64, 4: 16}, 960
MIN_CELLS, MAX_CELLS = 8, 256

# By which part of the larger one the transmittances of both sides may differ, which
# noise and patches make unequal.
MAX_UNEQUAL = 0.05

# Points per axis of the square by which cells overlap patches.
OVERLAP_POINTS = 512


def material(stream: BinaryIO, side: str) -> PatchMeans:
    """Means over patches of a file, with light on one of its faces.

    Raises
    ------
    FileFormatError
        If the file is damaged, or holds no light that meets the face.
    """
    bsdf = RadianceBSDF(stream)
    notes = _reconciled(bsdf)
    held = [h for h in (0, 1) if bsdf.holds(side, h)]
    require(bool(held), f"it holds no light that meets its {side}")
    means = _matrix_means if bsdf.basis.rank is None else _tree_means
    found = means(bsdf, side, held)
    if bsdf.is_reciprocal(side, 1) and not notes:
        note = f"it tells the transmission of the {OTHER[side]} only, and that of the "
        notes = (f"{note}{side} is taken by reciprocity",)
    return replace(found, notes=notes)


def _reconciled(bsdf: RadianceBSDF) -> tuple[str, ...]:
    """Leave out a placeholder for the transmission of one side; what is to be told.

    Transmittances for diffuse light from the front and from the back are equal in any
    passive layer. Where they are not, and one side has a single value for all
    directions, as the dummy values that WINDOW 6 may write, the other side counts.
    """
    names = {side: DIRECTIONS[side, 1] for side in OTHER}
    if not all(("Visible", name) in bsdf.blocks for name in names.values()):
        return ()
    blocks = {side: bsdf.blocks["Visible", name] for side, name in names.items()}
    totals = {side: bsdf.basis.diffuse_total(block) for side, block in blocks.items()}
    low, high = sorted(totals.values())
    if high - low <= MAX_UNEQUAL * high:
        return ()
    text = "its transmittances for diffuse light must be equal by reciprocity, but are "
    text += " and ".join(f"{t:.4g} from the {side}" for side, t in totals.items())
    dummies = [side for side, block in blocks.items() if _has_one_value(block)]
    if len(dummies) != 1:
        return (f"{text}: each is taken as it is",)
    (dummy,) = dummies
    for key in [key for key in bsdf.blocks if key[1] == names[dummy]]:
        del bsdf.blocks[key]
    text += f": the {dummy} has one value for all directions, and its transmission is "
    return (f"{text}taken from that of the {OTHER[dummy]}, by reciprocity",)


def _has_one_value(block: Floats | TensorTree) -> bool:
    """Whether a block has the same value for all pairs of directions."""
    values = block.root if isinstance(block, TensorTree) else block
    return not isinstance(values, list) and bool(np.all(values == values.flat[0]))


def _matrix_means(bsdf: RadianceBSDF, side: str, held: Sequence[int]) -> PatchMeans:
    """Means over the patches of a Klems basis, of exit and of incidence."""
    patches = bsdf.basis.patches
    toward = [angle[:, 0] for angle in patches.middles]
    incident = theta_i, phi_i = np.degrees(toward)
    n = len(theta_i)
    # each exit patch for each incident one
    thetas, phis = (np.repeat(angle, n) for angle in incident)
    wo = np.tile(unit_vectors(*toward), (n, 1))
    means = np.zeros((n, max(held) + 1, *patches.shape, len(bsdf.channels)))
    for h in held:
        values = bsdf.values(side, h, thetas, phis, wo)
        means[:, h] = values.reshape(n, *patches.shape, -1)
    found = PatchMeans.of(means, patches, (theta_i, phi_i), bsdf.channels)
    return replace(found, incident=patches)


def _tree_means(bsdf: RadianceBSDF, side: str, held: Sequence[int]) -> PatchMeans:
    """Means over rings of a tree's cells: the light of each cell is divided among them.

    Rings of the square's cells have the same borders for incidence and for exit, equal
    steps of the sine. Along the normal it is the mean of the cells that touch it.
    """
    rank = cast(int, bsdf.basis.rank)
    size = max(bsdf.basis.size, MIN_CELLS)
    n_rings = min(size // 2, MAX_RINGS[rank])
    edges = np.degrees(np.arcsin(np.arange(n_rings + 1) / n_rings))
    patches = Borders(tuple(edges), tuple(np.linspace(0, 360, 8 * n_rings + 1)))
    # cells of exit; by exchange those of rank 3 are turned, and so taken finer
    finer = 4 if rank == 3 and bsdf.is_reciprocal(side, 1) else 1
    cells = ShirleyChiu(min(size * finer, MAX_CELLS))
    overlap = _overlap(cells, patches)
    # of rank 3 about the middle of each cell; of rank 4 through the middles: ring k has
    # 4 (2 k + 1) cells, and both azimuths around a middle are in its cell
    rings = np.linspace(0, size // 2 - 1, n_rings).astype(int)
    inside = [0.45, 0.75] if rank == 3 else [0.5]
    thetas = np.degrees(np.arcsin(np.add.outer(rings, inside).ravel() * (2 / size)))
    n = min(8 * (size - 1), MAX_INCIDENT // n_rings) if rank == 4 else 1
    phi_i = (np.arange(n) + 0.5) * (360 / n)
    wo = np.tile(cells.points(1)[:, 0], (n, 1))
    flux = np.zeros((thetas.size * n, 2, *patches.shape, len(bsdf.channels)))
    for hemisphere, (row, theta) in itertools.product(held, enumerate(thetas)):
        values = bsdf.values(side, hemisphere, theta, phi_i.repeat(cells.n_patches), wo)
        for azimuth, of_cells in enumerate(values.reshape(n, cells.n_patches, -1)):
            light = (overlap @ of_cells).reshape(flux.shape[2:])
            flux[row * n + azimuth, hemisphere] = light
    flux = np.concatenate([flux[:n].mean(axis=0, keepdims=True), flux])
    theta_i, phi_i = (
        np.append(0.0, angle.ravel())
        for angle in np.meshgrid(thetas, phi_i, indexing="ij")
    )
    return PatchMeans(patches, theta_i, phi_i, bsdf.channels, flux[:, : max(held) + 1])


def _overlap(cells: ShirleyChiu, patches: Subdivision) -> Any:
    """Projected solid angle in sr that each cell has in each patch: a sparse matrix.

    Shape ``(n_patches, n_cells)``; that of a cell is divided evenly among its points.
    """
    from scipy.sparse import coo_array  # of which reading a Klems matrix needs nothing

    points = cells.points(-(-OVERLAP_POINTS // cells.size))
    n, each, _ = points.shape
    cell, part = np.arange(n).repeat(each), np.full(n * each, np.pi / (n * each))
    index = patches.patch(points).ravel(), cell
    return coo_array((part, index), (patches.n_patches, n)).tocsr()


FORMATS = (
    Format(
        "Radiance",
        (".xml",),
        material=material,
        writes=(".xml",),
        channels=(COLOURS, WAVELENGTHS),
        loses="lobes narrower than its patches or cells",
    ),
)
