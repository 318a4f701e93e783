"""A single flat rectangle in z = const, which needs no ray tracing."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..single_precision import FEW_ROUNDINGS
from .scene_objects import traversed

# Points at which a BSDF is compared with itself.
N_POINTS = 2**12


@dataclass(frozen=True)
class Plane:
    """A single flat rectangle in z = const, the specimen that needs no ray tracing.

    A point is ``centre + (u - 1/2) dp_du + (v - 1/2) dp_dv``. Plugins that look into
    their arguments, with NumPy or with a neural network, need what all rays share, such
    as the direction of incidence, once for each ray: `by_ray`.
    """

    bsdf: mi.BSDF
    interaction: mi.SurfaceInteraction3f  # at the centre
    by_ray: bool = False

    def interactions(
        self, uv: mi.Point2f, wi: mi.Vector3f, wavelengths: mi.Spectrum
    ) -> mi.SurfaceInteraction3f:
        """Surface interactions at `uv`, for light from the world direction `wi`."""
        centre = self.interaction
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t = 1.0
        si.p = centre.p + (uv.x - 0.5) * centre.dp_du + (uv.y - 0.5) * centre.dp_dv
        si.uv = uv
        si.n = centre.n
        si.sh_frame = mi.Frame3f(centre.sh_frame)
        si.dp_du, si.dp_dv = centre.dp_du, centre.dp_dv
        si.wavelengths = wavelengths
        si.wi = si.to_local(wi)
        return si

    def is_uniform(self, wavelengths: mi.Spectrum) -> bool:
        """Whether no declared texture varies, nor the BSDF at many random points.

        Flags do not tell, and not every plugin declares its textures; but a small
        detail of one is seen there only.
        """
        parts = traversed(self.bsdf).hierarchy
        if any(isinstance(part, mi.Texture) and _varies(part) for part in parts):
            return False
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, N_POINTS)
        wi, wo = (mi.warp.square_to_uniform_sphere(sampler.next_2d()) for _ in "io")

        def values(uv: mi.Point2f) -> mi.Spectrum:
            """``eval`` at places, for the same pairs of directions."""
            si = self.interactions(uv, wi, wavelengths)
            wo_local, every = si.to_local(wo), mi.Bool(True)
            si = repeated(si, N_POINTS) if self.by_ray else si
            return mi.Spectrum(self.bsdf.eval(mi.BSDFContext(), si, wo_local, every))

        a, b = values(mi.Point2f(0.5)), values(sampler.next_2d())
        alike = dr.abs(b - a) <= dr.abs(a) * FEW_ROUNDINGS
        # what is no number at both is refused where it is integrated
        return bool(dr.all(alike | ~(dr.isfinite(a) | dr.isfinite(b)), axis=None))

    def uv(self, p: mi.Point3f) -> mi.Point2f:
        """Texture coordinates of points of the plane; the specimen ends at 0 and 1."""
        centre = self.interaction
        offset = p - centre.p
        # of a sheared rectangle, both are not perpendicular (Cramer's rule)
        du, dv = centre.dp_du, centre.dp_dv
        area = _cross(du, dv)
        return mi.Point2f(_cross(offset, dv), _cross(du, offset)) / area + 0.5


def repeated(si: mi.SurfaceInteraction3f, n: int) -> mi.SurfaceInteraction3f:
    """Interactions of `n` rays that share nothing any more: each has its own copy.

    The values keep their bits.
    """
    for name in ["wi", "uv", "p"] + ["wavelengths"] * mi.is_spectral:
        value = getattr(si, name)
        if dr.width(value) < n:
            value = dr.gather(type(value), value, dr.zeros(mi.UInt32, n))
            setattr(si, name, value)
    return si


def _cross(a: mi.Vector3f, b: mi.Vector3f) -> mi.Float:
    """Signed area of the parallelogram of two horizontal vectors."""
    return a.x * b.y - a.y * b.x


def _varies(texture: mi.Texture) -> bool:
    """Whether a texture says that it varies, and a bitmap's texels are not all one."""
    if not texture.is_spatially_varying():
        return False
    if not texture.class_name().startswith("BitmapTexture"):
        return True
    texels = np.array(traversed(texture)["data"])
    return bool(np.any(texels != texels[:1, :1]))
