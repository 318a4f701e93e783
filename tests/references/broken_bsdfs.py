# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Right BSDF plugins, and the same with one mistake each.

`MISTAKES` maps the name of a broken plugin to the function that is guilty. The classes
are made anew for the variant that is set, by :func:`register`.
"""

from functools import cache

import drjit as dr
import mitsuba as mi
import plain_bsdf

from gonio_mi.validation import validate

# Right plugins, whose mistakes are below.
RIGHT = (
    "lambert",
    "grey",
    "two_faces",
    "retro",
    "mixture",
    "brushed",
    "glass",
    "frosted",
    "facets",
    "dusty",
    "grating",
)

# Where weight times pdf is one account and `eval` another, and nothing tells which of
# both is right: neither gains light, both are reciprocal.
EITHER = (
    "eval_five_percent_less",
    "weight_five_percent_less",
    "eval_of_twice_the_exponent",
    "weight_of_twice_the_exponent",
    "eval_with_uv_swapped",
    "eval_of_one_roughness",
    "eval_eta2_upside_down",
)

MISTAKES = {
    # of a Lambertian
    "eval_without_cosine": "eval",
    "eval_with_two_cosines": "eval",
    "eval_without_pi": "eval",
    "eval_negative": "eval",
    "eval_nan_at_grazing": "eval",
    "eval_ignores_active": "eval",
    "eval_gains_one_percent": "eval",
    "weight_without_division": "sample",
    "weight_with_cosine": "sample",
    "sample_ignores_active": "sample",
    "sample_clamps_at_pole": "sample",
    "sample_not_unit": "sample",
    "pdf_uniform": "pdf",
    "pdf_half_a_percent_off": "pdf",
    "pdf_a_permille_off_everywhere": "pdf",
    "flags_of_another_lobe": "flags",
    "flags_without_back_side": "flags",
    "flags_smooth_missing": "flags",
    "pdf_below_the_horizon": "pdf",
    "pdf_negative_below": "pdf",
    "eval_and_pdf_are_zero": "eval",
    "eval_remembers_the_call_before": "eval",
    "pdf_counts_its_calls": "pdf",
    "gradient_detached": "eval",
    "gradient_of_a_cached_value": "eval",
    "traverse_raises": "traverse",
    "eta_of_a_reflection": "sample",
    "eval_half_below_a_line": "eval",
    "support_with_a_hole": "pdf",
    "hemisphere_mixed_up": "sample",
    "black_before_the_horizon": "eval",
    "eval_other_at_normal": "eval",
    "eval_five_percent_less": "eval",
    "weight_five_percent_less": "sample",
    # of a lobe towards the light
    "eval_of_twice_the_exponent": "eval",
    "weight_of_twice_the_exponent": "sample",
    # of a mixture with a microfacet lobe
    "weight_without_lobe_probability": "sample",
    "lobes_picked_the_wrong_way": "sample",
    "sample_reused": "sample",
    "sampled_pdf_of_one_lobe": "sample",
    "phi_with_wrong_sign": "sample",
    "density_without_jacobian": "pdf",
    "pdf_of_one_lobe": "pdf",
    "pdf_without_lobe_probabilities": "pdf",
    "pdf_of_lobes_too_small": "pdf",
    "pdf_without_jacobian": "pdf",
    "fresnel_not_reciprocal": "eval",
    "eval_ignores_component": "eval",
    "eval_pdf_of_one_lobe": "eval_pdf",
    "eval_pdf_sample_without_cosine": "eval_pdf_sample",
    # of microfacets alone, with the weight that follows
    "value_without_cosine": "eval",
    "value_with_two_cosines": "eval",
    "value_with_cosine_of_wi": "eval",
    "density_without_cosine_of_h": "pdf",
    # of an anisotropic lobe
    "axes_swapped": "sample",
    "pdf_with_axes_swapped": "pdf",
    "flags_isotropic": "flags",
    # of interfaces
    "radiance_without_eta2": "sample",
    "importance_with_eta2": "sample",
    "refraction_not_snells": "sample",
    "discrete_pdf_not_probability": "sample",
    "cats_eye_gains_light": "sample",
    "eval_the_same_in_both_modes": "eval",
    # directions and places mixed up, and what is kept from call to call
    "eval_with_cosine_of_wi": "eval",
    "eval_with_uv_swapped": "eval",
    "eval_black_from_behind": "eval",
    "eval_fresnel_at_another_angle": "eval",
    "eval_of_one_roughness": "eval",
    "eval_eta2_upside_down": "eval",
    "pdf_clamped": "pdf",
    "pdf_of_half_vector_too_long": "pdf",
    "pdf_of_the_last_sample": "pdf",
    "pdf_with_two_cosines": "pdf",
    "sample_below_the_horizon": "sample",
    "sample_with_eta_of_the_other_side": "sample",
    # coordinates of the world where local ones are due, and the other way round
    "sample_in_world_coordinates": "sample",
    "eval_to_local_once_more": "eval",
    "value_to_local_once_more": "eval",
    "pdf_to_local_once_more": "pdf",
    "eval_to_world": "eval",
    # several directions in one discrete component
    "grating_of_equal_pdf": "sample",
    # directions rejected at random
    "roulette_without_its_probability": "sample",
    "roulette_of_another_probability": "sample",
    # where samples never look
    "eval_pdf_lit_below": "eval_pdf",
    "eval_lit_from_behind": "eval",
    "eval_nan_along_the_surface": "eval",
    "eval_nan_rarely": "eval",
    "pdf_lit_from_behind": "pdf",
    # no usable answer
    "pdf_raises": "pdf",
    "eval_returns_a_direction": "eval",
    "sample_returns_weight_only": "sample",
}


@cache
def judged(name, effort):
    """The verdict of a user on a broken plugin, which several tests look at."""
    return validate({"type": name}, effort=effort)


def register():
    """Define and register all plugins for the variant that is set; return them."""
    flags = mi.BSDFFlags
    diffuse = int(flags.DiffuseReflection)
    glossy = int(flags.GlossyReflection)
    front, back = int(flags.FrontSide), int(flags.BackSide)
    cosine = mi.Frame3f.cos_theta

    Plugin = plain_bsdf.plain()

    class Lambert(Plugin):
        """Right; what flags declare is another matter."""

        def drawn(self, ctx, si, bs):
            bs.sampled_type = mi.UInt32(diffuse)

    class EvalWithoutCosine(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0.8 * dr.inv_pi) & (active & self.above(si, wo))

    class EvalWithTwoCosines(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, wo, active) * cosine(wo)

    class EvalWithoutPi(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, wo, active) * dr.pi

    class EvalNegative(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, wo, active) - 0.01

    class EvalNanAtGrazing(Lambert):
        def eval(self, ctx, si, wo, active=True):
            fade = dr.sqrt(1 - dr.square(0.01 / cosine(si.wi)))
            return super().eval(ctx, si, wo, active) * dr.select(
                cosine(si.wi) > 0.02, 1, fade
            )

    class EvalIgnoresActive(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, wo, True)

    class EvalGainsOnePercent(Lambert):
        reflectance = 1.01

    class WeightWithoutDivision(Lambert):
        def weight(self, ctx, si, bs):
            return self.value(ctx, si, bs.wo)

    class WeightWithCosine(Lambert):
        def weight(self, ctx, si, bs):
            return super().weight(ctx, si, bs) * cosine(bs.wo)

    class SampleIgnoresActive(Lambert):
        def sample(self, ctx, si, sample1, sample2, active=True):
            return super().sample(ctx, si, sample1, sample2, True)

    class SampleClampsAtPole(Lambert):
        def direction(self, ctx, si, sample1, sample2):
            phi = dr.two_pi * sample2.y
            sin_theta = dr.maximum(dr.sqrt(sample2.x), 0.05)
            cos_theta = dr.safe_sqrt(1 - dr.square(sin_theta))
            return mi.Vector3f(
                sin_theta * dr.cos(phi), sin_theta * dr.sin(phi), cos_theta
            )

    class SampleNotUnit(Lambert):
        def direction(self, ctx, si, sample1, sample2):
            return 1.01 * super().direction(ctx, si, sample1, sample2)

    class PdfUniform(Lambert):
        def pdf(self, ctx, si, wo, active=True):
            return dr.select(active & self.above(si, wo), 0.5 * dr.inv_pi, mi.Float(0))

    class PdfHalfAPercentOff(Lambert):
        def pdf(self, ctx, si, wo, active=True):
            return 1.005 * super().pdf(ctx, si, wo, active)

    class PdfAPermilleOffEverywhere(Lambert):
        def density(self, ctx, si, wo):
            return 0.999 * super().density(ctx, si, wo)

    class FlagsOfAnotherLobe(Lambert):
        components = (glossy | front,)

    class FlagsSmoothMissing(Lambert):
        """Integrators that sample light skip it."""

        components = (int(flags.DeltaReflection) | front,)

    class PdfBelowTheHorizon(Lambert):
        def pdf(self, ctx, si, wo, active=True):
            ok = active & (cosine(si.wi) > 0)
            return dr.select(ok, dr.inv_pi * dr.abs(cosine(wo)), 0)

    class PdfNegativeBelow(Lambert):
        def pdf(self, ctx, si, wo, active=True):
            return dr.select(active & (cosine(si.wi) > 0), dr.inv_pi * cosine(wo), 0)

    class SupportWithAHole(Lambert):
        """Samples leave out a rim of the hemisphere, and `pdf` knows."""

        def density(self, ctx, si, wo):
            inside = cosine(wo) > 0.2
            return dr.select(inside, dr.inv_pi * cosine(wo) / (1 - 0.04), 0)

        def direction(self, ctx, si, sample1, sample2):
            wo = super().direction(ctx, si, sample1, sample2)
            z = dr.sqrt(0.04 + 0.96 * dr.square(wo.z))
            sines = [dr.safe_sqrt(1 - dr.square(x)) for x in (z, wo.z)]
            across = sines[0] / dr.maximum(sines[1], 1e-6)
            return mi.Vector3f(wo.x * across, wo.y * across, z)

    class EvalAndPdfAreZero(Lambert):
        """As if it were a discrete lobe."""

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

    class EvalRemembersTheCallBefore(Lambert):
        """The light of the last sample decides."""

        last = None

        def sample(self, ctx, si, sample1, sample2, active=True):
            first = self.last is None
            self.last = dr.opaque(mi.Float, 1.0 if first else 0.7)
            return super().sample(ctx, si, sample1, sample2, active)

        def value(self, ctx, si, wo):
            share = mi.Float(1) if self.last is None else self.last
            return super().value(ctx, si, wo) * share

        def weight(self, ctx, si, bs):
            return mi.Spectrum(0.8)

    class PdfCountsItsCalls(Lambert):
        calls = 0

        def pdf(self, ctx, si, wo, active=True):
            self.calls += 1
            drift = 1 + 0.001 * min(self.calls, 100)
            return super().pdf(ctx, si, wo, active) * drift

    class Grey(Lambert):
        """With a parameter."""

        def __init__(self, props):
            super().__init__(props)
            self.reflectance = mi.Float(props.get("reflectance", 0.6))

        def traverse(self, callback):
            kind = mi.ParamFlags.Differentiable
            callback.put("reflectance", self.reflectance, kind)

    class GradientDetached(Grey):
        def value(self, ctx, si, wo):
            return dr.detach(super().value(ctx, si, wo))

    class GradientOfACachedValue(Grey):
        """Half of it is only made anew, and not differentiated."""

        def __init__(self, props):
            super().__init__(props)
            self.half = dr.detach(0.5 * self.reflectance)

        def parameters_changed(self, keys=()):
            self.half = dr.detach(0.5 * self.reflectance)

        def value(self, ctx, si, wo):
            whole = 0.5 * self.reflectance + self.half
            return mi.Spectrum(whole * dr.inv_pi * cosine(wo))

    class TraverseRaises(Lambert):
        def traverse(self, callback):
            callback.put_parameter("reflectance", 0.8)

    class EtaOfAReflection(Lambert):
        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            bs.eta = 1.5
            return bs, weight

    class WeightFivePercentLess(Lambert):
        def weight(self, ctx, si, bs):
            return 0.95 * super().weight(ctx, si, bs)

    class EvalHalfBelowALine(Lambert):
        """Wrong for incident light of one side only."""

        def eval(self, ctx, si, wo, active=True):
            value = super().eval(ctx, si, wo, active)
            return value * dr.select(si.wi.y < 0, 0.5, mi.Float(1))

    class BlackBeforeTheHorizon(Lambert):
        """A guard against small cosines that is too wide."""

        def above(self, si, wo):
            return (cosine(si.wi) > 0.01) & (cosine(wo) > 0)

    class EvalOtherAtNormal(Lambert):
        """Its azimuth is unknown there."""

        def value(self, ctx, si, wo):
            normal = dr.square(si.wi.x) + dr.square(si.wi.y) < 1e-12
            return super().value(ctx, si, wo) * dr.select(normal, 0.5, mi.Float(1))

    class CompilesAnew(Lambert):
        """A number of Python that changes is a literal, here of no consequence."""

        calls = 0

        def density(self, ctx, si, wo):
            self.calls += 1
            return dr.select(wo.z > -1 - self.calls, dr.inv_pi * cosine(wo), 0)

    class EvalFivePercentLess(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return 0.95 * super().eval(ctx, si, wo, active)

    class Retro(Lambert):
        """A lobe around the direction to the source; what it has below is lost."""

        components = (glossy | front,)
        exponent = 20

        def lobe(self, si, wo, exponent):
            along = dr.maximum(dr.dot(wo, si.wi), 0)
            return (exponent + 1) / (2 * dr.pi) * dr.power(along, exponent)

        def value(self, ctx, si, wo):
            return mi.Spectrum(0.8 * self.lobe(si, wo, self.exponent) * cosine(wo))

        def density(self, ctx, si, wo):
            return self.lobe(si, wo, self.exponent)

        def direction(self, ctx, si, sample1, sample2):
            z = dr.power(sample2.x, 1 / (self.exponent + 1))
            across = dr.safe_sqrt(1 - z * z)
            sin, cos = dr.sincos(dr.two_pi * sample2.y)
            local = mi.Vector3f(across * cos, across * sin, z)
            return mi.Vector3f(mi.Frame3f(si.wi).to_world(local))

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            bs.sampled_type = mi.UInt32(glossy)
            return bs, weight

    class EvalOfTwiceTheExponent(Retro):
        """Nothing tells that it was meant otherwise."""

        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) * dr.power(
                dr.dot(wo, si.wi), self.exponent
            )

        def weight(self, ctx, si, bs):
            return super().value(ctx, si, bs.wo) / bs.pdf

    class WeightOfTwiceTheExponent(Retro):
        def weight(self, ctx, si, bs):
            along = dr.dot(bs.wo, si.wi)
            return super().weight(ctx, si, bs) * dr.power(along, self.exponent)

    class Facets(Lambert):
        """Their reflectance is small enough that no mistake below gains light."""

        components = (glossy | front,)

        def facets(self):
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, 0.3, False)

        def value(self, ctx, si, wo):
            h = dr.normalize(si.wi + wo)
            masked = self.facets().eval(h) * self.facets().G(si.wi, wo, h)
            return mi.Spectrum(0.3 * masked / (4 * cosine(si.wi)))

        def density(self, ctx, si, wo):
            h = dr.normalize(si.wi + wo)
            return self.facets().pdf(si.wi, h) / (4 * dr.dot(wo, h))

        def direction(self, ctx, si, sample1, sample2):
            return mi.reflect(si.wi, self.facets().sample(si.wi, sample2)[0])

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            bs.sampled_type = mi.UInt32(glossy)
            return bs, weight

    class ValueWithoutCosine(Facets):
        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) / cosine(wo)

    class BrightFacets(Facets):
        def value(self, ctx, si, wo):
            return 4 * super().value(ctx, si, wo)

    class BrightValueWithoutCosine(ValueWithoutCosine):
        def value(self, ctx, si, wo):
            return 3 * super().value(ctx, si, wo)

    class ValueWithTwoCosines(Facets):
        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) * cosine(wo)

    class ValueWithCosineOfWi(Facets):
        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) * cosine(si.wi) / cosine(wo)

    class ValueOverRootOfCosine(Facets):
        """A law of its own."""

        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) / dr.sqrt(cosine(wo))

    class ValueWithoutCosineIfSteep(Facets):
        def value(self, ctx, si, wo):
            steep = cosine(si.wi) > 0.5
            return super().value(ctx, si, wo) / dr.select(steep, cosine(wo), 1)

    class ValueWithoutCosineByDeclaration(ValueWithoutCosine):
        components = (glossy | front | int(flags.NonSymmetric),)

    class DensityWithoutCosineOfH(Facets):
        def density(self, ctx, si, wo):
            return super().density(ctx, si, wo) / cosine(dr.normalize(si.wi + wo))

    class DensityTilted(Facets):
        def density(self, ctx, si, wo):
            h = dr.normalize(si.wi + wo)
            return super().density(ctx, si, wo) * (1 + 0.3 * h.y)

    class TwoFaces(Lambert):
        components = (diffuse | front | back,)

        def above(self, si, wo):
            return cosine(si.wi) * cosine(wo) > 0

        def value(self, ctx, si, wo):
            return mi.Spectrum(0.8 * dr.inv_pi * dr.abs(cosine(wo)))

        def density(self, ctx, si, wo):
            return dr.inv_pi * dr.abs(cosine(wo))

        def direction(self, ctx, si, sample1, sample2):
            wo = super().direction(ctx, si, sample1, sample2)
            wo.z = dr.mulsign(wo.z, cosine(si.wi))
            return wo

    class FlagsWithoutBackSide(TwoFaces):
        components = (diffuse | front,)

    class HemisphereMixedUp(TwoFaces):
        """Samples of the back leave on the front, with the weight of the back."""

        def direction(self, ctx, si, sample1, sample2):
            return mi.warp.square_to_cosine_hemisphere(sample2)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, _ = super().sample(ctx, si, sample1, sample2, active)
            return bs, mi.Spectrum(0.8) & active

    # ------------------------------------- Mixture of a Lambertian and microfacets

    class Mixture(Plugin):
        components = (diffuse | front, glossy | front)
        alpha = (0.3, 0.3)
        share = 0.3  # probability of the glossy lobe

        def facets(self):
            alpha_u, alpha_v = (mi.Float(a) for a in self.alpha)
            return mi.MicrofacetDistribution(
                mi.MicrofacetType.GGX, alpha_u, alpha_v, False
            )

        def fresnel(self, si, wo, h):
            return 0.1 + 0.3 * (1 - dr.abs(dr.dot(wo, h))) ** 5

        def value(self, ctx, si, wo):
            h = dr.normalize(si.wi + wo)
            facets = self.facets()
            value = mi.Spectrum(0)
            if ctx.is_enabled(flags.DiffuseReflection, 0):
                value += 0.5 * dr.inv_pi * cosine(wo)
            if ctx.is_enabled(flags.GlossyReflection, 1):
                value += (
                    self.fresnel(si, wo, h)
                    * facets.eval(h)
                    * facets.G(si.wi, wo, h)
                    / (4 * cosine(si.wi))
                )
            return value

        def jacobian(self, wo, h):
            return 1 / (4 * dr.abs(dr.dot(wo, h)))

        def densities(self, si, wo):
            h = dr.normalize(si.wi + wo)
            return (
                dr.inv_pi * cosine(wo),
                self.facets().pdf(si.wi, h) * self.jacobian(wo, h),
            )

        def glossy_share(self, ctx):
            first = ctx.is_enabled(flags.DiffuseReflection, 0)
            second = ctx.is_enabled(flags.GlossyReflection, 1)
            return self.share if first and second else float(second)

        def density(self, ctx, si, wo):
            first, second = self.densities(si, wo)
            share = self.glossy_share(ctx)
            return (1 - share) * first + share * second

        def pick(self, ctx, sample1, sample2):
            return sample1 < self.glossy_share(ctx), sample2

        def facet(self, si, sample2):
            return mi.Vector3f(self.facets().sample(si.wi, sample2)[0])

        def reflected(self, wi, h):
            return mi.reflect(wi, h)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f)
            second, sample2 = self.pick(ctx, sample1, sample2)
            bs.wo = dr.select(
                second,
                self.reflected(si.wi, self.facet(si, sample2)),
                mi.warp.square_to_cosine_hemisphere(sample2),
            )
            bs.sampled_component = dr.select(second, mi.UInt32(1), mi.UInt32(0))
            bs.sampled_type = dr.select(second, mi.UInt32(glossy), mi.UInt32(diffuse))
            bs.eta = 1.0
            bs.pdf = self.density(ctx, si, bs.wo)
            ok = active & self.above(si, bs.wo) & (bs.pdf > 0)
            return bs, self.weight(ctx, si, bs) & ok

    class WeightWithoutLobeProbability(Mixture):
        def weight(self, ctx, si, bs):
            first = bs.sampled_component == 0
            diffuse_pdf, glossy_pdf = self.densities(si, bs.wo)
            only = mi.BSDFContext(ctx.mode)
            only.component = 0
            lambert = self.value(only, si, bs.wo) / diffuse_pdf
            only.component = 1
            return dr.select(first, lambert, self.value(only, si, bs.wo) / glossy_pdf)

    class LobesPickedTheWrongWay(Mixture):
        def pick(self, ctx, sample1, sample2):
            return sample1 >= self.glossy_share(ctx), sample2

    class SampleReused(Mixture):
        def pick(self, ctx, sample1, sample2):
            return sample2.x < self.glossy_share(ctx), sample2

    class SampledPdfOfOneLobe(Mixture):
        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            first, second = self.densities(si, bs.wo)
            bs.pdf = dr.select(bs.sampled_component == 0, first, second)
            return bs, weight

    class PhiWithWrongSign(Mixture):
        def reflected(self, wi, h):
            wo = mi.reflect(wi, h)
            return mi.Vector3f(wo.x, -wo.y, wo.z)

    class DensityWithoutJacobian(Mixture):
        def jacobian(self, wo, h):
            return 1.0

    class PdfWithoutJacobian(Mixture):
        def pdf(self, ctx, si, wo, active=True):
            h = dr.normalize(si.wi + wo)
            share = self.glossy_share(ctx)
            pdf = (1 - share) * dr.inv_pi * cosine(wo)
            pdf += share * self.facets().pdf(si.wi, h)
            return dr.select(active & self.above(si, wo), pdf, 0)

    class PdfOfOneLobe(Mixture):
        def pdf(self, ctx, si, wo, active=True):
            share = self.glossy_share(ctx)
            first, second = self.densities(si, wo)
            pdf = second if share == 1 else first
            return dr.select(active & self.above(si, wo), pdf, 0)

    class PdfWithoutLobeProbabilities(Mixture):
        def pdf(self, ctx, si, wo, active=True):
            first, second = self.densities(si, wo)
            share = self.glossy_share(ctx)
            pdf = {0.0: first, 1.0: second}.get(share, first + second)
            return dr.select(active & self.above(si, wo), pdf, 0)

    class PdfOfLobesTooSmall(Mixture):
        """Of components alone; nobody but their author asks for them."""

        def density(self, ctx, si, wo):
            alone = ctx.component != mi.BSDFContext().component
            return super().density(ctx, si, wo) * (0.1 if alone else 1.0)

    class FresnelNotReciprocal(Mixture):
        def fresnel(self, si, wo, h):
            return 0.1 + 0.3 * (1 - dr.abs(cosine(si.wi))) ** 5

    class EvalIgnoresComponent(Mixture):
        def eval(self, ctx, si, wo, active=True):
            return super().eval(mi.BSDFContext(ctx.mode), si, wo, active)

    class EvalPdfOfOneLobe(Mixture):
        def eval_pdf(self, ctx, si, wo, active=True):
            value = self.eval(ctx, si, wo, active)
            pdf = dr.select(self.above(si, wo), self.densities(si, wo)[0], 0)
            return value, pdf

    class EvalPdfSampleWithoutCosine(Mixture):
        def eval_pdf_sample(self, ctx, si, wo, sample1, sample2, active=True):
            value, pdf = self.eval_pdf(ctx, si, wo, active)
            bs, weight = self.sample(ctx, si, sample1, sample2, active)
            return value / dr.maximum(cosine(wo), 1e-4), pdf, bs, weight

    class Brushed(Mixture):
        components = (diffuse | front, glossy | front | int(flags.Anisotropic))
        alpha = (0.1, 0.4)
        share = 0.6

    class AxesSwapped(Brushed):
        def facet(self, si, sample2):
            h = super().facet(si, sample2)
            return mi.Vector3f(h.y, h.x, h.z)

    class PdfWithAxesSwapped(Brushed):
        def densities(self, si, wo):
            own, self.alpha = self.alpha, self.alpha[::-1]
            found = super().densities(si, wo)
            self.alpha = own
            return found

    class FlagsIsotropic(Brushed):
        components = (diffuse | front, glossy | front)

    # -------------------------------------------------------------------- Interfaces

    class Glass(Plugin):
        components = (
            int(flags.DeltaReflection) | front | back,
            int(flags.DeltaTransmission) | front | back | int(flags.NonSymmetric),
        )

        def factor(self, ctx, eta):
            radiance = ctx.mode == mi.TransportMode.Radiance
            return 1 / dr.square(eta) if radiance else mi.Float(1)

        def refracted(self, wi, cos_t, eta_ti):
            return mi.refract(wi, cos_t, eta_ti)

        def probability(self, f):
            return f

        def sample(self, ctx, si, sample1, sample2, active=True):
            f, cos_t, eta, eta_ti = mi.fresnel(cosine(si.wi), 1.5)
            r = ctx.is_enabled(flags.DeltaReflection, 0)
            t = ctx.is_enabled(flags.DeltaTransmission, 1)
            bs = dr.zeros(mi.BSDFSample3f)
            share = f if r and t else mi.Float(float(r))
            reflect = sample1 <= share
            bs.wo = dr.select(
                reflect, mi.reflect(si.wi), self.refracted(si.wi, cos_t, eta_ti)
            )
            bs.pdf = self.probability(dr.select(reflect, share, 1 - share))
            bs.eta = dr.select(reflect, 1, eta)
            bs.sampled_component = dr.select(reflect, mi.UInt32(0), mi.UInt32(1))
            bs.sampled_type = dr.select(
                reflect,
                mi.UInt32(+flags.DeltaReflection),
                mi.UInt32(+flags.DeltaTransmission),
            )
            weight = dr.select(reflect, 1, self.factor(ctx, eta))
            if not (r and t):
                weight *= f if r else 1 - f
            return bs, mi.Spectrum(weight) & (active & (r or t))

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return mi.Spectrum(0), mi.Float(0)

    class RadianceWithoutEta2(Glass):
        def factor(self, ctx, eta):
            return mi.Float(1)

    class ImportanceWithEta2(Glass):
        def factor(self, ctx, eta):
            return 1 / dr.square(eta)

    class RefractionNotSnells(Glass):
        def refracted(self, wi, cos_t, eta_ti):
            return dr.normalize(mi.Vector3f(-wi.x, -wi.y, -1.5 * wi.z))

    class DiscretePdfNotProbability(Glass):
        def probability(self, f):
            return mi.Float(1)

    class CatsEyeGainsLight(Lambert):
        """Back to where it came from is a model's choice, not so 1 / cos."""

        components = (int(flags.DeltaReflection) | front,)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.pdf, bs.eta = si.wi, 1.0, 1.0
            bs.sampled_type = mi.UInt32(+flags.DeltaReflection)
            ok = active & (cosine(si.wi) > 0)
            return bs, mi.Spectrum(1 / cosine(si.wi)) & ok

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

    class Frosted(TwoFaces):
        """Scatters evenly to the other side, where the index is 1.5 (below) or 1."""

        components = (
            int(flags.DiffuseTransmission) | front | back | int(flags.NonSymmetric),
        )

        def above(self, si, wo):
            return cosine(si.wi) * cosine(wo) < 0

        def direction(self, ctx, si, sample1, sample2):
            wo = super().direction(ctx, si, sample1, sample2)
            return mi.Vector3f(wo.x, wo.y, -wo.z)

        def eta(self, si):
            return dr.select(cosine(si.wi) > 0, mi.Float(1.5), 1 / 1.5)

        def factor(self, ctx, si):
            """Of the flux 0.8 passes downwards, 0.8 / 1.5^2 upwards."""
            up = cosine(si.wi) < 0
            if ctx.mode == mi.TransportMode.Radiance:
                up = ~up
            return dr.select(up, 1 / 1.5**2, mi.Float(1))

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            bs.eta = self.eta(si)
            bs.sampled_type = mi.UInt32(+flags.DiffuseTransmission)
            return bs, weight * self.factor(ctx, si)

        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, wo, active) * self.factor(ctx, si)

    class EvalTheSameInBothModes(Frosted):
        def factor(self, ctx, si):
            return super().factor(mi.BSDFContext(mi.TransportMode.Importance), si)

    # ----------------------------------------- Directions, places and calls mixed up

    class EvalWithCosineOfWi(Lambert):
        def eval(self, ctx, si, wo, active=True):
            value = mi.Spectrum(0.8 * dr.inv_pi * cosine(si.wi))
            return value & (active & self.above(si, wo))

    class EvalWithUvSwapped(Lambert):
        """Stripes along u, which ``eval`` has along v."""

        def stripes(self, u):
            return 0.5 + 0.3 * dr.sin(5 * u)

        def weight(self, ctx, si, bs):
            return mi.Spectrum(self.stripes(si.uv.x))

        def value(self, ctx, si, wo):
            return mi.Spectrum(self.stripes(si.uv.y) * dr.inv_pi * cosine(wo))

    class EvalBlackFromBehind(TwoFaces):
        """Two-sided, but for one function."""

        def value(self, ctx, si, wo):
            return mi.Spectrum(0.8 * dr.inv_pi * dr.maximum(cosine(wo), 0))

        def weight(self, ctx, si, bs):
            return mi.Spectrum(0.8)

    class EvalFresnelAtAnotherAngle(Mixture):
        def eval(self, ctx, si, wo, active=True):
            self.fresnel = lambda _, wo, __: 0.1 + 0.3 * (1 - cosine(wo)) ** 5
            value = super().eval(ctx, si, wo, active)
            del self.fresnel
            return value

    class EvalOfOneRoughness(Brushed):
        """Its normals are as many as if both roughnesses were the first."""

        def eval(self, ctx, si, wo, active=True):
            first, second = self.alpha
            only = mi.BSDFContext(ctx.mode)
            only.component = 0
            diffuse = super().eval(only, si, wo, active)
            whole = super().eval(ctx, si, wo, active)
            if not ctx.is_enabled(flags.DiffuseReflection, 0):
                return whole * second / first
            if not ctx.is_enabled(flags.GlossyReflection, 1):
                return whole
            return diffuse + (whole - diffuse) * second / first

    class EvalEta2UpsideDown(Frosted):
        def eval(self, ctx, si, wo, active=True):
            value = Lambert.eval(self, ctx, si, wo, active)
            return value / dr.maximum(self.factor(ctx, si), 1e-3) / 1.5**2

    class PdfClamped(Brushed):
        """Against fireflies."""

        def pdf(self, ctx, si, wo, active=True):
            return dr.minimum(super().pdf(ctx, si, wo, active), 0.5)

    class PdfOfHalfVectorTooLong(Mixture):
        """Nobody normalised it."""

        def pdf(self, ctx, si, wo, active=True):
            h = (si.wi + wo) / 1.9
            share = self.glossy_share(ctx)
            glossy = self.facets().pdf(si.wi, h) * self.jacobian(wo, dr.normalize(h))
            pdf = (1 - share) * dr.inv_pi * cosine(wo) + share * glossy
            return dr.select(active & self.above(si, wo), pdf, 0)

    class PdfOfTheLastSample(Mixture):
        """It remembers from where ``sample`` was lit."""

        lit = None

        def sample(self, ctx, si, sample1, sample2, active=True):
            self.lit = mi.Vector3f(si.wi)
            return super().sample(ctx, si, sample1, sample2, active)

        def pdf(self, ctx, si, wo, active=True):
            other = mi.SurfaceInteraction3f(si)
            if self.lit is not None and dr.width(self.lit) == dr.width(wo):
                other.wi = self.lit
            return super().pdf(ctx, other, wo, active)

    class PdfWithTwoCosines(Lambert):
        def pdf(self, ctx, si, wo, active=True):
            return super().pdf(ctx, si, wo, active) * cosine(wo)

    class SampleBelowTheHorizon(Mixture):
        """Facets reflect downwards too, with the weight of facets."""

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            below = (bs.wo.z < 0) & (si.wi.z > 0)
            return bs, dr.select(active & below, mi.Spectrum(0.3), weight)

    class SampleWithEtaOfTheOtherSide(Glass):
        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            bs.eta = 1 / bs.eta
            return bs, weight

    class Noise(Lambert):
        """So rough a function of wo that no patch of it can be integrated."""

        components = (diffuse | front | int(flags.Anisotropic),)

        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) * self.noise(wo)

        def noise(self, wo):
            number = 3e4 * dr.sin(1e4 * wo.x) + 3e4 * dr.cos(1e4 * wo.y)
            return dr.select(number - dr.floor(number) < 0.01, 50.5, mi.Float(0.5))

    class Grating(Plugin):
        """Right: three orders in one discrete component, each of its probability."""

        components = (int(flags.DeltaReflection) | front | int(flags.Anisotropic),)
        efficiency = (0.2, 0.5, 0.2)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f)
            order = dr.select(sample1 < 0.25, -1.0, dr.select(sample1 < 0.75, 0.0, 1.0))
            x, y = 0.3 * order - si.wi.x, -si.wi.y
            square = 1 - dr.square(x) - dr.square(y)
            bs.wo = mi.Vector3f(x, y, dr.safe_sqrt(square))
            bs.pdf = self.probability(dr.select(order == 0, 0.5, mi.Float(0.25)))
            bs.eta = 1.0
            bs.sampled_type = mi.UInt32(+flags.DeltaReflection)
            value = dr.select(order == 0, self.efficiency[1], self.efficiency[0])
            ok = active & (cosine(si.wi) > 0) & (square > 0)
            return bs, mi.Spectrum(value / bs.pdf) & ok

        def probability(self, pdf):
            return pdf

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return mi.Spectrum(0), mi.Float(0)

    class Roulette(Mixture):
        """Right, if noisy: rejects more of what is dimmer."""

        def kept(self, wo):
            return 0.3 + 0.6 * dr.abs(cosine(wo))

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            share, kept = self.glossy_share(ctx), self.kept(bs.wo)
            rest = (sample1 - share) / max(1 - share, 1e-6)
            # what the choice of the lobe leaves of the number is uniform
            number = dr.select(sample1 < share, sample1 / max(share, 1e-6), rest)
            return bs, dr.select(number < kept, weight / self.probability(kept), 0)

        def probability(self, kept):
            return kept

    class RouletteWithoutItsProbability(Roulette):
        def probability(self, kept):
            return mi.Float(1)

    class RouletteOfAnotherProbability(Roulette):
        def probability(self, kept):
            return mi.Float(0.7)

    class GratingOfEqualPdf(Grating):
        def probability(self, pdf):
            return mi.Float(1 / 3)

    # ---------------------------------------------------- Coordinates of the world

    class SampleInWorldCoordinates(Mixture):
        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            bs.wo = si.to_world(bs.wo)
            return bs, weight

    class EvalToLocalOnceMore(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, si.to_local(wo), active)

    class ValueToLocalOnceMore(Lambert):
        """The weight of samples follows."""

        def value(self, ctx, si, wo):
            return super().value(ctx, si, dr.abs(si.to_local(wo)))

    class PdfToLocalOnceMore(Mixture):
        def pdf(self, ctx, si, wo, active=True):
            return super().pdf(ctx, si, si.to_local(wo), active)

    class EvalToWorld(Mixture):
        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, si.to_world(wo), active)

    class Dusty(Lambert):
        """Right: brighter where it looks up, and by its place in the world."""

        def value(self, ctx, si, wo):
            up = 0.5 + 0.5 * dr.abs(si.sh_frame.n.z) + 0.1 * dr.sin(si.p.x)
            return super().value(ctx, si, wo) * dr.minimum(up, 1)

    class FadingAbove(Lambert):
        """Right, not reciprocal: high up it fades with the angle of incidence."""

        def value(self, ctx, si, wo):
            fade = 0.5 + 0.5 * dr.square(cosine(si.wi))
            return super().value(ctx, si, wo) * dr.select(si.p.z > 1, fade, 1)

    # ------------------------------------------------------- Where samples never look

    class EvalPdfLitBelow(Lambert):
        def eval_pdf(self, ctx, si, wo, active=True):
            up = mi.Vector3f(wo.x, wo.y, dr.abs(wo.z))
            return super().eval_pdf(ctx, si, up, active)

    class EvalLitFromBehind(Lambert):
        """It knows where wo is, and not where wi is."""

        def eval(self, ctx, si, wo, active=True):
            return self.value(ctx, si, wo) & (active & (cosine(wo) > 0))

    class PdfLitFromBehind(Lambert):
        """It knows that both are on one side, and not on which."""

        def pdf(self, ctx, si, wo, active=True):
            same = cosine(si.wi) * cosine(wo) > 0
            return dr.select(active & same, dr.inv_pi * dr.abs(cosine(wo)), 0)

    class EvalNanRarely(Lambert):
        """In 2 of a thousand directions."""

        def eval(self, ctx, si, wo, active=True):
            spoiled = dr.select(dr.abs(wo.z - 0.5) < 0.001, dr.nan, 0)
            return super().eval(ctx, si, wo, active) + spoiled

    class EvalNanAlongTheSurface(Lambert):
        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) * (si.wi.z / si.wi.z)

        def above(self, si, wo):
            return (cosine(si.wi) >= 0) & (cosine(wo) > 0)

    # --------------------------------------------------------------- No usable answer

    class PdfRaises(Lambert):
        def pdf(self, ctx, si, wo, active=True):
            return self.undefined(wo)

    class EvalReturnsADirection(Lambert):
        def eval(self, ctx, si, wo, active=True):
            return wo

    class SampleReturnsWeightOnly(Lambert):
        def sample(self, ctx, si, sample1, sample2, active=True):
            return super().sample(ctx, si, sample1, sample2, active)[1]

    found = [one for one in locals().values() if isinstance(one, type)]
    plain_bsdf.register(one for one in found if one is not Plugin)
    return {plain_bsdf.name_of(one): one for one in found}
