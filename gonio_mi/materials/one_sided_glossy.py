"""What BSDFs have in common that reflect on their front side.

Such a plugin says how it draws a direction and what it scatters there; the functions
that Mitsuba calls are here, to be named in its class.
"""

from __future__ import annotations

from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from gonio_mi.materials.bsdf_functions import name_component

__all__ = [
    "GLOSSY",
    "above",
    "eval_pdf",
    "glossy_enabled",
    "glossy_sample",
    "sample",
]

GLOSSY = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide


class OneSided(Protocol):
    """What a plugin says itself."""

    def draw(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, u: mi.Point2f, on: Any
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Sample and weight for the point `u` of the unit square, where `on` is set."""

    def scattered(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, on: Any
    ) -> tuple[mi.Spectrum, mi.Float]:
        """BRDF times the cosine of `wo`, and its density in 1/sr, where `on` is set.

        Both of the enabled components, and of any value elsewhere.
        """


def sample(
    self: OneSided,
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    sample1: mi.Float,
    sample2: mi.Point2f,
    active: Any = True,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """Draw `wo` by `sample2` alone: two dimensions suit low-discrepancy points best."""
    del sample1
    return self.draw(ctx, si, sample2, active & (mi.Frame3f.cos_theta(si.wi) > 0))


def eval_pdf(
    self: OneSided,
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    wo: mi.Vector3f,
    active: Any = True,
) -> tuple[mi.Spectrum, mi.Float]:
    """BRDF times the cosine of `wo`, and the density of `wo` in 1/sr.

    Both 0 below the horizon: the density's integral is what stays above.
    """
    active = active & above(si.wi, wo)
    value, pdf = self.scattered(ctx, si, wo, active)
    return value & active, dr.select(active, pdf, 0)


def glossy_enabled(ctx: mi.BSDFContext, component: int = 0) -> bool:
    """Whether the context asks for the lobe."""
    return ctx.is_enabled(mi.BSDFFlags.GlossyReflection, component)


def above(wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Bool:
    """Whether both directions are above the horizon."""
    return (mi.Frame3f.cos_theta(wi) > 0) & (mi.Frame3f.cos_theta(wo) > 0)


def glossy_sample(wo: mi.Vector3f, pdf: mi.Float) -> mi.BSDFSample3f:
    """Sample of a BSDF whose only component is the lobe."""
    bs = dr.zeros(mi.BSDFSample3f)
    bs.wo = wo
    bs.pdf = pdf
    name_component(bs, mi.Bool(False), mi.BSDFFlags.GlossyReflection)
    return bs
