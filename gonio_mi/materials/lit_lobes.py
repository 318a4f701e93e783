"""Lobes of a table: their values on patches, and points drawn of them, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from .disk import DiskPoint
from .lobes import LobeTable
from .table_reading import between, doubles, last, quantile, read, tilted

__all__ = ["LitLobes"]


class LitLobes:
    """Lobes as measured, one for each row: azimuth, polar angle and hemisphere.

    Points of the disk are in the frame of incidence, whose azimuth is that of the row.

    Parameters
    ----------
    table : LobeTable
    """

    def __init__(self, table: LobeTable) -> None:
        *_, self.n_theta, self.n_phi, self.n_channels = table.brdf.shape
        channels = range(self.n_channels)
        sin2 = np.sin(table.patches.theta_edges) ** 2
        self.sin2, self.phi = doubles([*sin2[:-1], 1]), doubles(table.patches.phi_edges)
        self.brdf = [doubles(table.brdf[..., channel]) for channel in channels]
        self.gradients = [
            [doubles(along[..., channel]) for channel in channels]
            for along in table.gradients
        ]
        self.means = self.brdf[0]
        self.mean_gradients = [along[0] for along in self.gradients]
        if self.n_channels > 1:
            self.means = doubles(table.brdf.mean(axis=-1))
            self.mean_gradients = [doubles(along.mean(-1)) for along in table.gradients]
        drawing = table.drawing
        self.tilts = doubles(drawing.tilts)
        self.sector_tilts = doubles(drawing.sector_tilts)
        self.rings, self.sectors = doubles(drawing.rings), doubles(drawing.sectors)

    def values(
        self, row: mi.UInt32, phi_i: mi.Float64, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF of each channel at a point, 0 where not active."""
        ring, sector, off = self._patch(phi_i, point)
        index = (row * self.n_theta + ring) * self.n_phi + sector
        values = []
        for channel, brdf in enumerate(self.brdf):
            value = read(brdf, index, active)
            for gradient, coordinate in zip(self.gradients, off):
                value += coordinate * read(gradient[channel], index, active)
            values.append(value)
        return values

    def _patch(
        self, phi_i: mi.Float64, point: DiskPoint
    ) -> tuple[mi.UInt32, mi.UInt32, Sequence[mi.Float64]]:
        """Ring and sector in which a point lies, and where, from -1/2 to 1/2."""
        across2 = 1 - dr.square(point.x)
        y = point.v * dr.safe_sqrt(across2)
        z2 = across2 * (1 - dr.square(point.v))
        # whichever of sine and cosine keeps its precision
        sin2 = dr.select(z2 < 0.5, 1 - z2, dr.square(point.x) + dr.square(y))
        ring = last(self.n_theta, lambda i: read(self.sin2, i) <= sin2)
        phi = dr.atan2(y, point.x) + phi_i
        phi -= 2 * dr.pi * dr.floor(phi * (0.5 / dr.pi))
        sector = last(self.n_phi, lambda i: read(self.phi, i) <= phi)
        off = []
        for edges, number, coordinate in (
            (self.sin2, ring, sin2),
            (self.phi, sector, phi),
        ):
            low, high = read(edges, number), read(edges, number + 1)
            off.append(dr.clip((coordinate - low) / (high - low), 0, 1) - 0.5)
        return ring, sector, off

    def drawn(
        self, row: mi.UInt32, phi_i: mi.Float64, sample2: mi.Point2f
    ) -> DiskPoint:
        """Point of a lobe."""
        ring, share = quantile(
            lambda i: read(self.rings, row * (self.n_theta + 1) + i),
            self.n_theta,
            mi.Float64(sample2.x),
        )
        own = row * self.n_theta + ring
        tilt = read(self.tilts, own)
        off = tilted(share, tilt) - 0.5
        first = own * (self.n_phi + 1)
        sector, share = quantile(
            lambda i: (
                read(self.sectors, first + i) + off * read(self.sector_tilts, first + i)
            ),
            self.n_phi,
            mi.Float64(sample2.y) * (1 + off * tilt),
        )
        patch = own * self.n_phi + sector
        along, around = (read(array, patch) for array in self.mean_gradients)
        mean = read(self.means, patch) + off * along
        past = tilted(share, dr.select(mean > 0, around / mean, 0))
        sin2 = between(self.sin2, ring, off + 0.5)
        phi = between(self.phi, sector, past) - phi_i
        sin, cos = dr.sincos(phi)
        sine = dr.sqrt(sin2)
        x, y = sine * cos, sine * sin
        across = dr.sqrt(1 - sin2 + y * y)
        return DiskPoint(x, dr.select(across > 0, y / across, 0))
