"""A stack of records as tables of lobes: what is looked up in them, and drawn of them.

Between two polar angles lobes move by the transport of quantiles, or as micro-normals
have it, which is in :mod:`.half_vectors`, as are changes with the azimuth.

Seen from the unit disk onto which the hemisphere projects, flux per area is the BRDF
itself. Turned so that light comes from +x, a mirror lobe lies at ``x = -sin(theta_i)``:
between two incident angles, what both have in different places is moved on straight
lines over the disk, and what both have in one place stays there.

Which point of one lobe belongs to which of the other is decided by their quantiles:
those along x first, then those across (the Knothe-Rosenblatt map; for one dimension see
A. L. Read, *Linear interpolation of histograms*, 1999,
doi:10.1016/S0168-9002(98)01347-3), of histograms that are coarse on purpose, so that
the noise of a record does not steer its lobes. Those that are moved are the records
themselves, all of them: no flux is lost or made.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats, Integers, Singles
from ...collector import RingsAndSectors
from ...errors import SettingError, check_memory
from ...results.patch_means import PatchMeans
from ...results.record import Record
from .half_vectors import gradients
from .incident_grid import IncidentGrid

# Cells per side of the histograms; points per side and cell, to fill them.
N_CELLS = 32
N_POINTS = 8

# Fraction of the flux that is spread evenly over the histograms: bounds how far apart
# neighbouring points can be moved. It is not part of the lobes.
EVEN_FRACTION = 0.01


def transport_pieces(
    brdf: Floats, patches: RingsAndSectors, phi_i: float
) -> tuple[Singles, Singles]:
    """Maps of points between the polar angles of the lobes of an azimuth.

    A *segment* leads from one polar angle to the next; there are ``K = N - 1``.
    Across a segment, histogram edges of both ends cut the disk into
    ``S = 2 N_CELLS - 1`` strips of x, and each strip into ``S`` cells of
    ``y / sqrt(1 - x^2)``; within one, points move together.

    Returns
    -------
    strips : ndarray of float32, shape (K, H, S, 4)
        Where a strip begins on both ends of the segment, and its widths there per
        fraction of the flux.
    cells : ndarray of float32, shape (K, H, S, S, 4)
        The same across a strip.
    """
    n_angles, n_hemispheres = brdf.shape[:2]
    shape = n_angles - 1, n_hemispheres, 2 * N_CELLS - 1
    strips, cells = aligned((*shape, 4)), aligned((*shape, shape[-1], 4))
    histograms = _histograms(brdf, patches, np.radians(phi_i))
    for segment, hemisphere in np.ndindex(shape[:2]):
        found = _segment(*histograms[segment : segment + 2, hemisphere])
        for array, own in zip((strips, cells), (found[:2], found[2:])):
            array[segment, hemisphere] = np.moveaxis(np.concatenate(own), 0, -1)
    return strips, cells


def _histograms(brdf: Floats, patches: RingsAndSectors, phi_i: float) -> Floats:
    """Flux in each cell of the disk, normalised, shape ``(N, H, N_CELLS, N_CELLS)``.

    Of all channels of the lobes ``(N, H, n_theta, n_phi, channels)`` of an azimuth.
    Light comes from +x; cells are equal steps of x and of ``y / sqrt(1 - x^2)``.
    """
    across, index = _points(patches, phi_i, N_CELLS * N_POINTS)
    points = N_CELLS, N_POINTS, N_CELLS, N_POINTS
    flux = np.moveaxis(np.empty((N_CELLS, N_CELLS, *brdf.shape[:2])), (2, 3), (0, 1))
    for lobe in np.ndindex(brdf.shape[:2]):
        at_points = mean_lobe(brdf[lobe]).ravel()[index] * across
        of_cells = at_points.reshape(points).transpose(1, 3, 0, 2)
        flux[lobe] = of_cells.reshape(-1, N_CELLS, N_CELLS).sum(axis=0)
    even = across.reshape(points).sum(axis=(1, 3))
    total = flux.sum(axis=(2, 3), keepdims=True)
    flux = flux / np.where(total > 0, total, 1)
    return (1 - EVEN_FRACTION) * flux + EVEN_FRACTION * even / even.sum()


@functools.lru_cache(maxsize=16)
def _points(patches: RingsAndSectors, phi_i: float, n: int) -> tuple[Floats, Integers]:
    """``n x n`` points of the cells: ``sqrt(1 - x^2)``, and their patches."""
    x, v = np.meshgrid(*2 * [(np.arange(n) + 0.5) * (2 / n) - 1], indexing="ij")
    across = np.sqrt(1 - x**2)
    y, z = v * across, across * np.sqrt(1 - v**2)
    sin, cos = np.sin(phi_i), np.cos(phi_i)
    wo = np.stack([x * cos - y * sin, x * sin + y * cos, z], axis=-1)
    return across, patches.patch(wo)


def _segment(first: Floats, second: Floats) -> tuple[Floats, ...]:
    """Strips and cells of a segment between two histograms, and their slopes."""
    both = first, second
    *strips, of = merged(*(cumulative(one.sum(axis=1)) for one in both))
    *cells, _ = merged(*(cumulative(one)[index] for one, index in zip(both, of)))
    return *strips, *cells


def cumulative(weight: Floats) -> Floats:
    """Fraction of the flux below each edge of the last axis; even without any flux."""
    total = weight.sum(axis=-1, keepdims=True)
    fraction = np.where(total > 0, weight, 1.0)
    cumulative = np.cumsum(fraction, axis=-1)
    cumulative = cumulative / cumulative[..., -1:]
    return np.concatenate([np.zeros_like(total), cumulative], axis=-1)


def merged(first: Floats, second: Floats) -> tuple[Floats, Floats, Integers]:
    """Pieces on which the quantile functions of both distributions are linear.

    Parameters
    ----------
    first, second : ndarray, shape (..., n + 1)
        Fraction of the flux below n + 1 equidistant edges from -1 to 1; strictly
        ascending.

    Returns
    -------
    begin, slope : ndarray, shape (2, ..., 2 n - 1)
        Where each piece begins in either distribution; its growth per fraction of the
        flux.
    of : ndarray of int, shape (2, ..., 2 n - 1)
        The cell that it is part of.
    """
    n = first.shape[-1] - 1
    inner = np.concatenate([first[..., 1:-1], second[..., 1:-1]], axis=-1)
    order = np.argsort(inner, axis=-1, kind="stable")
    zero = np.zeros((*first.shape[:-1], 1))
    fraction = np.take_along_axis(inner, order, axis=-1)
    fraction = np.concatenate([zero, fraction], axis=-1)
    passed = np.cumsum(order < n - 1, axis=-1)
    passed = np.concatenate([zero.astype(int), passed], axis=-1)
    of = np.stack([passed, np.arange(2 * n - 1) - passed])
    begin, slope = np.empty((2, *of.shape))
    for end, cumulative in enumerate((first, second)):
        low = np.take_along_axis(cumulative, of[end], axis=-1)
        high = np.take_along_axis(cumulative, of[end] + 1, axis=-1)
        slope[end] = (2 / n) / (high - low)
        begin[end] = of[end] * (2 / n) - 1 + (fraction - low) * slope[end]
    return begin, slope, of


# ---------------------------------------------------------------------- tables of lobes

# Of the whole table as Dr.Jit holds it: half of what a machine of 8 GiB has. While it
# is made, it needs a fifth more.
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
    cells : ndarray of float32, shape (P, N, H, n_theta, n_phi, numbers)
        All that is looked up in a patch; see :func:`packed_cells`.
    flux : ndarray, shape (P, N, H, channels)
        Flux fractions: reflectance and transmittance.
    """

    grid: IncidentGrid
    patches: RingsAndSectors
    brdf: Floats
    cells: Singles
    flux: Floats

    def cumulative(self) -> tuple[Floats, Singles]:
        """Fractions of the flux (mean of the channels) by which points are drawn.

        Below each edge of rings, shape ``(P, N, H, n_theta + 1)``, and within a ring
        below each edge of azimuth, of float32, ``(P, N, H, n_theta, n_phi + 1)``.
        """
        *lobes, n_theta, n_phi, _ = self.brdf.shape
        areas = self.patches.projected_solid_angles
        totals = np.empty((*lobes, n_theta))
        sectors = np.empty((*lobes, n_theta, n_phi + 1), np.float32)
        for lobe in np.ndindex(*lobes):
            weight = mean_lobe(self.brdf[lobe]) * areas
            totals[lobe] = weight.sum(axis=-1)
            sectors[lobe] = cumulative(weight)
        return cumulative(totals), sectors


def n_numbers(n_channels: int) -> int:
    """How many numbers of a patch are looked up: whole packets of four."""
    n_lobes = n_channels + (n_channels > 1)
    return -(-3 * n_lobes // 4) * 4


def packed_cells(lobe: Floats, changes: Floats) -> Floats:
    """All that is looked up in each patch of a lobe, side by side.

    Of the mean of the channels, and then of each of them if there are several, its mean
    over the patch and its changes across it, along the polar angle and the azimuth.

    Parameters
    ----------
    lobe : ndarray, shape (n_theta, n_phi, channels)
    changes : ndarray, shape (2, n_theta, n_phi, channels)
        See :func:`.half_vectors.gradients`.
    """
    numbers = np.stack([lobe, *changes], axis=-1)
    if lobe.shape[-1] > 1:
        mean = numbers.mean(axis=-2, keepdims=True)
        numbers = np.concatenate([mean, numbers], axis=-2)
    flat = numbers.reshape(*lobe.shape[:2], -1)
    unused = n_numbers(lobe.shape[-1]) - flat.shape[-1]
    return np.pad(flat, ((0, 0), (0, 0), (0, unused)))


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
        n_azimuths, n_angles = self.grid.index.shape
        n_bytes = check_table(n_azimuths, n_angles, self._shape)
        making = "a table of this record, while it is made,"
        check_memory(making, 1.2 * n_bytes, "measure on fewer patches")
        return self.table(range(n_azimuths), range(n_angles))

    @property
    def _shape(self) -> tuple[int, ...]:
        """``(H, n_theta, n_phi, channels)`` of the lobes of a direction."""
        n_channels = self.flux.shape[-1] if self.mixture is None else 1
        return self.flux.shape[1], *self.patches.shape, n_channels

    def table(self, azimuths: Sequence[int], angles: Sequence[int]) -> LobeTable:
        """Table of some azimuths and polar angles, as if no others were known."""
        brdf, rings = self.brdf(azimuths, angles), self.patches
        cells = aligned((*brdf.shape[:-1], n_numbers(brdf.shape[-1])))
        flux = np.einsum("pnhrsc,rs->pnhc", brdf, rings.projected_solid_angles)
        for lobe in np.ndindex(brdf.shape[:3]):  # by lobe: all at once need the memory
            changes = np.zeros((2, *brdf.shape[3:]))
            if rings == self.measured:  # else what is below them has no rings
                changes = gradients(brdf[lobe], rings.theta_edges, rings.phi_edges)
            cells[lobe] = packed_cells(brdf[lobe], changes)
        part = self.grid.part(azimuths, angles)
        return LobeTable(part, rings, brdf, cells, flux)

    def brdf(self, azimuths: Sequence[int], angles: Sequence[int]) -> Floats:
        """BRDF and BTDF in 1/sr, shape ``(P, N, H, n_theta, n_phi, channels)``."""
        brdf = np.empty((len(azimuths), len(angles), *self._shape))
        areas = self.measured.projected_solid_angles[..., None]
        for column, angle in enumerate(angles):
            found = self.grid.filled(self.flux, azimuths, [angle])
            if self.mixture is not None:
                found = found @ np.asarray(self.mixture, dtype=float)[:, None]
            # a sum that is negative by chance is no light
            found = np.maximum(found, 0) / areas
            brdf[:, column] = self.measured.in_rings(found)[1][:, 0]
        return brdf


def aligned(shape: tuple[int, ...]) -> Singles:
    """Zeros of single precision, in the place of Dr.Jit's arrays.

    Dr.Jit takes NumPy's memory as it is: a table is not copied. A kernel that reads
    from a place that is no multiple of 64 bytes is another one: another record would be
    compiled anew, by chance.
    """
    n = math.prod(shape)
    memory = np.zeros(n + 15, np.float32)
    start = -memory.ctypes.data % 64 // 4
    return memory[start:][:n].reshape(shape)


def mean_lobe(lobe: Floats) -> Floats:
    """Mean of a lobe's channels."""
    mean: Floats = np.ascontiguousarray(lobe).mean(axis=-1)
    return mean


def is_significant(part: float, total: float) -> bool:
    """Whether double precision distinguishes a part of the total from none."""
    return bool(part > np.finfo(float).eps * total)


def check_table(n_azimuths: int, n_angles: int, lobes: tuple[int, ...]) -> float:
    """Bytes that the table of so many directions needs, with what Dr.Jit holds of it.

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
    # means in double precision; packets, and fractions of the flux with their index
    of_patch = 8 * n_channels + 4 * (n_numbers(n_channels) + 2)
    each = n_hemispheres * math.prod(patches) * of_patch
    if n_azimuths == 1:
        each += 28 * n_hemispheres * (2 * N_CELLS) ** 2
    n_bytes = n_azimuths * n_angles * each
    if n_bytes > MAX_BYTES:
        raise TooLargeError(
            f"a table of {n_azimuths} x {n_angles} incident directions and "
            f"{patches[0]} x {patches[1]} patches must need at most {MAX_BYTES:.2g} "
            f"bytes, got {n_bytes:.2g}"
        )
    return n_bytes
