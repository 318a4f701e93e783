"""Light of the first order that mirror facets send, known without rays.

Along each line of a collimated beam, down to the bottom, the facets that it enters from
outside send what they would if none were shadowed and no exit blocked. Over the full
footprint of a periodic cell the lines meet each facet in proportion to its area as seen
from the emitter, so that the mean of that is a sum over facets. What rays bring to the
patches less this, ray by ray, and the sum instead: a control variate (Owen 2013, *Monte
Carlo theory, methods and examples*, section 8.9), unbiased whatever the facets are said
to send, and without any scatter where light meets the surface once.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..mitsuba_names import FRAME, PARTIALS
from .exits import Exits
from .rays import with_normal
from .setup import Setup
from .surface_events import after_event, scattered


def has_mirror_facets(setup: Setup) -> bool:
    """Whether a sum over facets is the mean of what the beam's lines would send.

    For one mesh of flat mirror facets that are heights over a periodic cell, all of it
    in a collimated beam; and if the first order is collected, with all others. Facets
    of other meshes may coincide: both are in the sum, and a line meets one of them.
    """
    settings, specimen, beam = setup.settings, setup.specimen, setup.beam
    if not (settings.estimator.deposits and beam.fills_cell) or setup.orders:
        return False
    if mi.is_polarized or specimen.media or specimen.groups:
        return False
    if not settings.order.least <= 1 <= settings.order.most:
        return False
    mesh = specimen.surfaces[0]
    if not is_mirror(mesh.bsdf()) or not specimen.is_height_map:
        return False
    return not mesh.has_vertex_normals()


def is_mirror(bsdf: mi.BSDF) -> bool:
    """Whether a BSDF reflects in the mirror direction, and does nothing else."""
    flags = mi.BSDFFlags
    others = flags.Smooth, flags.Null, flags.Delta1D, flags.DeltaTransmission
    return mi.has_flag(bsdf.flags(), flags.DeltaReflection) and not any(
        mi.has_flag(bsdf.flags(), one) for one in others
    )


class MirrorFacets:
    """What each facet of a setup sends in the first order, if nothing is in the way.

    Attributes
    ----------
    patch : mi.UInt32
        To which each facet sends; `n_collected` if to none.
    light : mi.Spectrum
        What it makes of the power 1.
    flux : ndarray of float64, shape (n_collected, channels)
        Flux fractions of the patches, of all lines of the beam.
    face : int
        1 if the outer faces are those of the normals, -1 if the others: the ones that
        are seen from the emitter, on the whole.
    once : bool
        Whether each line enters one facet.
    """

    def __init__(self, setup: Setup, wavelengths: mi.Spectrum) -> None:
        (mesh,) = setup.specimen.surfaces
        n, wi = mesh.face_count(), setup.beam.wi
        number = dr.arange(mi.UInt32, n)
        corners = [mesh.vertex_position(one) for one in mesh.face_indices(number)]
        a, b, c = map(mi.Vector3d, corners)
        area = dr.dot(dr.cross(b - a, c - a), mi.Vector3d(wi)) / 2
        dr.eval(area)
        extent = setup.specimen.high - setup.specimen.low
        share = np.array(area) / (extent[0] * extent[1] * abs(float(wi.z[0])))
        # 1, or -1 for a surface from behind
        self.face = round(share.sum())
        share *= self.face
        self.once = share.min() > 0
        ray = mi.Ray3f(mi.Point3f(0), -wi)
        ray.wavelengths = wavelengths
        found = dr.zeros(mi.PreliminaryIntersection3f, n)
        found.valid, found.t = mi.Bool(True), mi.Float(1)
        found.prim_index, found.prim_uv = number, mi.Point2f(1 / 3)
        found.shape = mi.ShapePtr(mesh)
        si = with_normal(found.compute_surface_interaction(ray, PARTIALS | FRAME))
        entered = self.entered(si, ray.d)
        u1, u2 = mi.Float(0.5), mi.Point2f(0.5)
        bs, weight, wo = scattered(mesh.bsdf(), si, ray, u1, u2, entered)
        power = mi.UnpolarizedSpectrum(1.0)
        light, fate = after_event(power, weight, bs, wo, None)
        bins = setup.bins(Exits(si.p, wo, light, fate, power, mi.UInt32(1)))
        sends = entered & (bins < setup.n_patches)
        self.patch = dr.select(sends, bins, setup.n_collected)
        self.light = dr.select(sends, light, 0)
        dr.eval(self.patch, self.light)
        patch, powers = np.array(self.patch), np.array(self.light, dtype=float)
        self.flux: Floats = np.transpose(
            [
                np.bincount(patch, one, setup.n_collected + 1)[:-1]
                for one in powers.reshape(-1, n) * abs(share)
            ]
        )

    def entered(self, si: mi.SurfaceInteraction3f, d: mi.Vector3f) -> mi.Bool:
        """Whether a line of direction `d` enters a facet from its outer face."""
        return self.face * dr.dot(si.n, d) < 0
