"""Looking up and sampling the lobes of one face of a specimen, in Dr.Jit."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from .disk import DiskPoint, above, on_disk, seen_from, towards, turned
from .half_vectors import goes, reflected
from .lobes import LobeTable

__all__ = ["LitFace"]


@dataclass(frozen=True)
class _Place:
    """Where to look in the table: one measured azimuth, and for each lane a leg."""

    weight: mi.Float64  # share of this azimuth
    azimuth: mi.UInt32  # its index
    leg: mi.UInt32  # index among the legs of all azimuths
    rows: tuple[mi.UInt32, ...]  # of azimuth and polar angle at both ends of the leg
    t: mi.Float64  # how far on the leg, from 0 to 1
    past: mi.Float64  # angle from this azimuth to that of incidence
    z_i: mi.Float64  # cosine of the angle of incidence

    def lights(self) -> tuple[list[Any], list[Any]]:
        """Where light came from at this azimuth, and comes from, which is +x."""
        here = [dr.safe_sqrt(1 - dr.square(self.z_i)), mi.Float64(0), self.z_i]
        return turned(here, -self.past), here


class LitFace:
    """Lobe table as Dr.Jit arrays; double precision keeps pole and horizon.

    Directions are seen from this face: light comes from z > 0.

    Parameters
    ----------
    table : LobeTable
    wavelengths : sequence of float, optional
        Of the table's channels in nm, for spectral variants.
    """

    def __init__(self, table: LobeTable, wavelengths: Floats | None = None) -> None:
        self.wavelengths = wavelengths
        n_azimuths, n_angles, self.n_hemispheres, self.n_theta, self.n_phi, channels = (
            table.brdf.shape
        )
        self.n_azimuths, self.n_angles = n_azimuths, n_angles
        self.reflects = table.grid.reflects
        self.n_legs, self.n_strips = table.strips.shape[2], table.strips.shape[-1]
        sin2 = np.sin(table.theta_edges) ** 2
        self.arrays = SimpleNamespace(
            sin_i=_doubles(np.sin(np.radians(table.grid.theta_i))),
            phi_i=_doubles(np.radians(table.grid.phi_i)),
            sin2=_doubles([*sin2[:-1], 1]),
            phi=_doubles(table.phi_edges),
            flux=_doubles(table.flux.mean(axis=-1)),
            brdf=[_doubles(table.brdf[..., channel]) for channel in range(channels)],
            gradients=[
                [_doubles(along[..., channel]) for channel in range(channels)]
                for along in table.gradients
            ],
            means=_doubles(table.brdf.mean(axis=-1)),
            mean_gradients=[_doubles(along.mean(-1)) for along in table.gradients],
            tilts=_doubles(table.tilts),
            sector_tilts=_doubles(table.sector_tilts),
            rings=_doubles(table.rings),
            sectors=_doubles(table.sectors),
            strips=[_doubles(end) for end in table.strips],
            strip_slopes=[_doubles(end) for end in table.strip_slopes],
            cells=[_doubles(end) for end in table.cells],
            cell_slopes=[_doubles(end) for end in table.cell_slopes],
        )

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
                share = dr.clip((wavelengths - begin) / (end - begin), 0, 1)
                spectrum += share * (values[high] - values[low])
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
        phi_i = self._azimuth_of_incidence(wi)
        point = seen_from(wo, phi_i)
        value = [mi.Float64(0) for _ in self.arrays.brdf]
        total = mi.Float64(0)
        for place in self._places(wi, phi_i):
            for number in self._hemispheres(enabled):
                total += sum(self._fluxes(place, number))
            brdf = self._brdf(place, hemisphere, point, wanted)
            for channel, own in enumerate(brdf):
                value[channel] += place.weight * own
        return value, total, wanted

    def _brdf(
        self, place: _Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF of one azimuth: both ends of the leg, moved to where `wi` wants them."""
        sources: list[tuple[DiskPoint, Any, mi.Bool]] = [(point, 1.0, active)]
        if self.reflects:
            sources = self._sources(place, hemisphere, point, active)
        values = [mi.Float64(0) for _ in self.arrays.brdf]
        for source, stretch, wanted in sources:
            own = self._of_azimuth(place, hemisphere, source, wanted)
            for channel, value in enumerate(own):
                values[channel] += stretch * value
        return values

    def _of_azimuth(
        self, place: _Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF at the azimuth of the place itself."""
        values = [mi.Float64(0) for _ in self.arrays.brdf]
        for end, row in enumerate(place.rows):
            source, stretch = point, 1.0
            if self.n_angles > 1:
                source, stretch = self._moved(place, hemisphere, point, place.t, end)
            ring, sector, off = self._patch(place, source)
            row = row * self.n_hemispheres + hemisphere
            index = (row * self.n_theta + ring) * self.n_phi + sector
            share = stretch * (place.t if end else 1 - place.t)
            for channel, brdf in enumerate(self.arrays.brdf):
                value = _read(brdf, index, active)
                for gradient, coordinate in zip(self.arrays.gradients, off):
                    value += coordinate * _read(gradient[channel], index, active)
                values[channel] += share * value
        return values

    def _patch(
        self, place: _Place, point: DiskPoint
    ) -> tuple[mi.UInt32, mi.UInt32, list[mi.Float64]]:
        """Ring and sector in which a point lies, and where, from -1/2 to 1/2."""
        arrays = self.arrays
        across2 = 1 - dr.square(point.x)
        y = point.v * dr.safe_sqrt(across2)
        z2 = across2 * (1 - dr.square(point.v))
        # whichever of sine and cosine keeps its precision
        sin2 = dr.select(z2 < 0.5, 1 - z2, dr.square(point.x) + dr.square(y))
        ring = _last(self.n_theta, lambda i: _read(arrays.sin2, i) <= sin2)
        phi = dr.atan2(y, point.x) + _read(arrays.phi_i, place.azimuth)
        phi -= 2 * dr.pi * dr.floor(phi * (0.5 / dr.pi))
        sector = _last(self.n_phi, lambda i: _read(arrays.phi, i) <= phi)
        off = []
        for edges, number, coordinate in (
            (arrays.sin2, ring, sin2),
            (arrays.phi, sector, phi),
        ):
            low, high = _read(edges, number), _read(edges, number + 1)
            off.append(dr.clip((coordinate - low) / (high - low), 0, 1) - 0.5)
        return ring, sector, off

    def _fluxes(self, place: _Place, hemisphere: int) -> tuple[mi.Float64, mi.Float64]:
        """Light that both ends of the leg contribute to a hemisphere."""
        rows = [row * self.n_hemispheres + hemisphere for row in place.rows]
        low, high = (_read(self.arrays.flux, row) for row in rows)
        return place.weight * (1 - place.t) * low, place.weight * place.t * high

    # -------------------------------------------------------------- incident direction

    def _azimuth_of_incidence(self, wi: mi.Vector3f) -> mi.Float64:
        """Azimuth of `wi`; along the normal, where all meet, the record's first one."""
        normal = (wi.x == 0) & (wi.y == 0)
        first = _read(self.arrays.phi_i, mi.UInt32(0))
        return dr.select(normal, first, mi.Float64(dr.atan2(wi.y, wi.x)))

    def _places(self, wi: mi.Vector3f, phi: mi.Float64) -> list[_Place]:
        """Return the one or two measured azimuths to mix for `wi`."""
        arrays = self.arrays
        leg, t = mi.UInt32(0), mi.Float64(0)
        if self.n_angles > 1:
            x, y = mi.Float64(wi.x), mi.Float64(wi.y)
            sine = dr.sqrt(x * x + y * y)
            leg = _last(self.n_legs, lambda i: _read(arrays.sin_i, i) <= sine)
            low, high = _read(arrays.sin_i, leg), _read(arrays.sin_i, leg + 1)
            t = dr.clip((sine - low) / (high - low), 0, 1)
        z_i = mi.Float64(wi.z) * dr.rsqrt(mi.Float64(dr.squared_norm(wi)))
        place = partial(self._place, leg, t, z_i)
        if self.n_azimuths == 1:
            return [place(mi.Float64(1), mi.UInt32(0), mi.Float64(0))]
        turn = 2 * dr.pi
        phi -= turn * dr.floor(phi / turn)
        last = mi.UInt32(self.n_azimuths - 1)
        low = _last(self.n_azimuths, lambda i: _read(arrays.phi_i, i) <= phi)
        # before the first azimuth is after the last one
        low = dr.select(phi < _read(arrays.phi_i, mi.UInt32(0)), last, low)
        high = dr.select(low == last, 0, low + 1)
        past = phi - _read(arrays.phi_i, low)
        gap = _read(arrays.phi_i, high) - _read(arrays.phi_i, low)
        past = dr.select(past < 0, past + turn, past)
        gap = dr.select(gap <= 0, gap + turn, gap)
        share = past / gap
        return [place(1 - share, low, past), place(share, high, past - gap)]

    def _place(
        self,
        leg: mi.UInt32,
        t: mi.Float64,
        z_i: mi.Float64,
        weight: mi.Float64,
        azimuth: mi.UInt32,
        past: mi.Float64,
    ) -> _Place:
        first = azimuth * self.n_angles
        rows = first + leg, first + dr.minimum(leg + 1, self.n_angles - 1)
        leg = azimuth * self.n_legs + leg
        return _Place(weight, azimuth, leg, rows, t, past, z_i)

    # ------------------------------------------------------------------- between angles

    def _moved(
        self,
        place: _Place,
        hemisphere: mi.UInt32,
        point: DiskPoint,
        start: mi.Float64,
        to: mi.Float64,
    ) -> tuple[DiskPoint, mi.Float64]:
        """Where a point at `start` of the leg is at `to`, and the stretch of areas."""
        arrays = self.arrays
        number = place.leg * self.n_hemispheres + hemisphere
        x, number, stretch_x = self._moved_along(
            (arrays.strips, arrays.strip_slopes), number, point.x, start, to
        )
        v, _, stretch_v = self._moved_along(
            (arrays.cells, arrays.cell_slopes), number, point.v, start, to
        )
        x, v = dr.clip(x, -1, 1), dr.clip(v, -1, 1)
        # of y / v, at the new point and at the old one
        across = dr.safe_sqrt(
            (1 - x * x) / dr.maximum(1 - dr.square(point.x), 2.0**-60)
        )
        return DiskPoint(x, v), stretch_x * stretch_v * across

    def _moved_along(
        self,
        pieces: tuple[list[mi.Float64], list[mi.Float64]],
        number: mi.UInt32,
        coordinate: mi.Float64,
        start: mi.Float64,
        to: mi.Float64,
    ) -> tuple[mi.Float64, mi.UInt32, mi.Float64]:
        """The same for one coordinate; also the number of the piece."""
        begins, slopes = pieces
        first = number * self.n_strips

        def at(
            ends: Sequence[mi.Float64], index: mi.UInt32, t: mi.Float64
        ) -> mi.Float64:
            low, high = (_read(end, index) for end in ends)
            return (1 - t) * low + t * high

        piece = _last(
            self.n_strips, lambda i: at(begins, first + i, start) <= coordinate
        )
        index = first + piece
        slope, new_slope = at(slopes, index, start), at(slopes, index, to)
        share = (coordinate - at(begins, index, start)) / slope
        return at(begins, index, to) + share * new_slope, index, new_slope / slope

    # ----------------------------------------------------------------- between azimuths

    def _sources(
        self, place: _Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[tuple[DiskPoint, Any, mi.Bool]]:
        """Where the light at a point is in the lobe of a measured azimuth.

        What micro-normals send there, with the stretch of areas, and what stays.
        """
        wo, (own, here) = above(point), place.lights()
        came, scale = reflected(wo, here, own)
        comes = active & (hemisphere == 0) & goes(came[2], wo[2])
        stretch = dr.select(comes, came[2] * scale / wo[2], 0)
        _, leaves = self._reflected(place, hemisphere, point)
        source = on_disk(turned(came, place.past))
        return [(source, stretch, comes), (point, 1.0, active & ~leaves)]

    def _reflected(
        self, place: _Place, hemisphere: mi.UInt32, point: DiskPoint
    ) -> tuple[DiskPoint, mi.Bool]:
        """Where micro-normals send light of a measured azimuth to, and whether."""
        wo, (own, here) = turned(above(point), -place.past), place.lights()
        to, _ = reflected(wo, own, here)
        leaves = (hemisphere == 0) & goes(wo[2], to[2])
        moved = on_disk(to)
        return DiskPoint(
            dr.select(leaves, moved.x, point.x), dr.select(leaves, moved.v, point.v)
        ), leaves

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
        list of (row, share, wo)
            For each of the records that make the lobe at `wi`: its number among those
            of all azimuths and polar angles; its share, which add up to 1; and where
            the point is moved.
        """
        phi_i = self._azimuth_of_incidence(wi)
        number, up = mi.UInt32(hemisphere), mi.Bool(hemisphere == 0)
        parts = []
        for place in self._places(wi, phi_i):
            own = _read(self.arrays.phi_i, place.azimuth)
            height = dr.safe_sqrt(1 - dr.squared_norm(point))
            start = seen_from(mi.Vector3f(point.x, point.y, height), own)
            for end, row in enumerate(place.rows):
                moved = start
                if self.n_angles > 1:
                    at = mi.Float64(end)
                    moved, _ = self._moved(place, number, start, at, place.t)
                if self.reflects:
                    moved, _ = self._reflected(place, number, moved)
                share = place.weight * (place.t if end else 1 - place.t)
                parts.append((row, share, towards(moved, phi_i, up)))
        return parts

    # ------------------------------------------------------------------------- sampling

    def sample(
        self,
        wi: mi.Vector3f,
        enabled: tuple[bool, bool],
        sample1: mi.Float,
        sample2: mi.Point2f,
    ) -> mi.Vector3f:
        """Direction of light: of a lobe picked by `sample1`, moved to its place."""
        phi_i = self._azimuth_of_incidence(wi)
        choices = [
            (place, end, number, flux)
            for place in self._places(wi, phi_i)
            for number in self._hemispheres(enabled)
            for end, flux in enumerate(self._fluxes(place, number))
        ]
        if not choices:
            return mi.Vector3f(0)
        left = mi.Float64(sample1) * sum(flux for *_, flux in choices)
        picked = [mi.UInt32(0)] * 4 + [mi.Float64(0)] * 2
        for place, end, number, flux in choices:
            # one without light is never picked, however `left` is rounded
            this = (left >= 0) & (flux > 0)
            row, at = place.rows[end], float(end)
            own = place.azimuth, place.leg, row, number, at, place.past
            picked = [dr.select(this, new, old) for new, old in zip(own, picked)]
            left -= flux
        azimuth, leg, row, hemisphere, end, past = picked
        first = choices[0][0]
        place = _Place(1, azimuth, leg, (row, row), first.t, past, first.z_i)
        point = self._drawn(place, hemisphere, sample2)
        if self.n_angles > 1:
            point, _ = self._moved(place, hemisphere, point, end, place.t)
        if self.reflects:
            point, _ = self._reflected(place, hemisphere, point)
        return towards(point, phi_i, hemisphere == 0)

    def _drawn(
        self, place: _Place, hemisphere: mi.UInt32, sample2: mi.Point2f
    ) -> DiskPoint:
        """Point of a record's lobe."""
        arrays = self.arrays
        row = place.rows[0] * self.n_hemispheres + hemisphere
        ring, share = _quantile(
            lambda i: _read(arrays.rings, row * (self.n_theta + 1) + i),
            self.n_theta,
            mi.Float64(sample2.x),
        )
        own = row * self.n_theta + ring
        tilt = _read(arrays.tilts, own)
        off = _tilted(share, tilt) - 0.5
        first = own * (self.n_phi + 1)
        sector, share = _quantile(
            lambda i: (
                _read(arrays.sectors, first + i)
                + off * _read(arrays.sector_tilts, first + i)
            ),
            self.n_phi,
            mi.Float64(sample2.y) * (1 + off * tilt),
        )
        patch = own * self.n_phi + sector
        along, around = (_read(array, patch) for array in arrays.mean_gradients)
        mean = _read(arrays.means, patch) + off * along
        past = _tilted(share, dr.select(mean > 0, around / mean, 0))
        sin2 = _between(arrays.sin2, ring, off + 0.5)
        phi = _between(arrays.phi, sector, past)
        phi -= _read(arrays.phi_i, place.azimuth)
        sin, cos = dr.sincos(phi)
        sine = dr.sqrt(sin2)
        x, y = sine * cos, sine * sin
        across = dr.sqrt(1 - sin2 + y * y)
        return DiskPoint(x, dr.select(across > 0, y / across, 0))

    def _hemispheres(self, enabled: tuple[bool, bool]) -> list[int]:
        return [n for n in range(self.n_hemispheres) if enabled[n]]


def _quantile(
    shares: Callable[[mi.UInt32], mi.Float64], n: int, share: mi.Float64
) -> tuple[mi.UInt32, mi.Float64]:
    """Bin up to which `share` of the light is, and the part of it in the bin.

    `shares` gives what is below each of the ``n + 1`` edges.
    """
    number = _last(n, lambda i: shares(i) <= share)
    low, high = shares(number), shares(number + 1)
    inside = dr.select(high > low, (share - low) / (high - low), 0.5)
    return number, dr.clip(inside, 0, 1)


def _tilted(share: mi.Float64, tilt: mi.Float64) -> mi.Float64:
    """Coordinate below which `share` of a density is that is linear from 0 to 1.

    It changes by `tilt`, within 2, and is 1 in the middle.
    """
    tilt = dr.clip(tilt, -2, 2)
    start = 1 - tilt / 2
    root = start + dr.safe_sqrt(start * start + 2 * tilt * share)
    return dr.select(root > 0, dr.clip(2 * share / root, 0, 1), share)


def _between(edges: mi.Float64, number: mi.UInt32, part: mi.Float64) -> mi.Float64:
    """Coordinate of the part of a bin."""
    low, high = _read(edges, number), _read(edges, number + 1)
    return low + part * (high - low)


def _last(n: int, begins: Callable[[mi.UInt32], mi.Bool]) -> mi.UInt32:
    """Last of `n` ascending pieces that `begins`; the first always does."""
    if n == 1:
        return mi.UInt32(0)
    return mi.UInt32(dr.binary_search(1, n, begins)) - 1


def _read(array: mi.Float64, index: mi.UInt32, active: mi.Bool = True) -> mi.Float64:
    return dr.gather(mi.Float64, array, mi.UInt32(index), active)


def _doubles(values: ArrayLike) -> mi.Float64:
    return mi.Float64(np.ascontiguousarray(values, dtype=np.float64).ravel())
