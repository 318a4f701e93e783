"""Materials in files: our records, Radiance's BSDFs, other programs' scatter data."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from .. import files
from ..collector import EqualAngle, EqualProjectedSolidAngle
from ..collector.directions import direction
from ..collector.hemisphere import Subdivision
from ..errors import FileFormatError, no_file
from ..results.record import Record
from . import scatter_files
from .header import require
from .radiance_bsdf import RadianceBSDF
from .scatter import Scatter, patch_means

__all__ = ["PatchMeans", "has_back", "load_material", "scatter_means"]

# Azimuths of incidence at which tensor trees for any materials are taken.
N_AZIMUTHS = 24

# Rings and sectors of other programs' scatter data.
PATCHES = 60, 72

# Angles of incidence at which tensor trees are taken, rings and sectors of patches by
# the rank of a tree, and points per side of a patch.
TREE_INCIDENCES = np.array([0, 10, 20, 30, 40, 50, 60, 70, 80.0])
TREE_PATCHES = {3: (45, 90), 4: (32, 64)}
TREE_POINTS = 3

# Half the width in degrees of what stands for an azimuth on an edge of patches.
NEARLY = 1e-3


@dataclass(frozen=True, eq=False)
class PatchMeans:
    """What a material needs of a record, from a file that holds no counts.

    Attributes
    ----------
    subdivision : Subdivision
    theta_i, phi_i : ndarray, shape (n_incident,)
        In degrees.
    channels : tuple of str
    flux_fraction : ndarray
        ``(n_incident, n_hemispheres, n_theta, n_phi, channels)``.
    stacked : bool
    """

    subdivision: Subdivision
    theta_i: np.ndarray
    phi_i: np.ndarray
    channels: tuple[str, ...]
    flux_fraction: np.ndarray
    stacked: bool = True

    @classmethod
    def of(
        cls,
        means: np.ndarray,
        patches: Subdivision,
        incident: tuple[np.ndarray, np.ndarray],
        channels: tuple[str, ...],
    ) -> "PatchMeans":
        """Means of the BSDF in 1/sr, of the shape of `flux_fraction`."""
        fractions = means * patches.projected_solid_angles[..., None]
        return cls(patches, *incident, channels, fractions)


def load_material(
    path: str | PathLike[str], side: str = "front"
) -> Record | PatchMeans:
    """Record, or patch means of another tool, from a file.

    Parameters
    ----------
    path : str or path
        Ends in ``.npz`` or ``.exr`` for a record; in ``.xml`` for a Radiance BSDF; in
        ``.bsdf``, ``.brdf``, ``.anisotropicbsdf``, ``.json``, ``.xompt`` or
        ``.binary`` for the scatter data of another program.
    side : {"front", "back"}
        The lit face, where the file holds both.

    Returns
    -------
    Record or PatchMeans

    Raises
    ------
    ValueError
        For another ending.
    OSError
        If the file cannot be opened.
    FileFormatError
        If it is damaged, something else, or lacks reflection from that side.
    """
    ending = Path(path).suffix.lower()
    if ending not in (".xml", *scatter_files.ENDINGS):
        return files.load(path)
    if not Path(path).exists():
        raise FileNotFoundError(no_file(path))
    if ending != ".xml":
        return _of_scatter(path)
    with open(path, "rb") as stream:
        try:
            bsdf = RadianceBSDF(stream)
            made = _of_klems if bsdf.rank is None else _of_trees
            return made(bsdf, side)
        except FileFormatError as error:
            raise FileFormatError(f"cannot load {path}: {error}") from None


def has_back(path: str | PathLike[str]) -> bool:
    """Whether a file that :func:`load_material` reads holds both faces by itself."""
    if Path(path).suffix.lower() != ".xml":
        return False
    with open(path, "rb") as stream:
        bsdf = RadianceBSDF(stream)
    return any(bsdf.holds("back", hemisphere) for hemisphere in (0, 1))


def _of_klems(bsdf: RadianceBSDF, side: str) -> PatchMeans:
    """Klems matrices at the middles of their rings, and at common azimuths."""
    # the first ring is one patch around the pole
    patches = bsdf.basis
    edges = patches.theta_deg
    middles = np.array([0, *(np.add(edges[1:-1], edges[2:]) / 2)])
    # as many as the ring that has most
    n = max(patches.n_phi)
    azimuths = np.arange(n) * (360 / n)
    theta_i, phi_i = (a.ravel() for a in np.meshgrid(middles, azimuths, indexing="ij"))
    held = [h for h in (0, 1) if bsdf.holds(side, h)]
    require(bool(held), f"it holds no light that meets its {side}")
    theta_o, phi_o = patches.middles
    wo = direction(theta_o[:, 0], phi_o[:, 0])
    shape = len(theta_i), max(held) + 1, *patches.shape, len(bsdf.channels)
    means = np.zeros(shape)
    for hemisphere in held:
        for index, (theta, phi) in enumerate(zip(theta_i, phi_i)):
            # both sides of an edge that the azimuth may be on
            sides = [
                bsdf.values(side, hemisphere, theta, phi + turn, wo)
                for turn in (-NEARLY, NEARLY)
            ]
            means[index, hemisphere, :, 0] = np.mean(sides, axis=0)
    return PatchMeans.of(means, patches, (theta_i, phi_i), bsdf.channels)


def _of_trees(bsdf: RadianceBSDF, side: str) -> PatchMeans:
    """Means of tensor trees over patches, at some incident directions.

    Of trees for isotropic materials at one azimuth.
    """
    n = N_AZIMUTHS if bsdf.rank == 4 else 1
    azimuths = np.arange(n) * (360 / n)
    theta_i, phi_i = (
        a.ravel() for a in np.meshgrid(TREE_INCIDENCES, azimuths, indexing="ij")
    )
    held = [h for h in (0, 1) if bsdf.holds(side, h)]
    require(bool(held), f"it holds no light that meets its {side}")
    patches = EqualProjectedSolidAngle(*TREE_PATCHES[bsdf.rank or 4])
    wo = patches.points(TREE_POINTS)
    shape = len(theta_i), max(held) + 1, *patches.shape, len(bsdf.channels)
    means = np.zeros(shape)
    for hemisphere in held:
        for index, (theta, phi) in enumerate(zip(theta_i, phi_i)):
            values = bsdf.values(side, hemisphere, theta, phi, wo.reshape(-1, 3))
            values = values.reshape(*wo.shape[:2], -1).mean(axis=1)
            means[index, hemisphere] = values.reshape(shape[2:])
    return PatchMeans.of(means, patches, (theta_i, phi_i), bsdf.channels)


def _of_scatter(path: str | PathLike[str]) -> PatchMeans:
    """Scatter data in patches as fine as they are told for."""
    scatter = scatter_files.read_scatter(path)
    try:
        return scatter_means(scatter)
    except FileFormatError as error:
        raise FileFormatError(f"cannot load {path}: {error}") from None


def scatter_means(scatter: Scatter, patches: Subdivision | None = None) -> PatchMeans:
    """Scatter data as means over patches, by default a few degrees wide.

    Parameters
    ----------
    scatter : Scatter
        Transmission for the incident directions of reflection, if it has both.
    patches : Subdivision, optional

    Raises
    ------
    FileFormatError
        If both are told for other incident directions.
    """
    patches = patches or EqualAngle(*PATCHES)
    held = [h for h in (0, 1) if scatter.of(h)]
    by_angles = {(b.hemisphere, b.theta_i, b.phi_i): b for b in scatter.blocks}
    incident = sorted({key[1:] for key in by_angles}, key=lambda pair: pair[::-1])
    require(
        len(by_angles) == len(held) * len(incident),
        "it tells reflection and transmission for different incident directions",
    )
    shape = len(incident), max(held) + 1, *patches.shape, len(scatter.channels)
    means = np.zeros(shape)
    for (hemisphere, *angles), block in by_angles.items():
        here = incident.index((angles[0], angles[1])), hemisphere
        means[here] = patch_means(block, patches)
    theta_i, phi_i = np.array(incident).T
    return PatchMeans.of(means, patches, (theta_i, phi_i), scatter.channels)
