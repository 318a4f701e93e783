"""Verdicts on mistakes as others' plugins have them: the effect, and the true cause."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from plain_bsdf import changed

from gonio_mi.validation import validate


class Pane:
    """Functions of a smooth interface of index 1.5; `power` of eta in each mode."""

    powers = (0, 2)  # of importance and radiance

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [
            mi.BSDFFlags.DeltaReflection | both,
            mi.BSDFFlags.DeltaTransmission | both | mi.BSDFFlags.NonSymmetric,
        ]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def sample(self, ctx, si, sample1, sample2, active):  # noqa: ARG002
        f, cos_t, eta_it, eta_ti = mi.fresnel(mi.Frame3f.cos_theta(si.wi), 1.5)
        reflects = sample1 <= f
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = dr.select(reflects, mi.reflect(si.wi), mi.refract(si.wi, cos_t, eta_ti))
        bs.pdf = dr.select(reflects, f, 1 - f)
        bs.eta = dr.select(reflects, 1.0, eta_it)
        bs.sampled_component = dr.select(reflects, mi.UInt32(0), mi.UInt32(1))
        delta = mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission
        bs.sampled_type = dr.select(reflects, *(mi.UInt32(+flag) for flag in delta))
        power = self.powers[ctx.mode == mi.TransportMode.Radiance]
        return bs, mi.Spectrum(dr.select(reflects, 1.0, eta_ti**power)) & active

    def eval(self, ctx, si, wo, active):  # noqa: ARG002
        return mi.Spectrum(0.0)

    def pdf(self, ctx, si, wo, active):  # noqa: ARG002
        return mi.Float(0.0)

    def eval_pdf(self, ctx, si, wo, active):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self):
        return "Pane[]"


class Upwards:
    """Functions of a matte surface that lights up above, whatever side it is lit from.

    `everywhere` says whether ``eval`` says so, too.
    """

    everywhere = True

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [mi.BSDFFlags.DiffuseReflection | both]
        self.m_flags = self.m_components[0]

    def sample(self, ctx, si, sample1, sample2, active):  # noqa: ARG002
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf, bs.eta = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo), 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        return bs, mi.Spectrum(0.5) & active

    def eval(self, ctx, si, wo, active):  # noqa: ARG002
        lit = active & (self.everywhere | (si.wi.z > 0))
        return mi.Spectrum(0.5 * dr.inv_pi * dr.maximum(wo.z, 0)) & lit

    def pdf(self, ctx, si, wo, active):  # noqa: ARG002
        pdf = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        return dr.select(active & (wo.z > 0), pdf, 0)

    eval_pdf, to_string = Pane.eval_pdf, Pane.to_string


class Appended(Upwards):
    """A component is added to a copy of the list, and sampled."""

    def __init__(self, props):
        Upwards.__init__(self, props)
        self.m_components.append(mi.BSDFFlags.GlossyReflection)

    def sample(self, ctx, si, sample1, sample2, active):
        bs, weight = Upwards.sample(self, ctx, si, sample1, sample2, active)
        bs.sampled_component = mi.UInt32(1)
        return bs, weight


def verdict(base, **changes):
    return validate(changed(base, **changes), effort="quick")


@pytest.mark.parametrize(
    ("powers", "effect", "reached"),
    [
        ((0, 2), None, None),
        # right for light that is traced from its source
        ((0, 0), "biases images", "path and all that trace rays from the sensor"),
        # right for rays from a sensor
        ((2, 2), "breaks some integrators", "ptracer and all that trace light from"),
    ],
)
def test_the_mode_that_is_wrong_names_its_integrators(powers, effect, reached):
    found = verdict(Pane, powers=powers)["adjoint"]
    assert found.effect == effect
    if effect is not None:
        assert f"{effect} ({reached}" in found.consequence


@pytest.mark.parametrize("everywhere", [True, False])
def test_a_wrong_type_biases_only_where_eval_is_another(everywhere):
    """No integrator asks for the type of a smooth sample; the twin is lit by chance."""
    judged = verdict(Upwards, everywhere=everywhere)
    found = judged["directions"]
    assert found.status == "fails"
    assert "leaves on the other side" in found.mistake
    assert ("as `eval` has it" in found.mistake) == everywhere
    assert found.effect == (
        "interface only (no effect on images)" if everywhere else "biases images"
    )
    assert judged.passed == everywhere
    mistake = judged["reciprocity"].mistake
    assert ("lets light go one way only" in str(mistake)) == everywhere


class Fragile(Upwards):
    """Its table has no place for random numbers of 0."""

    def sample(self, ctx, si, sample1, sample2, active):
        if not np.array(sample2).all():
            raise ArithmeticError("no place in the table")
        return Upwards.sample(self, ctx, si, sample1, sample2, active)


def test_what_raises_at_an_end_only_is_judged_elsewhere():
    judged = verdict(Fragile)
    assert judged["ends"].status == "fails"
    assert "raised ArithmeticError: no place" in judged["ends"].mistake
    assert judged["sampling"].status == judged["answers"].status == "holds"


class Undefined(Upwards):
    """Its density is NaN in places."""

    def pdf(self, ctx, si, wo, active):
        pdf = Upwards.pdf(self, ctx, si, wo, active)
        return dr.select(wo.z > 0.9, dr.nan, pdf)


class Negative(Upwards):
    def eval(self, ctx, si, wo, active):
        return -Upwards.eval(self, ctx, si, wo, active)


@pytest.mark.parametrize(
    ("base", "mistake"),
    [
        (Undefined, "the value of `pdf` is nan in places"),
        (Negative, "the value of `eval` is -0.1"),
    ],
)
def test_values_that_are_none_are_told_first(base, mistake):
    """Integrals, symmetry and shares of the light go on without them."""
    judged = verdict(base)
    assert judged.mistake.startswith(mistake)
    assert judged.failures[0].name == "answers"
    shares = [one.share for one in judged.failures if one.share is not None]
    assert np.isfinite(shares).all()


def test_components_that_were_appended_are_told_how():
    found = verdict(Appended)["flags"]
    assert "component 1, of 1 that are declared" in found.statistic
    assert "m_components must be assigned, to append" in found.mistake
