"""Functions that Mitsuba calls, for plugins to name in their classes.

They are no base class: that would belong to one variant, and Mitsuba's classes allow
for no second base.
"""

from __future__ import annotations

from collections.abc import Callable
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


def _part(number: int, what: str) -> Callable[..., Any]:
    """Function of a BSDF that gives one of the two answers of its ``eval_pdf``."""

    def part(
        self: Joint,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        wo: mi.Vector3f,
        active: Any = True,
    ) -> Any:
        return self.eval_pdf(ctx, si, wo, active)[number]

    part.__doc__ = what
    return part


evaluate = _part(0, "BSDF times the cosine of `wo`, of the enabled components.")
density = _part(1, "Density of `wo` in 1/sr.")


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
