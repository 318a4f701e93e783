"""A stack of records as tables of lobes: what is looked up in them, and drawn of them.

How they move between polar angles is in :mod:`.quantile_transport`, how they change
with the azimuth in :mod:`.half_vectors`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..collector import RingsAndSectors
from ..errors import SettingError, check_memory
from ..formats.scatter import PatchMeans
from ..results.record import Record
from .gradients import gradients
from .incident_grid import IncidentGrid
from .quantile_transport import N_CELLS, TransportTable, cumulative

# Of the whole table as Dr.Jit holds it: half of what a machine of 8 GiB has. While it
# is made, it needs twice as much.
MAX_BYTES = 2**32


class TooLargeError(SettingError):
    """A record whose table does not fit into memory."""


@dataclass(frozen=True, eq=False)
class LobeTable:
    """Lobes at ``P`` azimuths x ``N`` polar angles of incidence.

    Attributes
    ----------
    grid : IncidentGrid
        Incident directions. A single azimuth means isotropic.
    patches : RingsAndSectors
        Of absolute azimuth.
    brdf : ndarray, shape (P, N, H, n_theta, n_phi, channels)
        Patch means of BRDF and BTDF in 1/sr, in ``H`` hemispheres.
    gradients : ndarray, shape (2, P, N, H, n_theta, n_phi, channels)
        Their change across each patch; see :func:`.gradients.gradients`.
    flux : ndarray, shape (P, N, H, channels)
        Flux fractions: reflectance and transmittance.
    """

    grid: IncidentGrid
    patches: RingsAndSectors
    brdf: Floats
    gradients: Floats
    flux: Floats

    @property
    def drawing(self) -> Drawing:
        """By what points of the lobes are drawn."""
        areas = self.patches.projected_solid_angles
        weight = self.brdf.mean(axis=-1) * areas
        total = weight.sum(axis=-1)
        tilts = self.gradients[0].mean(axis=-1)
        tilts *= areas
        tilts /= np.where(total > 0, total, 1)[..., None]
        sector_tilts = np.zeros((*tilts.shape[:-1], tilts.shape[-1] + 1))
        np.cumsum(tilts, axis=-1, out=sector_tilts[..., 1:])
        return Drawing(
            rings=cumulative(total),
            sectors=cumulative(weight),
            tilts=sector_tilts[..., -1],
            sector_tilts=sector_tilts,
        )

    @property
    def legs(self) -> TransportTable:
        """Maps by which quantiles are transported."""
        return TransportTable.of(self.brdf, self.patches, self.grid.phi_i)


class MeasuredLobes:
    """Lobes of a record's directions, of which tables are made.

    Parameters
    ----------
    record : Record or PatchMeans
    mixture : sequence of float, shape (channels,), optional
        Weights that make one channel of all.
    keep_dark : bool
        Whether a lower hemisphere is part of them in which there is no light, or less
        of all the light than double precision can tell from none: of grazing rays that
        slip through a mesh it is.

    Attributes
    ----------
    grid : IncidentGrid
    patches : RingsAndSectors
    flux : ndarray, shape (n, H, rows, columns, channels)
        Flux fractions as measured, in the record's patches.

    Raises
    ------
    ValueError
        If the incident directions are unknown, no grid, or too far apart in azimuth;
        or if nothing was incident.
    """

    def __init__(
        self,
        record: Record | PatchMeans,
        mixture: ArrayLike | None = None,
        keep_dark: bool = False,
    ) -> None:
        self.measured = record.subdivision
        flux = record.flux_fraction if record.stacked else record.flux_fraction[None]
        if not np.isfinite(flux).all():
            raise SettingError("the record must have incident light in all its stack")
        if not (keep_dark or is_significant(flux[:, 1:].sum(), flux.sum())):
            flux = flux[:, :1]
        self.grid = IncidentGrid.of(record, flux)
        self.flux, self.mixture = flux, mixture
        blank = np.zeros((*self.measured.shape, 1))
        self.patches = self.measured.in_rings(blank)[0]

    def whole(self) -> LobeTable:
        """Table of all azimuths and polar angles.

        Raises
        ------
        ValueError
            If it does not fit into memory.
        """
        n_channels = self.flux.shape[-1] if self.mixture is None else 1
        lobes = self.flux.shape[1], *self.patches.shape, n_channels
        n_azimuths, n_angles = self.grid.index.shape
        n_bytes = check_table(n_azimuths, n_angles, lobes)
        making = "a table of this record, while it is made,"
        check_memory(making, 2 * n_bytes, "measure on fewer patches")
        return self.table(range(n_azimuths), range(n_angles))

    def table(self, azimuths: Sequence[int], angles: Sequence[int]) -> LobeTable:
        """Table of some azimuths and polar angles, as if no others were known."""
        brdf, rings = self.brdf(azimuths, angles), self.patches
        changes = np.zeros((2, *brdf.shape))
        if rings == self.measured:  # else what is below them has no rings
            for number, lobes in enumerate(brdf):
                edges = rings.theta_edges, rings.phi_edges
                changes[:, number] = gradients(lobes, *edges)
        flux = np.einsum("pnhrsc,rs->pnhc", brdf, rings.projected_solid_angles)
        part = self.grid.part(azimuths, angles)
        return LobeTable(part, rings, brdf, changes, flux)

    def brdf(self, azimuths: Sequence[int], angles: Sequence[int]) -> Floats:
        """BRDF and BTDF in 1/sr, shape ``(P, N, H, n_theta, n_phi, channels)``."""
        found = self.grid.filled(self.flux, azimuths, angles)
        if self.mixture is not None:
            found = found @ np.asarray(self.mixture, dtype=float)[:, None]
        found /= self.measured.projected_solid_angles[..., None]
        values: Floats = self.measured.in_rings(found)[1]
        return values


@dataclass(frozen=True, eq=False)
class Drawing:
    """Cumulative distributions of the flux of a table's lobes.

    Attributes
    ----------
    rings : ndarray, shape (P, N, H, n_theta + 1)
        Fraction of the flux (mean of the channels) below each edge.
    sectors : ndarray, shape (P, N, H, n_theta, n_phi + 1)
        The same for the azimuth within a ring.
    tilts : ndarray, shape (P, N, H, n_theta)
        Change of the flux across each ring, as a fraction of its flux.
    sector_tilts : ndarray, shape (P, N, H, n_theta, n_phi + 1)
        The same of all sectors below each edge of azimuth.
    """

    rings: Floats
    sectors: Floats
    tilts: Floats
    sector_tilts: Floats


def is_significant(part: float, total: float) -> bool:
    """Whether double precision distinguishes a part of the total from none."""
    return bool(part > np.finfo(float).eps * total)


def check_table(n_azimuths: int, n_angles: int, lobes: tuple[int, ...]) -> float:
    """Bytes that the table of so many directions needs as Dr.Jit holds it.

    Parameters
    ----------
    n_azimuths, n_angles : int
    lobes : (n_hemispheres, n_theta, n_phi, channels)
        Shape of the lobes of a direction.

    Raises
    ------
    TooLargeError
        If these are more than any table may have.
    """
    n_hemispheres, *patches, n_channels = lobes
    means = 3 if n_channels > 1 else 0
    of_patch, of_leg = 3 * n_channels + means + 2, 4 * (2 * N_CELLS) ** 2
    each = 8 * n_hemispheres * (math.prod(patches) * of_patch + of_leg)
    n_bytes = n_azimuths * n_angles * each
    if n_bytes > MAX_BYTES:
        raise TooLargeError(
            f"a table of {n_azimuths} x {n_angles} incident directions and "
            f"{patches[0]} x {patches[1]} patches must need at most {MAX_BYTES:.2g} "
            f"bytes, got {n_bytes:.2g}"
        )
    return n_bytes
