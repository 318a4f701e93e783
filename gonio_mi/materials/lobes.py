"""A stack of records as lobes, and the ways on which they move between angles.

Seen from the unit disk onto which the hemisphere projects, flux per area is the BRDF
itself. Turned so that light comes from +x, a mirror lobe lies at ``x = -sin(theta_i)``:
between two incident angles, what both have in different places is moved on straight
lines over the disk, and what both have in one place stays there.

Which point of one lobe belongs to which of the other is decided by their quantiles:
those along x first, then those across (the Knothe-Rosenblatt map; for one dimension see
A. L. Read, *Linear interpolation of histograms*, 1999,
doi:10.1016/S0168-9002(98)01347-3), of histograms that are coarse on purpose, so that
the noise of a record does not steer its light. The lobes that are moved are the records
themselves, all of them: no light is lost or made. How they change with the azimuth is
in :mod:`.half_vectors`, and where they do so with the angle as well, in
:mod:`.leg_trials`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..collector import RingsAndSectors
from ..errors import SettingError
from ..results.record import Record
from .gradients import gradients
from .incident_grid import IncidentGrid

__all__ = ["LobeTable", "TooLargeError"]

Floats = NDArray[np.float64]

# Cells per side of the histograms; points per side and cell, to fill them.
N_CELLS = 32
N_POINTS = 8

# Part of the light that is spread evenly over the histograms: bounds how far apart
# neighbouring points can be moved. It is not part of the lobes.
EVEN = 0.01

# Of the whole table.
MOST_BYTES = 2**31


class TooLargeError(SettingError):
    """A record whose table does not fit into memory."""


@dataclass(frozen=True, eq=False)
class LobeTable:
    """Lobes at ``P`` azimuths x ``N`` polar angles of incidence, and the ways between.

    A *leg* leads from one polar angle to the next; there are ``K = max(N - 1, 1)``, and
    ``H`` hemispheres. Across a leg, histogram edges of both ends cut the disk into
    ``S = 2 N_CELLS - 1`` strips of x, and each strip into ``S`` cells of
    ``y / sqrt(1 - x^2)``; within one, points move together.

    Attributes
    ----------
    grid : IncidentGrid
        Incident directions. A single azimuth means isotropic.
    patches : RingsAndSectors
        Of absolute azimuth.
    brdf : ndarray, shape (P, N, H, n_theta, n_phi, channels)
        Patch means of BRDF and BTDF in 1/sr.
    gradients : ndarray, shape (2, P, N, H, n_theta, n_phi, channels)
        Their change across each patch; see :func:`.gradients.gradients`.
    flux : ndarray, shape (P, N, H, channels)
        Flux fractions: reflectance and transmittance.
    rings : ndarray, shape (P, N, H, n_theta + 1)
        Share of the light (mean of the channels) below each edge.
    sectors : ndarray, shape (P, N, H, n_theta, n_phi + 1)
        The same for the azimuth within a ring.
    tilts : ndarray, shape (P, N, H, n_theta)
        Change of the light across each ring, as part of its light.
    sector_tilts : ndarray, shape (P, N, H, n_theta, n_phi + 1)
        The same of all sectors below each edge of azimuth.
    strips, strip_slopes : ndarray, shape (2, P, K, H, S)
        Where a strip begins, and its width per share of the light, on both ends of the
        leg.
    cells, cell_slopes : ndarray, shape (2, P, K, H, S, S)
        The same across a strip.
    """

    grid: IncidentGrid
    patches: RingsAndSectors
    brdf: Floats
    gradients: Floats
    flux: Floats
    rings: Floats
    sectors: Floats
    tilts: Floats
    sector_tilts: Floats
    strips: Floats
    strip_slopes: Floats
    cells: Floats
    cell_slopes: Floats

    @classmethod
    def of(cls, record: Record, mixture: ArrayLike | None = None) -> "LobeTable":
        """Lobes of a record.

        Parameters
        ----------
        record : Record
        mixture : sequence of float, shape (channels,), optional
            Weights that make one channel of all.

        Raises
        ------
        ValueError
            If the incident directions are unknown, no grid, or too far apart in
            azimuth; if nothing was incident; or if the table does not fit.
        """
        patches = record.subdivision
        flux = record.flux_fraction if record.stacked else record.flux_fraction[None]
        if not np.isfinite(flux).all():
            raise SettingError("the record must have incident light in all its stack")
        grid = IncidentGrid.of(record, flux)
        flux = grid.filled(flux)
        if mixture is not None:
            flux = flux @ np.asarray(mixture, dtype=float)[:, None]
        brdf = flux / patches.projected_solid_angles[..., None]
        rings, brdf = patches.in_rings(brdf)
        if rings != patches:  # else the flux stays as measured, to the bit
            patches, flux = rings, brdf * rings.projected_solid_angles[..., None]
        _check_size(flux.shape)
        strips, strip_slopes, cells, cell_slopes = _legs(brdf, patches, grid.phi_i)
        weight = flux.mean(axis=-1)
        changes = np.zeros((2, *brdf.shape))
        if rings == record.subdivision:  # else what is below them has no rings
            changes = gradients(brdf, patches.theta_edges, patches.phi_edges)
        areas = patches.projected_solid_angles
        tilt = changes[0].mean(axis=-1) * areas / _positive(weight.sum(-1)[..., None])
        tilts = np.cumsum(tilt, axis=-1)
        return cls(
            grid=grid,
            patches=patches,
            brdf=brdf,
            gradients=changes,
            flux=flux.sum(axis=(3, 4)),
            rings=_cumulative(weight.sum(axis=-1)),
            sectors=_cumulative(weight),
            tilts=tilts[..., -1],
            sector_tilts=np.concatenate([0 * tilts[..., :1], tilts], axis=-1),
            strips=strips,
            strip_slopes=strip_slopes,
            cells=cells,
            cell_slopes=cell_slopes,
        )

    def part(self, azimuth: int, angles: Sequence[int]) -> "LobeTable":
        """Table of some polar angles at one azimuth, as if no others were known.

        Its lobes are those of the whole table: `grid` is not to fill in any.
        """
        one, many = slice(azimuth, azimuth + 1), list(angles)
        grid = replace(
            self.grid,
            theta_i=self.grid.theta_i[many],
            phi_i=self.grid.phi_i[one],
            index=self.grid.index[one, many],
            reflects=False,
            eta=None,
        )
        brdf = self.brdf[one, many]
        strips, strip_slopes, cells, cell_slopes = _legs(brdf, self.patches, grid.phi_i)
        return replace(
            self,
            grid=grid,
            brdf=brdf,
            gradients=self.gradients[:, one, many],
            flux=self.flux[one, many],
            rings=self.rings[one, many],
            sectors=self.sectors[one, many],
            tilts=self.tilts[one, many],
            sector_tilts=self.sector_tilts[one, many],
            strips=strips,
            strip_slopes=strip_slopes,
            cells=cells,
            cell_slopes=cell_slopes,
        )


def _check_size(shape: tuple[int, ...]) -> None:
    """Raise TooLargeError unless the table of such a record fits into memory."""
    n_azimuths, n_angles, n_hemispheres, *patches, n_channels = shape
    n_lobes = n_azimuths * n_angles * n_hemispheres
    n_bytes = (
        8 * n_lobes * (4 * (2 * N_CELLS) ** 2 + np.prod(patches) * (3 * n_channels + 3))
    )
    if n_bytes > MOST_BYTES:
        raise TooLargeError(
            f"a table of {n_azimuths} x {n_angles} incident directions and "
            f"{patches[0]} x {patches[1]} patches must need at most {MOST_BYTES:.2g} "
            f"bytes, got {n_bytes:.2g}"
        )


# ------------------------------------------------------------------ ways between lobes


def _legs(
    brdf: Floats, patches: RingsAndSectors, phi_i: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Strips and cells of all legs, and their slopes; see :class:`LobeTable`."""
    n_azimuths, n_angles, n_hemispheres = brdf.shape[:3]
    shape = 2, n_azimuths, max(n_angles - 1, 1), n_hemispheres, 2 * N_CELLS - 1
    strips, strip_slopes = np.empty((2, *shape))
    cells, cell_slopes = np.empty((2, *shape, shape[-1]))
    for azimuth, phi in enumerate(np.radians(phi_i)):
        histograms = _histograms(brdf[azimuth].mean(axis=-1), patches, phi)
        for leg, hemisphere in np.ndindex(shape[2:4]):
            ends = [
                histograms[min(leg + end, n_angles - 1), hemisphere] for end in (0, 1)
            ]
            here = slice(None), azimuth, leg, hemisphere
            strips[here], strip_slopes[here], cells[here], cell_slopes[here] = _leg(
                *ends
            )
    return strips, strip_slopes, cells, cell_slopes


def _histograms(brdf: Floats, patches: RingsAndSectors, phi_i: float) -> Floats:
    """Light in each cell of the disk, shape ``(N, H, N_CELLS, N_CELLS)``.

    Light comes from +x; cells are equal steps of x and of ``y / sqrt(1 - x^2)``.
    """
    n = N_CELLS * N_POINTS
    x, v = np.meshgrid(*2 * [(np.arange(n) + 0.5) * (2 / n) - 1], indexing="ij")
    across = np.sqrt(1 - x**2)
    y, z = v * across, across * np.sqrt(1 - v**2)
    turned = [
        x * np.cos(phi_i) - y * np.sin(phi_i),
        x * np.sin(phi_i) + y * np.cos(phi_i),
    ]
    index = patches.patch(np.stack([*turned, z], axis=-1))
    light = brdf.reshape(*brdf.shape[:2], -1)[..., index] * across
    light = light.reshape(*brdf.shape[:2], N_CELLS, N_POINTS, N_CELLS, N_POINTS)
    light = light.sum(axis=(3, 5))
    even = across.reshape(N_CELLS, N_POINTS, N_CELLS, N_POINTS).sum(axis=(1, 3))
    total = light.sum(axis=(2, 3), keepdims=True)
    light = light / np.where(total > 0, total, 1)
    return (1 - EVEN) * light + EVEN * even / even.sum()


def _leg(first: Floats, second: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Strips and cells of a leg between two histograms, and their slopes."""
    along = [_cumulative(histogram.sum(axis=1)) for histogram in (first, second)]
    strips, strip_slopes, of = _merged(*along)
    across = [
        _cumulative(histogram)[index] for histogram, index in zip((first, second), of)
    ]
    cells, cell_slopes, _ = _merged(*across)
    return strips, strip_slopes, cells, cell_slopes


def _positive(light: Floats) -> Floats:
    """Light, or 1 where there is none."""
    return np.where(light > 0, light, 1.0)


def _cumulative(weight: Floats) -> Floats:
    """Share of light below each edge of the last axis; even where there is none."""
    total = weight.sum(axis=-1, keepdims=True)
    share = np.where(total > 0, weight, 1.0)
    cumulative = np.cumsum(share, axis=-1)
    cumulative = cumulative / cumulative[..., -1:]
    return np.concatenate([np.zeros_like(total), cumulative], axis=-1)


def _merged(first: Floats, second: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Pieces on which the quantile functions of both distributions are linear.

    Parameters
    ----------
    first, second : ndarray, shape (..., n + 1)
        Share of the light below n + 1 equidistant edges from -1 to 1; strictly
        ascending.

    Returns
    -------
    begin, slope : ndarray, shape (2, ..., 2 n - 1)
        Where each piece begins in either distribution; its growth per share of light.
    of : ndarray of int, shape (2, ..., 2 n - 1)
        The cell that it is part of.
    """
    n = first.shape[-1] - 1
    inner = np.concatenate([first[..., 1:-1], second[..., 1:-1]], axis=-1)
    order = np.argsort(inner, axis=-1, kind="stable")
    zero = np.zeros((*first.shape[:-1], 1))
    share = np.take_along_axis(inner, order, axis=-1)
    share = np.concatenate([zero, share], axis=-1)
    passed = np.cumsum(order < n - 1, axis=-1)
    passed = np.concatenate([zero.astype(int), passed], axis=-1)
    of = np.stack([passed, np.arange(2 * n - 1) - passed])
    begin, slope = np.empty((2, *of.shape))
    for end, cumulative in enumerate((first, second)):
        low = np.take_along_axis(cumulative, of[end], axis=-1)
        high = np.take_along_axis(cumulative, of[end] + 1, axis=-1)
        slope[end] = (2 / n) / (high - low)
        begin[end] = of[end] * (2 / n) - 1 + (share - low) * slope[end]
    return begin, slope, of
