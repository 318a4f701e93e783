"""Materials in files: our records, and Radiance's Klems matrices."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from .. import files
from ..collector.directions import direction
from ..collector.hemisphere import Subdivision
from ..errors import FileFormatError
from ..results.record import Record
from .header import require
from .radiance_bsdf import RadianceBSDF

__all__ = ["PatchMeans", "load_material"]

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


def load_material(
    path: str | PathLike[str], side: str = "front"
) -> Record | PatchMeans:
    """Record, or patch means of another tool, from a file.

    Parameters
    ----------
    path : str or path
        Ends in ``.npz`` or ``.exr`` for a record; in ``.xml`` for a Radiance BSDF in
        a Klems basis.
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
    if Path(path).suffix.lower() != ".xml":
        return files.load(path)
    with open(path, "rb") as stream:
        try:
            return _of_klems(RadianceBSDF(stream), side)
        except FileFormatError as error:
            raise FileFormatError(f"cannot load {path}: {error}") from None


def _of_klems(bsdf: RadianceBSDF, side: str) -> PatchMeans:
    """Klems matrices at the middles of their rings, and at common azimuths."""
    require(
        bsdf.rank is None,
        "it is a tensor tree, which has no patches: Radiance's bsdf2klems makes a "
        "matrix of it",
    )
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
    return PatchMeans(
        subdivision=patches,
        theta_i=theta_i,
        phi_i=phi_i,
        channels=bsdf.channels,
        flux_fraction=means * patches.projected_solid_angles[..., None],
    )
