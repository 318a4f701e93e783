"""Looking up and sampling the lobes of one face of a specimen, in Dr.Jit."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..array_types import Floats
from .interpolated_lobes import HalfVectorLegs, InterpolatedLobes
from .lobes import LobeTable
from .lookups import IncidentPlaces, Place, doubles, read, seen_from, towards


class InterpolatedBSDF:
    """Lobe table as Dr.Jit arrays; double precision keeps pole and horizon.

    Directions are seen from this face: light comes from z > 0. `transmits` tells
    whether any leaves behind it.

    Parameters
    ----------
    table : LobeTable
    wavelengths : sequence of float, optional
        Of the table's channels in nm, for spectral variants.
    half_vectors : sequence of HalfVectorLegs, optional
        Of :class:`.InterpolatedLobes`, as :func:`.half_vector_legs` chooses them.
    """

    def __init__(
        self,
        table: LobeTable,
        wavelengths: Floats | None = None,
        half_vectors: Sequence[HalfVectorLegs] = (),
    ) -> None:
        self.wavelengths = wavelengths
        self.n_azimuths, _, self.n_hemispheres = table.brdf.shape[:3]
        self.incident = IncidentPlaces(table.grid)
        self.lobes = InterpolatedLobes(table, self.incident, half_vectors)
        self.flux = doubles(table.flux.mean(axis=-1))
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
        pdf = dr.select(wanted & (total > 0), mi.Float(mean / total) * cosine, 0)
        value = self._spectrum([mi.Float(channel) for channel in value], wavelengths)
        return (value * cosine) & wanted, pdf

    def _spectrum(
        self, values: Sequence[mi.Float], wavelengths: mi.Spectrum
    ) -> mi.Spectrum:
        """Spectrum of the channels, linear in between and constant beyond them."""
        if len(values) == 1:
            return mi.Spectrum(values[0])
        if self.wavelengths is None:
            return mi.Spectrum(values)
        measured = self.wavelengths
        order = sorted(range(len(values)), key=lambda i: measured[i])
        spectrum = mi.Spectrum(values[order[0]])
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
    ) -> tuple[list[mi.Float64], mi.Float64, mi.Bool]:
        """BSDF in 1/sr in each channel; all the light; where the first is not zero."""
        lower = wo.z < 0
        wanted = active & dr.select(lower, enabled[1], enabled[0]) & (wo.z != 0)
        hemisphere = mi.UInt32(0)
        if self.n_hemispheres == 1:
            wanted &= ~lower
        else:
            hemisphere = dr.select(lower, mi.UInt32(1), hemisphere)
        phi_i = self.incident.azimuth(wi)
        point = seen_from(wo, phi_i)
        value = [mi.Float64(0)] * self.lobes.n_channels
        total = mi.Float64(0)
        for place in self.incident.around(wi, phi_i):
            for number in self._hemispheres(enabled):
                total += sum(self._fluxes(place, number))
            brdf = self.lobes.values(place, hemisphere, point, wanted)
            value = [a + place.weight * b for a, b in zip(value, brdf)]
        return value, total, wanted

    def _fluxes(self, place: Place, hemisphere: int) -> tuple[mi.Float64, mi.Float64]:
        """Light that both ends of the leg contribute to a hemisphere."""
        rows = [row * self.n_hemispheres + hemisphere for row in place.rows]
        low, high = (read(self.flux, row) for row in rows)
        return place.weight * (1 - place.t) * low, place.weight * place.t * high

    def _hemispheres(self, enabled: tuple[bool, bool]) -> list[int]:
        return [n for n in range(self.n_hemispheres) if enabled[n]]

    # -------------------------------------------------------------- transported points

    def carried(
        self, wi: mi.Vector3f, point: mi.Point2f, hemisphere: int
    ) -> list[tuple[mi.UInt32, mi.Float64, mi.Vector3f]]:
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
        phi_i = self.incident.azimuth(wi)
        number, up = mi.UInt32(hemisphere), mi.Bool(hemisphere == 0)
        height = dr.safe_sqrt(1 - dr.squared_norm(point))
        wo = mi.Vector3f(point.x, point.y, height)
        parts = []
        for place in self.incident.around(wi, phi_i):
            start = seen_from(wo, self.incident.measured(place.azimuth))
            for end, row in enumerate(place.rows):
                moved = self.lobes.moved(place, number, start, mi.Float64(end))
                fraction = place.weight * place.fraction(end)
                parts.append((row, fraction, towards(moved, phi_i, up)))
        return parts

    def sample(
        self,
        wi: mi.Vector3f,
        enabled: tuple[bool, bool],
        sample1: mi.Float,
        sample2: mi.Point2f,
    ) -> mi.Vector3f:
        """Direction of light: of a lobe picked by `sample1`, moved to its place."""
        phi_i = self.incident.azimuth(wi)
        choices = [
            (place, end, number, flux)
            for place in self.incident.around(wi, phi_i)
            for number in self._hemispheres(enabled)
            for end, flux in enumerate(self._fluxes(place, number))
        ]
        if not choices:
            return mi.Vector3f(0)
        left = mi.Float64(sample1) * sum(flux for *_, flux in choices)
        picked = [mi.UInt32(0)] * 5 + [mi.Float64(0)] * 2
        for place, end, number, flux in choices:
            # one without light is never picked, however `left` is rounded
            this = (left >= 0) & (flux > 0)
            own = place.azimuth, place.leg, *place.rows, number, float(end), place.past
            picked = [dr.select(this, new, old) for new, old in zip(own, picked)]
            left -= flux
        azimuth, leg, *rows, hemisphere, end, past = picked
        first = choices[0][0]  # both have the same polar angle
        place = Place(1, azimuth, leg, (*rows,), first.t, past, first.z_i, first.ends)
        point = self.lobes.drawn(place, hemisphere, end, sample2)
        return towards(point, phi_i, hemisphere == 0)
