"""Transport of quantiles: how lobes move from one polar angle to the next.

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

from dataclasses import dataclass

import numpy as np

from ..array_types import Floats, Integers
from ..collector import RingsAndSectors

# Cells per side of the histograms; points per side and cell, to fill them.
N_CELLS = 32
N_POINTS = 8

# Fraction of the flux that is spread evenly over the histograms: bounds how far apart
# neighbouring points can be moved. It is not part of the lobes.
EVEN_FRACTION = 0.01


@dataclass(frozen=True, eq=False)
class TransportTable:
    """Maps of points between the polar angles of a table.

    A *leg* leads from one polar angle to the next; there are ``K = max(N - 1, 1)``.
    Across a leg, histogram edges of both ends cut the disk into ``S = 2 N_CELLS - 1``
    strips of x, and each strip into ``S`` cells of ``y / sqrt(1 - x^2)``; within one,
    points move together.

    Attributes
    ----------
    strips, strip_slopes : ndarray, shape (2, P, K, H, S)
        Where a strip begins, and its width per fraction of the flux, on both ends of
        the leg.
    cells, cell_slopes : ndarray, shape (2, P, K, H, S, S)
        The same across a strip.
    """

    strips: Floats
    strip_slopes: Floats
    cells: Floats
    cell_slopes: Floats

    @classmethod
    def of(
        cls, brdf: Floats, patches: RingsAndSectors, phi_i: Floats
    ) -> TransportTable:
        """Strips and cells of all legs of a table's lobes."""
        n_azimuths, n_angles, n_hemispheres = brdf.shape[:3]
        shape = 2, n_azimuths, max(n_angles - 1, 1), n_hemispheres, 2 * N_CELLS - 1
        strips, strip_slopes = np.empty((2, *shape))
        cells, cell_slopes = np.empty((2, *shape, shape[-1]))
        for azimuth, phi in enumerate(np.radians(phi_i)):
            histograms = _histograms(brdf[azimuth].mean(axis=-1), patches, phi)
            for leg, hemisphere in np.ndindex(shape[2:4]):
                ends = [
                    histograms[min(leg + end, n_angles - 1), hemisphere]
                    for end in (0, 1)
                ]
                here = slice(None), azimuth, leg, hemisphere
                strips[here], strip_slopes[here], cells[here], cell_slopes[here] = _leg(
                    *ends
                )
        return cls(strips, strip_slopes, cells, cell_slopes)


def _histograms(brdf: Floats, patches: RingsAndSectors, phi_i: float) -> Floats:
    """Flux in each cell of the disk, normalised, shape ``(N, H, N_CELLS, N_CELLS)``.

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
    flux = brdf.reshape(*brdf.shape[:2], -1)[..., index] * across
    flux = flux.reshape(*brdf.shape[:2], N_CELLS, N_POINTS, N_CELLS, N_POINTS)
    flux = flux.sum(axis=(3, 5))
    even = across.reshape(N_CELLS, N_POINTS, N_CELLS, N_POINTS).sum(axis=(1, 3))
    total = flux.sum(axis=(2, 3), keepdims=True)
    flux = flux / np.where(total > 0, total, 1)
    return (1 - EVEN_FRACTION) * flux + EVEN_FRACTION * even / even.sum()


def _leg(first: Floats, second: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Strips and cells of a leg between two histograms, and their slopes."""
    along = [cumulative(histogram.sum(axis=1)) for histogram in (first, second)]
    strips, strip_slopes, of = merged(*along)
    across = [
        cumulative(histogram)[index] for histogram, index in zip((first, second), of)
    ]
    cells, cell_slopes, _ = merged(*across)
    return strips, strip_slopes, cells, cell_slopes


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
