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

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Integers
from ..loops import syntax
from ..mitsuba_compat import FRAME, PARTIALS, has_normals, mesh_of, triangles_of
from ..specimen.rays import NEARBY, with_normal
from ..specimen.scene_objects import traversed
from ..specimen.specimen import Specimen
from ..transport.exits import Exits
from ..transport.setup import Setup
from ..transport.surface_events import after_event, scattered

# Number of none.
NO_FACET = 2**32 - 1

# How far past a facet's plane a line goes on, in units of the coordinates: 4 roundings.
PAST = 2.0**-22

# Rounding of a height, in units of what lines step back by at a side of a cell.
SINGLE = 2.0**-24 / NEARBY

# How often lines enter facets of the specimen itself, and how far from the origin it
# may lie, in half its extents: else of a copy, which takes time to build.
MAX_OFTEN, MAX_DISTANCE = 1.5, 4.0


def has_mirror_facets(setup: Setup) -> bool:
    """Whether the facet sum is exact for this beam.

    For one mesh of flat mirror facets that are heights over a periodic cell, all of it
    in a collimated beam; and if the first order is collected, with all others. Facets
    of other meshes may coincide: both are in the sum, and a line meets one of them.
    """
    settings, specimen, beam = setup.settings, setup.specimen, setup.beam
    if not beam.fills_cell or setup.orders:
        return False
    if mi.is_polarized or specimen.media or specimen.groups:
        return False
    if not settings.order.least <= 1 <= settings.order.most:
        return False
    mesh, flags = specimen.surfaces[0], mi.BSDFFlags
    others = flags.Smooth, flags.Null, flags.Delta1D, flags.DeltaTransmission
    lobes = mesh.bsdf().flags()
    if not mi.has_flag(lobes, flags.DeltaReflection):
        return False
    if any(mi.has_flag(lobes, one) for one in others) or not specimen.is_height_map:
        return False
    return not has_normals(mesh)


class MirrorFacets:
    """What each facet that lines enter sends in the first order, if nothing is there.

    Attributes
    ----------
    patch : mi.UInt32
        To which each facet sends; `n_collected` if to none.
    light : mi.Spectrum
        What it makes of the power 1.
    flux : ndarray of float64, shape (n_collected, channels)
        Flux fractions of the patches, of all lines of the beam.
    once : bool
        Whether each line enters one facet, so that all are seen from the emitter.
    """

    def __init__(self, setup: Setup, wavelengths: mi.Spectrum) -> None:
        (mesh,) = setup.specimen.surfaces
        wi, extent = setup.beam.wi, setup.specimen.high - setup.specimen.low
        every = dr.arange(mi.UInt32, mesh.face_count())
        corners = [mesh.vertex_position(one) for one in mesh.face_indices(every)]
        a, b, c = map(mi.Vector3d, corners)
        normal = dr.cross(b - a, c - a) / 2
        area, size = dr.dot(normal, mi.Vector3d(wi)), dr.norm(normal)
        dr.eval(area, size)
        share = np.array(area) / (extent[0] * extent[1] * abs(float(wi.z[0])))
        share *= round(share.sum())  # 1, or -1 for a surface from behind
        (entered,) = np.nonzero(share > 0)
        share, n = share[entered], len(entered)
        self.once = n == dr.width(every)
        number = mi.UInt32(entered)
        ray = mi.Ray3f(mi.Point3f(0), -wi)
        ray.wavelengths = wavelengths
        found = dr.zeros(mi.PreliminaryIntersection3f, n)
        found.valid, found.t = mi.Bool(True), mi.Float(1)
        found.prim_index, found.prim_uv = number, mi.Point2f(1 / 3)
        found.shape = mi.ShapePtr(mesh)
        si = with_normal(found.compute_surface_interaction(ray, PARTIALS | FRAME))
        u1, u2 = mi.Float(0.5), mi.Point2f(0.5)
        bs, weight, wo = scattered(mesh.bsdf(), si, ray, u1, u2, mi.Bool(True))
        power = mi.UnpolarizedSpectrum(1.0)
        light, fate = after_event(power, weight, bs, wo, None)
        bins = setup.bins(Exits(si.p, wo, light, fate, power, mi.UInt32(1)))
        sends = bins < setup.n_patches
        self.patch = dr.select(sends, bins, setup.n_collected)
        self.light = dr.select(sends, light, 0)
        dr.eval(self.patch, self.light)
        patch, powers = np.array(self.patch), np.array(self.light, dtype=float)
        self.flux: Floats = np.transpose(
            [
                np.bincount(patch, one, setup.n_collected + 1)[:-1]
                for one in powers.reshape(-1, n) * share
            ]
        )
        if not self.once:
            area, size = abs(np.array(area)), np.array(size)
            # a triangle whose corners coincide has no area
            cosine = np.divide(area, size, out=np.zeros_like(size), where=size > 0)
            self._scene_for(setup.specimen, entered, cosine, share.sum())

    def _scene_for(
        self, specimen: Specimen, entered: Integers, cosine: Floats, often: float
    ) -> None:
        """Scene in which lines enter facets as `often`, and what they are told by.

        Where that is often, or single precision coarse, it is one of the facets that
        are entered, about the middle of the cell. Beside those that lines leave they
        may pass a facet that begins within rounding.
        """
        (mesh,), middle = specimen.surfaces, (specimen.low + specimen.high) / 2
        half = (specimen.high - specimen.low) / 2
        near = specimen.reach < MAX_DISTANCE * half.max() and often < MAX_OFTEN
        self._scene, origin, unit = specimen.scene, np.zeros(3), specimen.reach
        number = np.full(len(cosine), NO_FACET, np.uint32)
        number[entered] = np.arange(len(entered), dtype=np.uint32)
        if not near:
            triangles: Any = triangles_of(traversed(mesh))
            points, faces = triangles
            props, origin, unit = mi.Properties(), middle, half.max()
            props["bsdf"] = mesh.bsdf()
            points = (points - middle).astype(np.float32)
            local = mesh_of(props, "entered", points, faces[entered])
            # not watertight: for that Embree makes triangles larger, while slits and
            # overlaps of rounding cancel
            self._scene = mi.load_dict({"type": "scene", "facets": local})
            number, cosine = number[entered], cosine[entered]
        self._number = mi.UInt32(number)
        self._beyond = mi.Float64(unit * PAST / np.maximum(cosine, PAST))
        self._origin, self._half = mi.Vector3d(origin), mi.Vector3d(half)
        self._middle, self._before = mi.Vector3d(middle), mi.Float64(unit * NEARBY)
        dr.make_opaque(self._origin, self._half, self._middle, self._before)

    @syntax
    def along(
        self, ray: mi.Ray3f, active: mi.Bool, take: Callable[[mi.UInt32, mi.Bool], None]
    ) -> None:
        """Call `take` with the numbers of the facets that lines enter, one by one.

        Lines start above all facets, inside of the cell, and go down to the bottom.
        Where they are is told in double precision by the distance from the start and
        whole numbers of cells, so that they remain straight: what they are moved by
        rounding does not add up, however many cells they cross. Into a cell they go at
        a height of single precision: at its side all would be rounded alike, by much of
        what a grazing line falls in a cell. What they enter at a side may seem to be in
        both cells.
        """
        o, d = mi.Point3d(ray.o) - self._middle, mi.Vector3d(ray.d)
        origin = self._middle - self._origin
        end = (dr.abs(o.z) + self._half.z) / dr.abs(d.z)
        before = self._before * (1 + SINGLE / dr.abs(d.z))
        t, past, cell = -before, mi.Float64(-dr.inf), mi.Vector3d(0)
        last, inside = mi.UInt32(NO_FACET), mi.Bool(False)
        active = mi.Bool(active)
        while active:
            z = o.z + t * d.z + origin.z
            t += dr.select(inside, 0.0, (mi.Float64(mi.Float(z)) - z) / d.z)
            here = mi.Ray3f(mi.Point3f(o + t * d - cell + origin), ray.d)
            found = self._scene.ray_intersect_preliminary(here, True, active)
            hit = active & found.is_valid()
            face = found.prim_index
            number = dr.gather(mi.UInt32, self._number, face, hit)
            # a line enters a facet once
            again = (face == last) | (t + found.t <= past)
            take(number, hit & ~again & (number != NO_FACET))
            last = dr.select(hit, face, mi.UInt32(NO_FACET))
            beyond = dr.gather(mi.Float64, self._beyond, face, hit)
            out, step = self._side(o - cell, d)
            past = dr.select(hit, t + found.t + beyond, past)
            t = dr.select(hit, past, out - before)
            inside = hit
            cell += dr.select(hit, 0.0, step)
            active &= hit | (out < end)

    def _side(self, o: mi.Point3d, d: mi.Vector3d) -> tuple[mi.Float64, mi.Vector3d]:
        """Where lines leave the cell by a side, and by how much the next one is off."""
        size = mi.Vector3d(self._half.x, self._half.y, 0)
        side = dr.copysign(size, d)
        t = dr.select(d == 0, dr.inf, (side - o) / d)
        by_x = t.x <= t.y
        step = 2 * side * dr.select(by_x, mi.Vector3d(1, 0, 0), mi.Vector3d(0, 1, 0))
        return dr.minimum(t.x, t.y), step
