"""What BSDFs have in common that reflect on their front side, in a glossy lobe."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

__all__ = ["GLOSSY", "above", "glossy_enabled", "glossy_sample"]

GLOSSY = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide


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
    bs.eta = 1.0
    bs.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
    bs.sampled_component = mi.UInt32(0)
    return bs
