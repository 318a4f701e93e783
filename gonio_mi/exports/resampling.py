"""Values of a record in any direction, as other formats want them."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..collector.directions import direction
from ..collector.klems import Klems
from ..files.tensor_tree import grid_directions
from ..materials.lit_face import LitFace
from ..materials.lobes import LobeTable
from ..results.record import Record

__all__ = [
    "Material",
    "half_vector_grid",
    "klems_matrix",
    "tensor_grid",
]

# Points per side of a patch of exit or of incidence that is averaged over.
POINTS_OUT, POINTS_IN = 8, 3

# The same of the cells of tensor trees, of which there are more.
CELL_POINTS = 2

# Values that are asked for at once, at most or for one incident patch.
MOST_VALUES = 2**20


class Material:
    """BRDF and BTDF of a record between its incident directions.

    As the BSDF plugin `goniometric` has them. It needs a variant of Dr.Jit.

    Parameters
    ----------
    record : Record

    Attributes
    ----------
    theta_i, phi_i : ndarray
        The record's incident directions in degrees, ascending.
    channels : tuple of str
    has_lower : bool

    Raises
    ------
    ValueError
        If the incident directions are unknown or no grid; see `LobeTable.of`.
    """

    def __init__(self, record: Record) -> None:
        self.channels = record.channels
        self.has_lower = record.has_lower
        table = LobeTable.of(record)
        self.theta_i, self.phi_i = table.theta_i, table.phi_i
        self._face = LitFace(table)

    def values(self, theta_i: ArrayLike, phi_i: ArrayLike, wo: Floats) -> Floats:
        """BRDF or BTDF in 1/sr, shape ``(n, channels)``.

        Parameters
        ----------
        theta_i, phi_i : float or array_like, shape (n,)
            Incident directions in degrees, from the normal of the lit face.
        wo : array_like, shape (n, 3)
            Unit vectors of exit; z > 0 is the lit side.
        """
        wi = direction(np.radians(theta_i), np.radians(phi_i))
        wi, wo = (_vectors(v) for v in np.broadcast_arrays(wi, wo))
        values, _, wanted = self._face.values(wi, wo)
        dr.eval(values, wanted)
        inside = np.broadcast_to(wanted.numpy(), dr.width(wo))
        return np.stack([np.where(inside, v.numpy(), 0) for v in values], axis=-1)


def _vectors(v: Floats) -> Any:
    return mi.Vector3f(np.ascontiguousarray(v.T, dtype=np.float32))


def klems_matrix(material: Material, hemisphere: int) -> Floats:
    """Means over pairs of Klems patches in 1/sr, ``(145, 145, channels)``.

    Exit patches times incident ones, of Radiance's order: the incident patch is that of
    the direction of flight.

    Parameters
    ----------
    material : Material
    hemisphere : {0, 1}
        Reflection or transmission.
    """
    patches = Klems()
    x, y, z = np.moveaxis(patches.points(POINTS_IN), -1, 0)
    theta_i = np.degrees(np.arctan2(np.hypot(x, y), z))
    phi_i = np.degrees(np.arctan2(-y, -x))
    means = _means(material, hemisphere, theta_i, phi_i, patches.points(POINTS_OUT))
    return np.swapaxes(means, 0, 1)


def tensor_grid(material: Material, hemisphere: int, rank: int, size: int) -> Floats:
    """Means over the cells of a tensor tree's grid in 1/sr, ``(size, ..., channels)``.

    See `tensor_tree`: the half that rank 3 does not use holds the mean of the other.

    Parameters
    ----------
    material : Material
    hemisphere : {0, 1}
        Reflection or transmission.
    rank : {3, 4}
    size : int
        Cells per axis.
    """
    directions = grid_directions(rank, size, CELL_POINTS, CELL_POINTS)
    means = _means(material, hemisphere, *directions)
    grid = means.reshape(-1, *[size] * (rank - 1), means.shape[-1])
    if rank == 4:
        return grid
    unused = np.broadcast_to(grid.mean(axis=(0, 1, 2)), grid.shape)
    return np.concatenate([grid, unused])


def _means(
    material: Material, hemisphere: int, theta_i: Floats, phi_i: Floats, wo: Floats
) -> Floats:
    """Means over points of incidence and of exit, ``(n_in, n_out, channels)``.

    `theta_i` and `phi_i` have the shape ``(n_in, points)``, `wo` ``(n_out, points, 3)``
    with z > 0.
    """
    n_out, n_points, _ = wo.shape
    n_in = theta_i.shape[1]
    wo = wo.reshape(-1, 3) * [1, 1, -1 if hemisphere else 1]
    means = []
    n_chunks = -(-theta_i.size * len(wo) // MOST_VALUES)
    for chunk in zip(*(np.array_split(a, n_chunks) for a in (theta_i, phi_i))):
        theta, phi = (np.repeat(angles, len(wo)) for angles in chunk)
        values = material.values(theta, phi, np.tile(wo, (chunk[0].size, 1)))
        values = values.reshape(-1, n_in, n_out, n_points, values.shape[-1])
        means.append(values.mean(axis=(1, 3)))
    return np.concatenate(means)


def half_vector_grid(
    material: Material,
    theta_i: float,
    phi_i: float,
    origin: float,
    size: int,
    n: int = 4,
) -> Floats:
    """BRDF times cosine on a grid of half vectors, ``(channels, size, size)``.

    Rows are azimuths of the half vector from `origin`, -pi to pi; columns its polar
    angles, in equal steps of the square root. Each value is a mean over the grid's cell
    about it.

    Parameters
    ----------
    material : Material
    theta_i, phi_i, origin : float
        In degrees.
    size : int
        Rows and columns.
    n : int
        Points per side of a cell.
    """
    step = ((np.arange(n) + 0.5) / n - 0.5) / (size - 1)
    u = np.abs(np.arange(size)[:, None] / (size - 1) + step).ravel()
    u = np.where(u > 1, 2 - u, u)
    theta_m = u**2 * (np.pi / 2)
    phi_m = 2 * np.pi * (np.arange(size)[:, None] / (size - 1) + step).ravel() - np.pi
    theta_m, phi_m = np.meshgrid(theta_m, phi_m + np.radians(origin))
    half = direction(theta_m, phi_m)
    wi = direction(np.radians(theta_i), np.radians(phi_i))
    wo = 2 * (half @ wi)[..., None] * half - wi
    wo = wo.reshape(-1, 3)
    above = wo[:, 2] > 0
    values = np.zeros((len(wo), len(material.channels)))
    values[above] = material.values(theta_i, phi_i, wo[above]) * wo[above, 2:]
    values = values.reshape(size, n, size, n, -1).mean(axis=(1, 3))
    return np.moveaxis(values, -1, 0)
