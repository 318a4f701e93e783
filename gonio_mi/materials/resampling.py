"""Flux of a record resampled to the patches of another format, without gain or loss.

Between its incident directions a record is what the BSDF plugin `goniometric` makes of
it. Values at points of the new patches find all the light of smooth lobes; what is
narrow they may miss or count twice. There the light of every patch of the record is
carried to where it belongs instead. A peak at the mirror direction, or straight on,
that is no wider than its patch stays at that direction, and so lands in one patch.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..collector.directions import direction
from ..collector.hemisphere import Subdivision
from ..mitsuba_compat import floats
from ..progress import counted
from ..results.patch_means import PatchMeans
from ..results.record import Record, fractions_of
from .interpolation.incident_grid import patches_of_incidence
from .interpolation.interpolated_bsdf import InterpolatedBSDF, half_vector_segments
from .interpolation.lobes import MeasuredLobes
from .interpolation.lookups import seen_from, turn_by

# Fraction of the flux that values at points may miss before it is carried.
MAX_MISSED = 0.01

# Smaller fractions of the incident flux are rounding.
ROUNDING = 1e-12

# Incident directions for which light is carried at once.
N_AT_ONCE = 64

# Values that are asked for at once, at most or for one incident patch.
VALUES_AT_ONCE = 2**20

# Points to which the light of a record's patches is divided, at least.
MIN_POINTS = 2**13

# How far beyond the edges of a patch its neighbours are looked for, in radians.
EDGE_OFFSET = 1e-4


class Material:
    """BRDF and BTDF of a record between its incident directions.

    As the BSDF plugin `goniometric` has them. It needs a variant of Dr.Jit.

    Parameters
    ----------
    record : Record or PatchMeans
    peaks : ndarray, shape (n_incident, n_hemispheres, channels), optional
        Flux fractions at the mirror direction, and straight on, that are taken out: see
        :func:`specular_peaks`.

    Attributes
    ----------
    theta_i, phi_i : ndarray
        The record's incident directions in degrees, ascending.
    channels : tuple of str
    table : LobeTable
    peaks : ndarray, shape (P, N, H, channels)
        What was taken out.

    Raises
    ------
    ValueError
        If the incident directions are unknown or no grid; see `MeasuredLobes`.
    """

    def __init__(
        self, record: Record | PatchMeans, peaks: Floats | None = None
    ) -> None:
        self.channels = record.channels
        flux = fractions_of(record)
        self.n_hemispheres = flux.shape[1]
        if peaks is None:
            peaks = np.zeros((*flux.shape[:2], flux.shape[-1]))
        else:
            flux = flux.copy()
            rows, columns = np.unravel_index(_specular_patch(record), flux.shape[2:4])
            index = np.arange(len(flux))
            flux[index, :, rows, columns] -= peaks
            flux = np.maximum(flux, 0)  # up to rounding
        asked = record.theta_i, record.phi_i, record.channels
        incident = patches_of_incidence(record)
        rest = PatchMeans(record.subdivision, *asked, flux, incident=incident)
        lobes = MeasuredLobes(rest, keep_dark=True)
        self.table = table = lobes.whole()
        self.peaks = table.grid.filled(peaks)
        self.theta_i, self.phi_i = table.grid.theta_i, table.grid.phi_i
        self._face = InterpolatedBSDF(table, half_vectors=half_vector_segments(lobes))

    def values(self, theta_i: ArrayLike, phi_i: ArrayLike, wo: Floats) -> Floats:
        """BRDF or BTDF in 1/sr, shape ``(n, channels)``, without the `peaks`.

        Parameters
        ----------
        theta_i, phi_i : float or array_like, shape (n,)
            Incident directions in degrees, from the normal of the lit face.
        wo : array_like, shape (n, 3)
            Unit vectors of exit; z > 0 is the lit side.
        """
        node = self._node(theta_i, phi_i)
        if node is not None:
            values, wanted = self._measured(node, vectors(wo))
        else:
            wi = direction(np.radians(theta_i), np.radians(phi_i))
            wi, wo = (vectors(v) for v in np.broadcast_arrays(wi, wo))
            values, _, wanted = self._face.values(wi, wo)
        dr.eval(values, wanted)
        inside = np.broadcast_to(wanted.numpy(), dr.width(values))
        return np.stack([np.where(inside, v.numpy(), 0) for v in values], axis=-1)

    def _node(self, theta_i: ArrayLike, phi_i: ArrayLike) -> tuple[int, int] | None:
        """Numbers of a measured azimuth and polar angle; None between them."""
        if np.ndim(theta_i) or np.ndim(phi_i) or self.table.grid.incident:
            return None
        azimuth = np.flatnonzero(self.phi_i % 360 == np.mod(phi_i, 360))
        angle = np.flatnonzero(self.theta_i == theta_i)
        if not (azimuth.size and angle.size):
            return None
        return int(azimuth[0]), int(angle[0])

    def _measured(self, node: tuple[int, int], wo: Any) -> tuple[list[Any], Any]:
        """Values at measured incidence, where no lobe moves, and where they hold."""
        row = mi.UInt32(node[0] * len(self.theta_i) + node[1])
        turns = mi.Float(self.phi_i[node[0]] / 360)
        dr.make_opaque(row, turns)
        lower = wo.z < 0
        wanted = (wo.z != 0) & ((self.n_hemispheres > 1) | ~lower)
        row = row * self.n_hemispheres + dr.select(lower, mi.UInt32(1), 0)
        point = seen_from(wo, turn_by(turns * (2 * dr.pi)))
        return self._face.lobes.measured.values(row, turns, point, wanted), wanted

    def totals(
        self, hemisphere: int, theta_i: Floats, phi_i: Floats
    ) -> tuple[Floats, Floats]:
        """Flux fractions without the peaks, and of these, ``(n, channels)`` each."""
        wi = vectors(direction(np.radians(theta_i), np.radians(phi_i)))
        flux, peaks = (
            a.reshape(-1, *a.shape[2:])[:, hemisphere]
            for a in (self.table.flux, self.peaks)
        )
        sums = np.zeros((2, len(theta_i), len(self.channels)))
        for row, share, _ in self._face.carried(wi, mi.Point2f(0), hemisphere):
            number = np.broadcast_to(row.numpy(), len(theta_i))
            part = np.broadcast_to(share.numpy(), len(theta_i))[:, None]
            sums += part * [flux[number], peaks[number]]
        return sums[0], sums[1]

    def carried(
        self, hemisphere: int, theta_i: Floats, phi_i: Floats, patches: Subdivision
    ) -> Floats:
        """Light of all patches of the record in others, ``(n, n_patches, channels)``.

        Flux fractions for incident directions ``(n,)`` in degrees, without the peaks.
        """
        points, flux = self._points(hemisphere)
        n, each = len(theta_i), len(points)
        light = np.zeros((n, patches.n_patches, len(self.channels)))
        if not each:
            return light
        wi: Any = direction(np.radians(theta_i), np.radians(phi_i))
        xy = mi.Point2f(*map(floats, np.tile(points, (n, 1)).T))
        bins, size = np.repeat(np.arange(n), each), n * patches.n_patches
        parts = self._face.carried(vectors(np.repeat(wi, each, axis=0)), xy, hemisphere)
        for row, share, wo in parts:
            dr.eval(row, share, wo)
            row, share = (np.broadcast_to(a.numpy(), n * each) for a in (row, share))
            index = bins * patches.n_patches + patches.patch(wo.numpy().T)
            weights = share[:, None] * flux[row, np.tile(np.arange(each), n)]
            for channel, weight in enumerate(weights.T):
                counts = np.bincount(index, weight, size)
                light[..., channel] += counts.reshape(n, -1)
        return light

    def _points(self, hemisphere: int) -> tuple[Floats, Floats]:
        """Points of the disk in the record's patches, and the light that each has.

        Shapes ``(n, 2)`` and ``(rows, n, channels)``.
        """
        table = self.table
        sin2, phi = np.sin(table.patches.theta_edges) ** 2, table.patches.phi_edges
        areas = np.diff(sin2)[:, None] * np.diff(phi) / 2
        flux = table.brdf[:, :, hemisphere] * areas[..., None]
        flux = flux.reshape(-1, areas.size, flux.shape[-1])
        lit = np.flatnonzero(flux.any(axis=(0, 2)))
        n = int(np.ceil(np.sqrt(MIN_POINTS / max(lit.size, 1))))
        ring, sector = np.unravel_index(lit, areas.shape)
        step = (np.arange(n) + 0.5) / n
        r = np.sqrt(sin2[ring, None] + step * np.diff(sin2)[ring, None])[..., None]
        turn = (phi[sector, None] + step * np.diff(phi)[sector, None])[:, None]
        points = np.stack([r * np.cos(turn), r * np.sin(turn)], axis=-1)
        return points.reshape(-1, 2), np.repeat(flux[:, lit] / n**2, n**2, axis=1)


def vectors(v: Floats) -> Any:
    """Dr.Jit vectors of an array ``(n, 3)``: no kernel depends on `n`."""
    return mi.Vector3f(*map(floats, v.T))


# ----------------------------------------------------------------------------- peaks


def specular_peaks(record: Record) -> Floats:
    """Light that is no wider than a patch at the mirror direction, or straight on.

    By how much that patch is brighter than the brightest of its neighbours, but at
    least the direct light of a periodic cell: flux fractions, shape
    ``(n_incident, n_hemispheres, channels)``.
    """
    flux, patches = fractions_of(record), record.subdivision
    projected = patches.projected_solid_angles.ravel()
    values = flux.reshape(*flux.shape[:2], -1, flux.shape[-1]) / projected[:, None]
    direct = record.direct if record.stacked else record.direct[None]
    peaks = np.zeros((*flux.shape[:2], flux.shape[-1]))
    for index, patch in enumerate(_specular_patch(record)):
        around = _neighbours(patches, int(patch))
        above = values[index][:, patch] - values[index][:, around].max(axis=1)
        peaks[index] = np.maximum(above, 0) * projected[patch]
        if record.has_lower:
            most = values[index, 1, patch] * projected[patch]
            peaks[index, 1] = np.clip(direct[index], peaks[index, 1], most)
    return peaks


def _specular_patch(record: Record | PatchMeans) -> Any:
    """Patches of the mirror directions, which are also those straight on."""
    opposite = direction(np.radians(record.theta_i), np.radians(record.phi_i) + np.pi)
    return record.subdivision.patch(opposite)


def _neighbours(patches: Subdivision, patch: int) -> Any:
    """Numbers of the patches beyond the edges of one."""
    low, high, left, right = patches.cells_about_pole()[patch]
    middle = (low + high) / 2
    sides = [(middle, left - EDGE_OFFSET), (middle, right + EDGE_OFFSET)]
    ends = [
        (theta, phi)
        for theta in (low - EDGE_OFFSET, high + EDGE_OFFSET)
        for phi in np.linspace(left, right, 9)
        if 0 < theta < np.pi / 2
    ]
    around = patches.patch(direction(*np.transpose(sides + ends)))
    return np.setdiff1d(around, [patch])


# ------------------------------------------------------------------------ new patches


def resampled(
    material: Material,
    hemisphere: int,
    theta_i: Floats,
    phi_i: Floats,
    patches: Subdivision,
    points: int,
    progress: bool = False,
) -> Floats:
    """Flux fractions in other patches, ``(n_in, n_patches, channels)``.

    They add up to those of the record, linear in the sine of the polar angle between
    its incident directions.

    Parameters
    ----------
    material : Material
        Whose peaks are apart.
    hemisphere : {0, 1}
        Reflection or transmission.
    theta_i, phi_i : ndarray, shape (n_in, points)
        Incident directions in degrees, over which is averaged.
    patches : Subdivision
    points : int
        Points per side of a patch at which values are asked for.
    progress : bool
    """
    n_in = theta_i.shape[1]
    projected = patches.projected_solid_angles.reshape(-1, 1)
    wo = patches.points(points)
    exits = wo.reshape(-1, 3) * [1, 1, -1 if hemisphere else 1]
    fluxes = []
    n_chunks = -(-theta_i.size * wo[..., 0].size // VALUES_AT_ONCE)
    chunks = list(zip(*(np.array_split(a, n_chunks) for a in (theta_i, phi_i))))
    for chunk in counted(chunks, progress, desc="resample", unit="part"):
        theta, phi = (angles.ravel() for angles in chunk)
        # values at all points of exit for each of the incident directions
        thetas, phis = (np.repeat(angles, len(exits)) for angles in (theta, phi))
        values = material.values(thetas, phis, np.tile(exits, (len(theta), 1)))
        shape = len(theta), *wo.shape[:2], values.shape[-1]
        flux = projected * values.reshape(shape).mean(axis=2)
        total, peak = material.totals(hemisphere, theta, phi)
        found = flux.sum(axis=1)
        missed = np.any(np.abs(found - total) > MAX_MISSED * total + ROUNDING, axis=-1)
        # of all points of an incident patch, or of none
        missed = np.repeat(missed.reshape(-1, n_in).any(axis=1), n_in)
        n_parts = missed.sum() // N_AT_ONCE + 1
        for some in np.array_split(np.flatnonzero(missed), n_parts):
            if some.size:
                carried = material.carried(hemisphere, theta[some], phi[some], patches)
                flux[some] = carried
        scale = np.where(found > 0, total / np.where(found > 0, found, 1), 0)
        flux[~missed] *= scale[~missed, None]
        straight = patches.patch(direction(np.radians(theta), np.radians(phi) + np.pi))
        flux[np.arange(len(theta)), straight] += peak
        fluxes.append(flux.reshape(-1, n_in, *flux.shape[1:]).mean(axis=1))
    return np.concatenate(fluxes)


def half_vector_grids(
    material: Material, phi_i: float, origin: float, size: int, n: int = 4
) -> Floats:
    """BRDF times cosine on grids of half vectors, ``(N, channels, size, size)``.

    One for each polar angle of incidence of the material. Rows are azimuths of the half
    vector from `origin`, -pi to pi; columns its polar angles, in equal steps of the
    square root. Each value is a mean over the grid's cell about it.

    Parameters
    ----------
    material : Material
    phi_i, origin : float
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
    half = direction(theta_m, phi_m).reshape(-1, 3)
    grids = []
    for theta_i in material.theta_i:
        wi = direction(np.radians(theta_i), np.radians(phi_i))
        wo = 2 * (half @ wi)[:, None] * half - wi
        above = wo[:, 2] > 0
        values = np.zeros((len(wo), len(material.channels)))
        values[above] = material.values(theta_i, phi_i, wo[above]) * wo[above, 2:]
        grids.append(values.reshape(size, n, size, n, -1).mean(axis=(1, 3)))
    return np.moveaxis(np.stack(grids), -1, 1)
