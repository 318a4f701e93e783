"""Infinite plane-parallel layers, in which rays are followed by depth alone.

What stands in for geometry in the loop through media: where rays start, what surface
they meet next, and how they go on from there. :class:`Layers` finds it without any
intersection; :class:`~.media_loop.Geometry` traces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..mitsuba_compat import SURFACE
from ..specimen.plane import Plane
from ..specimen.rays import Encounter

# How much of the cell a rectangle that covers it may seem to lack, by rounding.
MAX_GAP = 2.0**-18

# Cosine instead of 0, for a ray that is level.
MIN_COSINE = 2.0**-60

# Wavelengths at which it is looked at whether a BSDF is the same all over.
TEST_WAVELENGTHS = 400.0, 500.0, 600.0, 700.0


@dataclass
class LayerFlight:
    """Rays on their way: variables of a loop, which :class:`Layers` changes in place.

    Attributes
    ----------
    ray : mi.Ray3f
    shift : mi.Vector3f
        0: there are no cells.
    layer : mi.UInt32
        Interfaces above.
    """

    ray: Any
    shift: Any
    layer: Any


class Layers:
    """Interfaces from above to below, of which each is a plane without an end.

    Parameters
    ----------
    scene : mi.Scene
    sis : sequence of mi.SurfaceInteraction3f
        Of one point of each of its shapes, from above to below.
    side : int
        Of the emitter: 1 above, -1 below.
    """

    def __init__(
        self, scene: mi.Scene, sis: Sequence[mi.SurfaceInteraction3f], side: int
    ) -> None:
        self.n = len(sis)
        self.first = 0 if side > 0 else self.n
        shapes = scene.shapes()
        numbers = [
            next(i for i, s in enumerate(shapes) if s is si.shape[0]) for si in sis
        ]
        self.z = mi.Float([float(si.p.z[0]) for si in sis])
        self.shapes = dr.gather(mi.ShapePtr, scene.shapes_dr(), mi.UInt32(numbers))
        frames = [si.sh_frame for si in sis]
        axes = [[f.s for f in frames], [f.t for f in frames], [f.n for f in frames]]
        self.frames = [
            mi.Vector3f(np.concatenate([np.array(v) for v in axis], axis=1))
            for axis in axes
        ]
        dr.make_opaque(self.z, self.shapes, self.frames)

    def start(self, ray: mi.Ray3f) -> LayerFlight:
        """Flight of new rays, on the emitter's side of all layers."""
        return LayerFlight(mi.Ray3f(ray), mi.Vector3f(0), mi.UInt32(self.first))

    def meet(
        self, flight: LayerFlight, active: mi.Bool, inside: mi.Bool
    ) -> tuple[mi.SurfaceInteraction3f, Encounter, mi.Float]:
        """What rays meet next, and at what distance; nothing is infinitely far."""
        del inside
        ray = flight.ray
        up = ray.d.z > 0
        found = active & (ray.d.z != 0)
        found &= dr.select(up, flight.layer > 0, flight.layer < self.n)
        number = dr.select(found, flight.layer - dr.select(up, mi.UInt32(1), 0), 0)
        z = dr.gather(mi.Float, self.z, number)
        distance = dr.select(found, dr.maximum((z - ray.o.z) / ray.d.z, 0), dr.inf)
        s, t, n = (dr.gather(mi.Vector3f, axis, number) for axis in self.frames)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t = distance
        si.p = ray(dr.select(found, distance, 0.0))
        si.p.z = z
        si.uv = mi.Point2f(0.5)
        si.n = mi.Normal3f(n)
        si.sh_frame = mi.Frame3f(s, t, n)
        si.dp_du, si.dp_dv = s, t
        si.shape = dr.gather(mi.ShapePtr, self.shapes, number)
        si.wavelengths = ray.wavelengths
        si.wi = si.to_local(-ray.d)
        nothing = mi.Bool(False)
        missed = active & ~found
        p, step = mi.Point3f(0), mi.Vector3f(0)
        met = Encounter(missed, nothing, nothing, nothing, found, nothing, p, step)
        return si, met, distance

    def proceed(
        self,
        flight: LayerFlight,
        si: mi.SurfaceInteraction3f,
        met: Encounter,
        scattered: mi.Bool,
        wo: mi.Vector3f,
    ) -> None:
        """Start the next rays of those that a surface scattered."""
        del met
        ray = flight.ray
        number = flight.layer - dr.select(ray.d.z < 0, mi.UInt32(0), 1)
        flight.layer[scattered] = number + dr.select(wo.z > 0, mi.UInt32(0), 1)
        ray.o[scattered] = si.p
        ray.d[scattered] = _not_level(wo)

    def place(
        self,
        flight: LayerFlight,
        si: mi.SurfaceInteraction3f,
        t: mi.Float,
        distance: mi.Float,
        active: mi.Bool,
        wo: mi.Vector3f,
    ) -> None:
        """Start the next rays of those that go on from inside of a layer, after `t`."""
        del si, distance
        ray = flight.ray
        p = ray(dr.select(active, t, 0.0))
        # not beyond the layer, by rounding
        above = dr.clip(mi.Int32(flight.layer) - 1, 0, self.n - 1)
        below = dr.clip(mi.Int32(flight.layer), 0, self.n - 1)
        high, low = (dr.gather(mi.Float, self.z, mi.UInt32(i)) for i in (above, below))
        p.z = dr.clip(p.z, low, high)
        ray.o[active] = p
        ray.d[active] = _not_level(wo)


def layers_of(specimen: Any, side: int) -> Layers | None:
    """:class:`Layers` of a specimen that is nothing else, and else None.

    Horizontal rectangles that fill a periodic cell, each at a height of its own and the
    same all over, with homogeneous media between them.
    """
    surfaces = specimen.surfaces
    if not (specimen.media and specimen.periodic) or specimen.groups:
        return None
    if any(shape.class_name() != "Rectangle" for shape in surfaces):
        return None
    boxes = [(shape.bbox().min.z, shape.bbox().max.z) for shape in surfaces]
    thin = specimen.reach * MAX_GAP
    heights = sorted(low + high for low, high in boxes)
    flat = all(high - low <= thin for low, high in boxes)
    if not flat or np.any(np.diff(heights) <= 2 * thin):
        return None
    if not all(map(_is_uniform, specimen.media)):
        return None
    nm = mi.UnpolarizedSpectrum(*TEST_WAVELENGTHS) if mi.is_spectral else mi.Color0f()
    cell = np.prod((specimen.high - specimen.low)[:2])
    sis = []
    for shape in sorted(surfaces, key=lambda shape: -shape.bbox().min.z):
        si = _interaction(shape)
        area = dr.norm(dr.cross(si.dp_du, si.dp_dv))[0]
        if area < cell * (1 - MAX_GAP) or not Plane(shape.bsdf(), si).is_uniform(nm):
            return None
        sis.append(si)
    return Layers(specimen.scene, sis, side)


def _not_level(d: mi.Vector3f) -> mi.Vector3f:
    """Directions that get to an interface, however far away."""
    return mi.Vector3f(d.x, d.y, dr.select(d.z == 0, MIN_COSINE, d.z))


def _interaction(shape: mi.Shape) -> mi.SurfaceInteraction3f:
    """Interaction with a rectangle at its middle, its frame turned into the plane."""
    si = shape.eval_parameterization(mi.Point2f(0.5), SURFACE)
    frame = si.sh_frame
    flat = mi.Vector3f(1, 1, 0)
    si.n = mi.Normal3f(0, 0, dr.sign(frame.n.z))
    si.sh_frame = mi.Frame3f(
        dr.normalize(frame.s * flat), dr.normalize(frame.t * flat), si.n
    )
    dr.make_opaque(si)
    return si


def _is_uniform(medium: mi.Medium) -> bool:
    """Whether a medium is the same everywhere, for all that it declares."""
    volumes = [p for p in mi.traverse(medium).hierarchy if isinstance(p, mi.Volume)]
    constant = all(volume.class_name() == "ConstVolume" for volume in volumes)
    return medium.is_homogeneous() and constant
