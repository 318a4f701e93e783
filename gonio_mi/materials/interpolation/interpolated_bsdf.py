"""Looking up and sampling the lobes of one face of a specimen, in Dr.Jit.

Whether lobes keep their micro-normals between polar angles is cross-validated where a
record lies between two others.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats, Integers
from ...collector import Subdivision
from ...collector.directions import direction
from ...mitsuba_compat import floats
from .incident_grid import MIN_BENDING, tried_indices
from .interpolated_lobes import (
    HalfVectorSegments,
    InterpolatedLobes,
    QuantileTransport,
)
from .lobes import LobeTable, MeasuredLobes, mean_lobe
from .lookups import (
    IncidentPatches,
    IncidentPlaces,
    Place,
    Turn,
    packet,
    seen_from,
    singles,
    towards,
    turn_by,
)


class InterpolatedBSDF:
    """Lobe table as Dr.Jit arrays, in single precision.

    Heights, and differences of directions, keep pole, horizon and what does not move.

    Directions are seen from this face: light comes from z > 0. `transmits` tells
    whether any leaves behind it.

    Parameters
    ----------
    table : LobeTable
    wavelengths : sequence of float, optional
        Of the table's channels in nm, for spectral variants.
    half_vectors : sequence of HalfVectorSegments, optional
        Of :class:`.InterpolatedLobes`, as :func:`.half_vector_segments` chooses them.
    quantiles : QuantileTransport, optional
        Of the table, where it is known.
    patches : Subdivision, optional
        In which the lobes were measured, if not in those of the table.
    """

    def __init__(
        self,
        table: LobeTable,
        wavelengths: Floats | None = None,
        half_vectors: Sequence[HalfVectorSegments] = (),
        quantiles: QuantileTransport | None = None,
        patches: Subdivision | None = None,
    ) -> None:
        self.wavelengths, self.patches = wavelengths, patches or table.patches
        self.n_hemispheres = table.brdf.shape[2]
        incident = table.grid.incident
        self.incident = (
            IncidentPatches(incident) if incident else IncidentPlaces(table.grid)
        )
        self.anisotropic = bool(incident) or self.incident.n_azimuths > 1
        self.lobes = InterpolatedLobes(table, self.incident, half_vectors, quantiles)
        # of both ends of a segment, for each hemisphere
        flux = table.flux.mean(axis=-1).reshape(-1, self.n_hemispheres)
        self.flux = singles(np.moveaxis(flux[self.incident.pairs], 1, 2))
        self.transmits = bool(table.flux[:, :, 1:].any())

    # -------------------------------------------------------------- value and density

    def eval_pdf(
        self,
        wi: mi.Vector3f,
        wo: mi.Vector3f,
        enabled: tuple[bool, bool],
        active: mi.Bool,
        wavelengths: mi.Spectrum,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """BSDF times cosine at the wavelengths, and density in 1/sr.

        `enabled` holds whether reflection and transmission are asked for.
        """
        value, total, wanted = self.values(wi, wo, enabled, active)
        cosine = dr.abs(wo.z)
        mean = sum(value) / len(value)
        pdf = dr.select(wanted & (total > 0), mean / total * cosine, 0)
        value = self._spectrum(value, wavelengths)
        return (value * cosine) & wanted, pdf

    def _spectrum(
        self, values: Sequence[mi.Float], wavelengths: mi.Spectrum
    ) -> mi.Spectrum:
        """Spectrum of the channels, linear in between and constant beyond them."""
        if len(values) == 1:
            return mi.UnpolarizedSpectrum(values[0])
        if self.wavelengths is None:
            return mi.UnpolarizedSpectrum(values)
        measured = self.wavelengths
        order = sorted(range(len(values)), key=lambda i: measured[i])
        spectrum = mi.UnpolarizedSpectrum(values[order[0]])
        for low, high in itertools.pairwise(order):
            begin, end = measured[low], measured[high]
            if end > begin:
                fraction = dr.clip((wavelengths - begin) / (end - begin), 0, 1)
                spectrum += fraction * (values[high] - values[low])
        return spectrum

    def values(
        self,
        wi: mi.Vector3f,
        wo: mi.Vector3f,
        enabled: tuple[bool, bool] = (True, True),
        active: mi.Bool = True,
    ) -> tuple[list[mi.Float], mi.Float, mi.Bool]:
        """BSDF in 1/sr in each channel; all the light; where the first is not zero."""
        lower = wo.z < 0
        wanted = active & dr.select(lower, enabled[1], enabled[0]) & (wo.z != 0)
        hemisphere = mi.UInt32(0)
        if self.n_hemispheres == 1:
            wanted &= ~lower
        else:
            hemisphere = dr.select(lower, mi.UInt32(1), hemisphere)
        frame = self.incident.frame(wi)
        point = seen_from(wo, frame)
        value = [mi.Float(0)] * self.lobes.n_channels
        total = mi.Float(0)
        for place in self.incident.around(wi, frame):
            total += sum(flux for *_, flux in self._fluxes(place, enabled))
            brdf = self.lobes.values(place, hemisphere, point, wanted)
            value = [a + place.weight * b for a, b in zip(value, brdf)]
        # differences of what is moved may round to less than 0
        return [dr.maximum(one, 0) for one in value], total, wanted

    def _fluxes(
        self, place: Place, enabled: tuple[bool, bool]
    ) -> list[tuple[int, int, mi.Float]]:
        """Hemispheres, ends of the segment, and the light that these contribute."""
        if self.n_hemispheres == 1:
            fluxes = dr.gather(mi.Point2f, self.flux, place.pair)
        else:
            fluxes = packet(self.flux, place.pair)
        return [
            (number, end, place.weight * place.fraction(end) * fluxes[2 * number + end])
            for number in range(self.n_hemispheres)
            for end in range(2)
            if enabled[number]
        ]

    # -------------------------------------------------------------- transported points

    def carried(
        self, wi: mi.Vector3f, point: mi.Point2f, hemisphere: int
    ) -> list[tuple[mi.UInt32, mi.Float, mi.Vector3f]]:
        """Where points of the records' lobes are for other incident directions.

        Parameters
        ----------
        wi : mi.Vector3f
            Incident direction of each lane.
        point : mi.Point2f
            Point of the unit disk, as seen from +z, at which a record has light.
        hemisphere : {0, 1}

        Returns
        -------
        list of (row, fraction, wo)
            For each of the records that make the lobe at `wi`: its number among those
            of all azimuths and polar angles; its weight, which add up to 1; and where
            the point is moved.
        """
        frame = self.incident.frame(wi)
        number, up = mi.UInt32(hemisphere), mi.Bool(hemisphere == 0)
        height = dr.safe_sqrt(1 - dr.squared_norm(point))
        wo = mi.Vector3f(point.x, point.y, height)
        parts = []
        for place in self.incident.around(wi, frame):
            start = seen_from(wo, turn_by(place.turns * (2 * dr.pi)))
            for end, row in enumerate(place.rows):
                moved = self.lobes.moved(place, number, start, end)
                fraction = place.weight * place.fraction(end)
                parts.append((row, fraction, towards(moved, frame, up)))
        return parts

    def sample(
        self,
        wi: mi.Vector3f,
        enabled: tuple[bool, bool],
        sample1: mi.Float,
        sample2: mi.Point2f,
    ) -> mi.Vector3f:
        """Direction of light: of a lobe picked by `sample1`, moved to its place."""
        frame = self.incident.frame(wi)
        choices = [
            (place, end, number, flux)
            for place in self.incident.around(wi, frame)
            for number, end, flux in self._fluxes(place, enabled)
        ]
        if not choices:
            return mi.Vector3f(0)
        left = sample1 * sum(flux for *_, flux in choices)
        low = high = hemisphere = mi.UInt32(0)
        end = mi.Bool(False)
        turns, cos, sin = mi.Float(0), mi.Float(1), mi.Float(0)
        for place, own_end, number, flux in choices:
            # one without light is never picked, however `left` is rounded
            this = (left >= 0) & (flux > 0)
            turns = dr.select(this, place.turns, turns)
            low = dr.select(this, place.rows[0], low)
            high = dr.select(this, place.rows[1], high)
            hemisphere = dr.select(this, number, hemisphere)
            end = dr.select(this, mi.Bool(bool(own_end)), end)
            cos = dr.select(this, place.past.cos, cos)
            sin = dr.select(this, place.past.sin, sin)
            left -= flux
        first = choices[0][0]  # both have the same polar angle
        place = replace(first, turns=turns, rows=(low, high), past=Turn(cos, sin))
        point = self.lobes.drawn(place, hemisphere, end, sample2)
        return towards(point, frame, hemisphere == 0)


# --------------------------------------------------------------------- cross-validation

# Records that are predicted from their neighbours, at most, and the part of their
# radiance that is looked at: on the patches that have most of it, or some of these.
MAX_TRIALS, RADIANCE_LOOKED_AT, MAX_PATCHES = 6, 0.99, 2**13

# Points per side of a patch.
N_POINTS = 4

# Of a refractive index: the part of it by which it may be wrong at first, and at last.
INDEX_MARGIN, INDEX_OPTIONS = 0.05, {"xatol": 1e-3}


def half_vector_segments(lobes: MeasuredLobes) -> list[HalfVectorSegments]:
    """How lobes move between polar angles, as a record's own directions say.

    On a segment with micro-normals that stay where these predict the nearest record
    better, as a camera sees it, from those of the next smaller and the next larger
    angle: better than quantiles (:class:`.QuantileTransport`), or of anisotropic ones,
    where these cost too much, lobes that stay; of two angles one from the other. Of
    patches of incidence none moves.
    """
    n_angles = len(lobes.grid.theta_i)
    if n_angles < 2 + lobes.grid.isotropic or lobes.grid.incident:
        return []
    angles = np.arange(2)
    if n_angles > 2:
        angles = np.linspace(1, n_angles - 2, MAX_TRIALS).round().astype(int)
    angles = np.unique(angles)
    trials = [_Trial(lobes, n / len(angles), k) for n, k in enumerate(angles.tolist())]
    found = []
    for hemisphere in range(lobes.flux.shape[1]):
        eta = _index(lobes, trials) if hemisphere else None
        if hemisphere and eta is None:
            continue
        way = [HalfVectorSegments(hemisphere, eta, (True,))]
        errors = ([one.error(hemisphere, way[:n]) for one in trials] for n in (0, 1))
        segments = _better(angles, *errors)[: n_angles - 1]
        found.append(HalfVectorSegments(hemisphere, eta, segments))
    return [one for one in found if any(one.segments)]


def _better(
    angles: Integers, others: Sequence[float], by_normals: Sequence[float]
) -> tuple[bool, ...]:
    """On which segments micro-normals are better, where nearest records are tried.

    `angles` are the numbers of these records' polar angles.
    """
    gains = np.subtract(others, by_normals)
    segments = []
    for segment in range(angles.max() + 1):
        distance = np.abs(angles - segment - 0.5)
        segments.append(bool(gains[distance == distance.min()].sum() > 0))
    return tuple(segments)


def _index(lobes: MeasuredLobes, trials: Sequence[_Trial]) -> float | None:
    """Refractive index of transmission that predicts a record best, or None.

    That of transmission between azimuths, if there is one.
    """
    grid = lobes.grid
    if grid.eta is not None:
        return grid.eta
    azimuth, angle = np.nonzero(grid.index >= 0)
    measured = zip(azimuth.tolist(), angle.tolist())
    brdf = [mean_lobe(lobes.brdf([n], [k])[0, 0, 1]) for n, k in measured]
    flux = np.array(brdf) * lobes.patches.projected_solid_angles
    incidents = grid.theta_i[angle], grid.phi_i[azimuth]
    tried = tried_indices(flux, *incidents, lobes.patches)
    if not tried:
        return None
    middle = trials[len(trials) // 2]

    def error(eta: float) -> float:
        return middle.error(1, [HalfVectorSegments(1, eta, (True,))])

    best = min(tried, key=error)
    around = best * (1 - INDEX_MARGIN), best * (1 + INDEX_MARGIN)
    from scipy.optimize import minimize_scalar  # half a second, which no other needs

    found = minimize_scalar(
        error, bounds=around, method="bounded", options=INDEX_OPTIONS
    )
    # so near to 1 that nothing is refracted, there is none to find
    finer = [float(found.x)] if abs(found.x - 1) > MIN_BENDING else []
    return min([best, *finer], key=error)


class _Trial:
    """A record beside one or between two others of the same azimuth.

    Parameters
    ----------
    lobes : MeasuredLobes
    position : float
        Which of the azimuths: 0 for the first that were measured there, to 1.
    angle : int
        Number of its polar angle.
    """

    def __init__(self, lobes: MeasuredLobes, position: float, angle: int) -> None:
        grid = lobes.grid
        known = np.flatnonzero(grid.index[:, angle] >= 0)
        azimuth = int(known[int(position * len(known))])
        n_angles = len(grid.theta_i)
        beside = [n for n in (angle - 1, angle + 1) if 0 <= n < n_angles]
        self.table = lobes.table([azimuth], beside)
        self.quantiles = QuantileTransport(self.table) if grid.isotropic else None
        self.lobes = mean_lobe(lobes.brdf([azimuth], [angle])[0, 0])
        self.wi = direction(*np.radians([grid.theta_i[angle], grid.phi_i[azimuth]]))

    def error(
        self, hemisphere: int, half_vectors: Sequence[HalfVectorSegments]
    ) -> float:
        """Sum of absolute errors of radiance over the patches looked at.

        With these `half_vectors`, or without. By radiance: a diffuse part that
        moves with micro-normals is up to some times brighter near the horizon, where
        flux is too small to show it.
        """
        patches = self.table.patches
        radiance = (self.lobes[hemisphere] * patches.solid_angles).ravel()
        if not radiance.any():
            return 0.0
        order = np.argsort(-radiance, kind="stable")
        needed = RADIANCE_LOOKED_AT * radiance.sum()
        few = np.searchsorted(np.cumsum(radiance[order]), needed)
        number = np.sort(order[: few + 1 : 1 + few // MAX_PATCHES])
        points = patches.points(N_POINTS, number)
        points[..., 2] *= -1 if hemisphere else 1
        wo = mi.Vector3f(*map(floats, points.reshape(-1, 3).T))
        wi = mi.Vector3f(*map(floats, self.wi[:, None]))
        face = InterpolatedBSDF(self.table, None, half_vectors, self.quantiles)
        values, _, wanted = face.values(wi, wo)
        mean = mi.Float64(dr.select(wanted, sum(values) / len(values), 0.0))
        means = dr.block_sum(mean, N_POINTS**2).numpy() / N_POINTS**2
        areas = patches.solid_angles.ravel()[number]
        return float(np.abs(means * areas - radiance[number]).sum())
