"""Functions that our BSDF plugins share: those that Mitsuba calls, and reflectances.

They are no base class: that would belong to one variant, and Mitsuba's classes allow
for no second base. A plugin that reflects on its front side names in its class what is
here, and has two functions of its own: ``draw(asked, u)`` gives sample and weight for
the point `u` of the unit square; ``scattered(asked, wo)`` the BRDF times the cosine of
`wo`, and its density in 1/sr, both of the enabled components, and of any value where
nothing is asked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import SettingError, SettingTypeError


def _answer_of_eval_pdf(number: int, what: str) -> Callable[..., Any]:
    """Function of a BSDF that gives one of the two answers of its ``eval_pdf``."""

    def one_answer(
        self: Any,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        wo: mi.Vector3f,
        active: mi.Bool | bool = True,
    ) -> Any:
        return self.eval_pdf(ctx, si, wo, active)[number]

    one_answer.__doc__ = what
    return one_answer


evaluate = _answer_of_eval_pdf(
    0, "BSDF times the cosine of `wo`, of the enabled components."
)
density = _answer_of_eval_pdf(1, "Density of `wo` in 1/sr.")


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


def reflectance(props: mi.Properties, name: str, default: float) -> mi.Texture:
    """Return the texture property `name`, whose mean must lie in [0, 1]."""
    try:
        texture = props.get_texture(name, default)
    except RuntimeError:
        texture = None
    label = f"{props.plugin_name()}.{name}"
    if texture is None:
        raise SettingTypeError(
            f"{label} must be a number, a colour or a texture, got {props.get(name)!r}"
        )
    value = mean(texture)
    if not 0 <= value <= 1:
        raise SettingError(f"{label} must be a reflectance from 0 to 1, got {value:g}")
    return texture


def mean(texture: mi.Texture) -> float:
    """Mean of a texture over its surface and channels, as a float."""
    return float(np.mean(np.asarray(texture.mean())))


GLOSSY = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide


@dataclass(frozen=True)
class Asked:
    """What Mitsuba asks a BSDF about: the context, the point, and where `on` is set."""

    ctx: mi.BSDFContext
    si: mi.SurfaceInteraction3f
    on: mi.Bool


def sample(
    self: Any,
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    sample1: mi.Float,
    sample2: mi.Point2f,
    active: mi.Bool | bool = True,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """Draw `wo` by `sample2` alone: two dimensions suit low-discrepancy points best."""
    del sample1
    asked = Asked(ctx, si, active & (mi.Frame3f.cos_theta(si.wi) > 0))
    bs, weight = self.draw(asked, sample2)
    return bs, depolarised(weight)


def eval_pdf(
    self: Any,
    ctx: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    wo: mi.Vector3f,
    active: mi.Bool | bool = True,
) -> tuple[mi.Spectrum, mi.Float]:
    """BRDF times the cosine of `wo`, and the density of `wo` in 1/sr.

    Both 0 below the horizon: the density's integral is what stays above.
    """
    active = active & above(si.wi, wo)
    value, pdf = self.scattered(Asked(ctx, si, active), wo)
    return depolarised(value & active), dr.select(active, pdf, 0)


def depolarised(value: mi.Spectrum) -> mi.Spectrum:
    """Value of unpolarised light in polarised variants, where a number is a matrix."""
    if not mi.is_polarized or isinstance(value, mi.Spectrum):
        return value
    return mi.mueller.depolarizer(value)


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
