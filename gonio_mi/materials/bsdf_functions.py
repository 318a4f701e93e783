"""Functions that Mitsuba calls, for plugins to name in their classes.

They are no base class: that would belong to one variant, and Mitsuba's classes allow
for no second base.
"""

from __future__ import annotations

from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

__all__ = ["density", "evaluate", "name_component"]


class Joint(Protocol):
    """BSDF with an ``eval_pdf``."""

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, on: Any
    ) -> tuple[mi.Spectrum, mi.Float]:
        """BRDF times the cosine of `wo`, and its density."""


def evaluate(
    self: Joint,
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    wo: mi.Vector3f,
    active: Any = True,
) -> mi.Spectrum:
    """BSDF times the cosine of `wo`, of the enabled components."""
    return self.eval_pdf(ctx, si, wo, active)[0]


def density(
    self: Joint,
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    wo: mi.Vector3f,
    active: Any = True,
) -> mi.Float:
    """Density of `wo` in 1/sr."""
    return self.eval_pdf(ctx, si, wo, active)[1]


def name_component(
    bs: mi.BSDFSample3f,
    second: mi.Bool,
    kind: mi.BSDFFlags,
    kind_of_second: mi.BSDFFlags = mi.BSDFFlags.Empty,
) -> None:
    """Say of samples which of two components they are of, without refraction."""
    bs.eta = 1.0
    bs.sampled_type = dr.select(second, mi.UInt32(+kind_of_second), mi.UInt32(+kind))
    bs.sampled_component = dr.select(second, mi.UInt32(1), mi.UInt32(0))
