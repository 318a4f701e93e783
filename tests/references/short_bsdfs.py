# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Short BSDF plugins: broken ones of many kinds, and right ones that are unusual.

`MISTAKES` maps the name of a broken plugin to the functions that may be named as
guilty; the docstring of its class is the image that it biases. `RIGHT` lists the right
ones. The classes are made anew for the variant that is set, by :func:`register`.
"""

import drjit as dr
import mitsuba as mi
import plain_bsdf
import right_bsdfs

MISTAKES = {
    # only in the mode of path tracers
    "radiance_draws_one_lobe": "sample",
    "radiance_draws_too_wide": "sample",
    "radiance_pdf_with_eta2": "pdf",
    "radiance_weight_less": "sample",
    "eval_pdf_of_one_mode": "eval_pdf",
    "eta_inverted": "sample",
    "eta_always_one": "sample",
    # after a change of parameters
    "stale_pdf": "pdf",
    "stale_sample": "sample",
    "stale_eval": "eval",
    "stale_weight": "sample",
    "stale_table": "sample",
    "update_raises": "parameters_changed",
    "gradient_of_a_spectrum_detached": "eval",
    # what is asked for
    "eval_deaf_to_type_mask": "eval",
    "sample_deaf_to_type_mask": "sample",
    "pdf_deaf_to_type_mask": "pdf",
    "albedo_without_pi": "eval_diffuse_reflectance",
    "albedo_negative": "eval_diffuse_reflectance",
    # the place of a ray in the array
    "eval_by_lane": "eval",
    "pdf_by_lane": "pdf",
    # some degrees of incidence
    "eval_in_a_sector": "eval or sample",
    "pdf_in_a_sector": "pdf",
    "eval_in_a_band": "eval or sample",
    "weight_in_a_band": "eval or sample",
    "sample_in_a_band": "sample or pdf",
    "sampled_pdf_in_a_band": "sample",
    # the surface in the world
    "cosine_of_the_world": "eval",
    "lobe_by_place": "sample",
    # two lobes
    "pdf_of_another_mixture": "pdf",
    "pdf_lobe_without_norm": "pdf",
    "pdf_of_other_half_vector": "pdf",
    "pdf_unset": "sample",
    "azimuth_of_the_choice": "sample",
    "per_mille_lost": "sample",
    "sample_of_another_exponent": "sample",
    "weight_clamped": "sample or eval",
    "weight_nan_rarely": "sample",
    "weight_kept": "eval or sample",
    # sides
    "eval_lit_below": "eval",
    "pdf_of_both_sides": "pdf",
    # discrete lobes beside others
    "discrete_weight_too_high": "sample",
    "pdf_without_share_of_mirror": "pdf",
    "number_of_the_mirror": "sample",
    "null_says_opacity": "eval_null_transmission",
    "eval_forgets_opacity": "eval",
    "facets_lit_twice": "sample or flags",
}

# Of colours, which only rgb shows.
MISTAKES_IN_RGB = {
    "weight_of_other_colours": "sample or eval",
    "eval_of_other_colours": "eval or sample",
}

RIGHT = (
    "two_lobes",
    "mask_in_place",
    "drawn_facets",
    "dark_in_front",
    "weight_of_one_lane",
    "step_in_wo",
    "step_in_wi",
    "checks",
    "paper",
    "clear",
    "opacity",
    "slab",
    "wide_for_narrow",
    "lossy",
    "dim",
    "asymmetric",
    "table",
    "switches",
    "at_the_limit",
    "wrapped_glass",
    "retro_and_lambert",
    "stripes",
    "cached",
    "python_numbers",
    "spectrum_parameter",
    "flakes",
    "phase_of_wi",
    "own_eval_pdf_sample",
    "first_number_only",
    "lit_within_a_cone",
)


def register():
    """Define and register all plugins for the variant that is set."""
    flags = mi.BSDFFlags
    diffuse, glossy = int(flags.DiffuseReflection), int(flags.GlossyReflection)
    front, back = int(flags.FrontSide), int(flags.BackSide)
    both, asymmetric = front | back, int(flags.NonSymmetric)
    cosine = mi.Frame3f.cos_theta
    radiance = mi.TransportMode.Radiance

    def degrees(si):
        """Polar angle and azimuth of wi."""
        theta = dr.acos(dr.clip(dr.abs(si.wi.z), 0, 1))
        phi = dr.atan2(si.wi.y, si.wi.x)
        return dr.rad2deg(theta), dr.rad2deg(dr.select(phi < 0, phi + dr.two_pi, phi))

    def within(x, low, high):
        return (x > low) & (x < high)

    class TwoLobes(plain_bsdf.plain()):
        """Right: a Lambertian and a cosine lobe about the mirror direction."""

        components = (diffuse | front, glossy | front)
        kinds = (flags.DiffuseReflection, flags.GlossyReflection)
        kd, ks, exponent, choice = 0.5, 0.3, 20.0, 0.4

        def enabled(self, ctx):
            return [ctx.is_enabled(kind, i) for i, kind in enumerate(self.kinds)]

        def share(self, ctx, si):
            """Probability of the second lobe."""
            first, second = self.enabled(ctx)
            return mi.Float(self.choice if first and second else float(second))

        def power(self, si, wo):
            along = dr.dot(wo, mi.reflect(si.wi))
            # a power of 0 has no derivative by its exponent
            power = dr.power(dr.maximum(along, 1e-30), self.exponent)
            return dr.select(along > 0, power, 0)

        def values(self, si, wo):
            lobe = (self.exponent + 2) / dr.two_pi * self.power(si, wo)
            return self.kd * dr.inv_pi * cosine(wo), self.ks * lobe * cosine(wo)

        def value(self, ctx, si, wo):
            value = mi.Spectrum(0)
            for on, lobe in zip(self.enabled(ctx), self.values(si, wo)):
                value += lobe if on else 0
            return value

        def densities(self, si, wo):
            lobe = (self.exponent + 1) / dr.two_pi * self.power(si, wo)
            return dr.inv_pi * cosine(wo), lobe

        def density(self, ctx, si, wo):
            first, second = self.densities(si, wo)
            return dr.lerp(first, second, self.share(ctx, si))

        def first_direction(self, ctx, si, sample2):
            return mi.warp.square_to_cosine_hemisphere(sample2)

        def second_direction(self, ctx, si, sample2):
            z = dr.power(sample2.x, 1 / (self.exponent + 1))
            sin, cos = dr.sincos(dr.two_pi * sample2.y)
            across = dr.safe_sqrt(1 - z * z)
            local = mi.Vector3f(across * cos, across * sin, z)
            return mi.Vector3f(mi.Frame3f(mi.reflect(si.wi)).to_world(local))

        def finish(self, ctx, si, bs, weight):
            return bs, weight

        def pick(self, ctx, si, sample1):
            return sample1 < self.share(ctx, si)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f)
            second = self.pick(ctx, si, sample1)
            bs.wo = dr.select(
                second,
                self.second_direction(ctx, si, sample2),
                self.first_direction(ctx, si, sample2),
            )
            bs.pdf, bs.eta = self.density(ctx, si, bs.wo), 1.0
            last = min(1, len(self.components) - 1)
            bs.sampled_component = dr.select(second, mi.UInt32(last), mi.UInt32(0))
            bs.sampled_type = dr.select(
                second, mi.UInt32(+self.kinds[1]), mi.UInt32(+self.kinds[0])
            )
            ok = active & self.above(si, bs.wo) & (bs.pdf > 0)
            ok &= any(self.enabled(ctx))
            return self.finish(ctx, si, bs, self.weight(ctx, si, bs) & ok)

        def pdf(self, ctx, si, wo, active=True):
            on = active & any(self.enabled(ctx))
            return super().pdf(ctx, si, wo, on)

    class Lambert(TwoLobes):
        """A Lambertian alone."""

        components = (diffuse | front,)

        def enabled(self, ctx):
            return [ctx.is_enabled(self.kinds[0], 0), False]

    class Sheet(Lambert):
        """Right: transmits evenly, with the index of refraction 1.5 below."""

        components = (int(flags.DiffuseTransmission) | both | asymmetric,)
        kinds = (flags.DiffuseTransmission, flags.GlossyTransmission)

        def above(self, si, wo):
            return cosine(si.wi) * cosine(wo) < 0

        def eta(self, si):
            return dr.select(cosine(si.wi) > 0, mi.Float(1.5), 1 / 1.5)

        def factor(self, ctx, si):
            up = cosine(si.wi) < 0
            up = ~up if ctx.mode == radiance else up
            return dr.select(up, 1 / 1.5**2, mi.Float(1))

        def values(self, si, wo):
            return self.kd * dr.inv_pi * dr.abs(cosine(wo)), mi.Float(0)

        def value(self, ctx, si, wo):
            return super().value(ctx, si, wo) * self.factor(ctx, si)

        def densities(self, si, wo):
            return dr.inv_pi * dr.abs(cosine(wo)), mi.Float(0)

        def first_direction(self, ctx, si, sample2):
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            return mi.Vector3f(wo.x, wo.y, -dr.mulsign(wo.z, cosine(si.wi)))

        def finish(self, ctx, si, bs, weight):
            bs.eta = self.eta(si)
            return bs, weight

    # ------------------------------------------------- Only in the mode of path tracers

    class RadianceDrawsOneLobe(TwoLobes):
        """A path tracer's highlight is missing, 0.62 of the light is left."""

        def pick(self, ctx, si, sample1):
            both_lobes = all(self.enabled(ctx)) and ctx.mode == radiance
            return mi.Bool(False) if both_lobes else super().pick(ctx, si, sample1)

    class RadianceDrawsTooWide(Lambert):
        """A path tracer has 0.94 of the light of a sky that is brighter above."""

        def first_direction(self, ctx, si, sample2):
            wo = super().first_direction(ctx, si, sample2)
            wide = mi.warp.square_to_uniform_hemisphere(sample2)
            return wide if ctx.mode == radiance else wo

    class RadiancePdfWithEta2(Sheet):
        """Light sampling and BSDF sampling of `path` do not add up to the whole."""

        def pdf(self, ctx, si, wo, active=True):
            scale = self.factor(ctx, si) if ctx.mode == radiance else 1
            return super().pdf(ctx, si, wo, active) * scale

    class RadianceWeightLess(Sheet):
        """All that a path tracer sees through the sheet is too dark by a tenth."""

        def finish(self, ctx, si, bs, weight):
            bs, weight = super().finish(ctx, si, bs, weight)
            return bs, weight * (0.9 if ctx.mode == radiance else 1)

    class EvalPdfOfOneMode(Sheet):
        """`path` lights the lower side with 2.25 times the light of lamps."""

        def eval_pdf(self, ctx, si, wo, active=True):
            other = mi.BSDFContext(mi.TransportMode.Importance)
            other.component, other.type_mask = ctx.component, ctx.type_mask
            return self.eval(other, si, wo, active), self.pdf(ctx, si, wo, active)

    class EtaInverted(Sheet):
        """Russian roulette ends paths that carry most: noise in all that is below."""

        def eta(self, si):
            return 1 / super().eta(si)

    class EtaAlwaysOne(Sheet):
        """Russian roulette takes radiance for flux: noise."""

        def eta(self, si):
            return mi.Float(1)

    # ----------------------------------------------------- After a change of parameters

    class Cached(TwoLobes):
        """Right: what is drawn is prepared when parameters change."""

        def load(self, props):
            self.kd = mi.Float(props.get("kd", 0.5))
            self.exponent = mi.Float(props.get("exponent", 20.0))
            self.prepare()
            self.old = mi.Float(self.exponent), mi.Float(self.kd)

        def prepare(self):
            self.steep = 1 / (self.exponent + 1)

        def parameters_changed(self, keys=()):
            self.prepare()

        def traverse(self, callback):
            kind = mi.ParamFlags.Differentiable
            callback.put("kd", self.kd, kind)
            callback.put("exponent", self.exponent, kind)

        def with_old(self, function, *arguments):
            new = self.exponent, self.kd
            self.exponent, self.kd = self.old
            answer = function(*arguments)
            self.exponent, self.kd = new
            return answer

    class StalePdf(Cached):
        """After an edit in a viewer, highlights of lamps are too bright or too dim."""

        def pdf(self, ctx, si, wo, active=True):
            return self.with_old(super().pdf, ctx, si, wo, active)

    class StaleSample(Cached):
        """After an edit, highlights in the light of the sky are biased."""

        def second_direction(self, ctx, si, sample2):
            return self.with_old(super().second_direction, ctx, si, sample2)

    class StaleEval(Cached):
        """After an edit, the light of lamps is that of before."""

        def eval(self, ctx, si, wo, active=True):
            return self.with_old(super().eval, ctx, si, wo, active)

    class StaleWeight(Cached):
        """After an edit, the light of the sky is that of before."""

        def weight(self, ctx, si, bs):
            return self.with_old(super().weight, ctx, si, bs)

    class StaleTable(right_bsdfs.published()["Tabulated"]):
        """After an edit of a measured table, the light of the sky is biased."""

        def parameters_changed(self, keys=()):
            ends = getattr(self, "ends", None)
            super().parameters_changed(keys)
            self.ends = self.ends if ends is None else ends

    class UpdateRaises(Cached):
        """No parameter can be changed between two images."""

        def parameters_changed(self, keys=()):
            raise RuntimeError("no update of this")

    class SpectrumParameter(Lambert):
        """Right: its parameter is a spectrum of its own."""

        def load(self, props):
            self.colour = mi.Spectrum(0.4)

        def traverse(self, callback):
            callback.put("colour", self.colour, mi.ParamFlags.Differentiable)

        def value(self, ctx, si, wo):
            on = self.enabled(ctx)[0]
            return self.colour * (dr.inv_pi * cosine(wo)) if on else mi.Spectrum(0)

    class GradientOfASpectrumDetached(SpectrumParameter):
        """An optimiser never changes the colour."""

        def value(self, ctx, si, wo):
            return dr.detach(super().value(ctx, si, wo))

    # ---------------------------------------------------------------- What is asked for

    def deaf(ctx):
        other = mi.BSDFContext(ctx.mode)
        other.component = ctx.component
        return other

    class EvalDeafToTypeMask(TwoLobes):
        """An integrator that asks for diffuse light only gets highlights too."""

        def eval(self, ctx, si, wo, active=True):
            return super().eval(deaf(ctx), si, wo, active)

    class SampleDeafToTypeMask(TwoLobes):
        """An integrator that asks for diffuse light only follows highlights too."""

        def sample(self, ctx, si, sample1, sample2, active=True):
            return super().sample(deaf(ctx), si, sample1, sample2, active)

    class PdfDeafToTypeMask(TwoLobes):
        """An integrator that asks for diffuse light only weighs it by the other pdf."""

        def pdf(self, ctx, si, wo, active=True):
            return super().pdf(deaf(ctx), si, wo, active)

    class AlbedoWithoutPi(Lambert):
        """The albedo that a denoiser is guided by is 0.16 for 0.5."""

        def eval_diffuse_reflectance(self, si, active=True):
            return mi.Spectrum(self.kd * dr.inv_pi)

    class AlbedoNegative(TwoLobes):
        """The albedo that a denoiser is guided by is below 0."""

        def eval_diffuse_reflectance(self, si, active=True):
            return mi.Spectrum(self.kd - 1)

    # -------------------------------------------------- The place of a ray in the array

    def rare(wo):
        return dr.arange(mi.UInt32, dr.width(wo)) % 64 == 5

    class EvalByLane(TwoLobes):
        """Every 64th pixel is dark where lamps light it."""

        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, wo, active) & ~rare(wo)

    class PdfByLane(TwoLobes):
        """Every 64th pixel is too bright where lamps light it."""

        def pdf(self, ctx, si, wo, active=True):
            return super().pdf(ctx, si, wo, active) * dr.select(rare(wo), 0.5, 1.0)

    # -------------------------------------------------------- Some degrees of incidence

    class EvalInASector(TwoLobes):
        """A dark wedge in the light of lamps on everything that is curved."""

        def eval(self, ctx, si, wo, active=True):
            wrong = within(degrees(si)[1], 176, 190)
            return super().eval(ctx, si, wo, active) * dr.select(wrong, 0.5, 1.0)

    class PdfInASector(TwoLobes):
        """A wedge in which the light of the sky is too dark by a third."""

        def density(self, ctx, si, wo):
            wrong = within(degrees(si)[1], 60, 75)
            return super().density(ctx, si, wo) * dr.select(wrong, 1.5, 1.0)

    class EvalInABand(TwoLobes):
        """A dark ring in the light of lamps on a sphere."""

        def eval(self, ctx, si, wo, active=True):
            wrong = within(degrees(si)[0], 50, 54)
            return super().eval(ctx, si, wo, active) * dr.select(wrong, 0.7, 1.0)

    class WeightInABand(TwoLobes):
        """A bright ring in the light of the sky on a sphere."""

        def weight(self, ctx, si, bs):
            wrong = within(degrees(si)[0], 20, 23)
            return super().weight(ctx, si, bs) * dr.select(wrong, 1.3, 1.0)

    class SampleInABand(Lambert):
        """A ring on a sphere where light from above the horizon counts too much."""

        def first_direction(self, ctx, si, sample2):
            wo = super().first_direction(ctx, si, sample2)
            wide = mi.warp.square_to_uniform_hemisphere(sample2)
            return dr.select(within(degrees(si)[0], 62, 66), wide, wo)

    class SampledPdfInABand(TwoLobes):
        """A ring in which lamps that are hit count half."""

        def finish(self, ctx, si, bs, weight):
            bs.pdf *= dr.select(within(degrees(si)[0], 52, 55), 0.3, 1.0)
            return bs, weight

    # --------------------------------------------------------- The surface in the world

    class CosineOfTheWorld(Lambert):
        """The light of lamps is right on the floor only."""

        def eval(self, ctx, si, wo, active=True):
            value = self.kd * dr.inv_pi * dr.maximum(dr.dot(si.sh_frame.n, wo), 0)
            return mi.Spectrum(value) & (active & self.above(si, wo))

    class LobeByPlace(TwoLobes):
        """Every point is all diffuse or all glossy in the light of the sky."""

        def pick(self, ctx, si, sample1):
            number = 1e3 * dr.sin(12.9898 * si.p.x + 78.233 * si.p.y + si.uv.x)
            return number - dr.floor(number) < self.share(ctx, si)

    # ------------------------------------------------------------------------ Two lobes

    class PdfOfAnotherMixture(TwoLobes):
        """Light sampling and BSDF sampling of `path` do not add up to the whole."""

        def pdf(self, ctx, si, wo, active=True):
            self.choice = 1 - TwoLobes.choice
            value = super().pdf(ctx, si, wo, active)
            self.choice = TwoLobes.choice
            return value

    class PdfLobeWithoutNorm(TwoLobes):
        """Lamps in the highlight are too bright."""

        def pdf(self, ctx, si, wo, active=True):
            first, second = self.densities(si, wo)
            second *= 0.5
            value = dr.lerp(first, second, self.share(ctx, si))
            return dr.select(active & self.above(si, wo), value, 0)

    def glass(**others):
        inside = {"type": "roughdielectric", "alpha": 0.4, "distribution": "ggx"}
        return mi.load_dict(inside | others)

    class WrappedGlass(mi.BSDF):
        """Right: rough glass of Mitsuba's own."""

        def __init__(self, props):
            super().__init__(props)
            self.inner = glass()
            self.other = glass(int_ior=1.000277, ext_ior=1.5046)
            self.m_components = [self.inner.flags(i) for i in range(2)]
            self.m_flags = self.inner.flags()

        def sample(self, ctx, si, sample1, sample2, active=True):
            return self.inner.sample(ctx, si, sample1, sample2, active)

        def eval(self, ctx, si, wo, active=True):
            return self.inner.eval(ctx, si, wo, active)

        def pdf(self, ctx, si, wo, active=True):
            return self.inner.pdf(ctx, si, wo, active)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return "WrappedGlass[]"

    class PdfOfOtherHalfVector(WrappedGlass):
        """Lamps behind frosted glass are too bright at its edges."""

        def pdf(self, ctx, si, wo, active=True):
            own = super().pdf(ctx, si, wo, active)
            through = si.wi.z * wo.z < 0
            other = self.other.pdf(ctx, si, wo, active)
            return dr.select(through, other, own)

    class PdfUnset(TwoLobes):
        """Lamps that BSDF sampling hits are lost: highlights of large lamps."""

        def finish(self, ctx, si, bs, weight):
            bs.pdf = 0
            return bs, weight

    class AzimuthOfTheChoice(TwoLobes):
        """Highlights have a dark side."""

        def sample(self, ctx, si, sample1, sample2, active=True):
            return super().sample(
                ctx, si, sample1, mi.Point2f(sample2.x, sample1), active
            )

    class PerMilleLost(Lambert):
        """The light of the sky is 0.5 % too low, from a wedge."""

        def finish(self, ctx, si, bs, weight):
            phi = dr.atan2(bs.wo.y, bs.wo.x)
            return bs, weight & ~within(phi, 1.0, 1.0 + 0.005 * dr.two_pi)

    class SampleOfAnotherExponent(Lambert):
        """The light of the sky and of lamps is too low."""

        lobe = 4.0

        def density(self, ctx, si, wo):
            cosines = dr.power(dr.maximum(cosine(wo), 0), self.lobe)
            return (self.lobe + 1) / dr.two_pi * cosines

        def first_direction(self, ctx, si, sample2):
            z = dr.power(sample2.x, 1 / (self.lobe + 2))
            sin, cos = dr.sincos(dr.two_pi * sample2.y)
            across = dr.safe_sqrt(1 - z * z)
            return mi.Vector3f(across * cos, across * sin, z)

    class WeightClamped(TwoLobes):
        """Highlights in the light of the sky are flattened."""

        def weight(self, ctx, si, bs):
            return dr.minimum(super().weight(ctx, si, bs), 0.7)

    class WeightNanRarely(TwoLobes):
        """White pixels."""

        def finish(self, ctx, si, bs, weight):
            return bs, dr.select(bs.wo.z > 0.999, dr.nan, weight)

    class WeightKept(Lambert):
        """In the light of the sky, up to 2.5 times too bright at grazing incidence."""

        components = (diffuse | front | asymmetric,)

        def values(self, si, wo):
            first, second = super().values(si, wo)
            return first * (0.4 + 0.6 * dr.square(cosine(si.wi))), second

        def weight(self, ctx, si, bs):
            return mi.Spectrum(self.kd)

    # ---------------------------------------------------------------------------- Sides

    class EvalLitBelow(Lambert):
        """Lamps below the floor shine through it."""

        def eval(self, ctx, si, wo, active=True):
            value = self.kd * dr.inv_pi * dr.abs(cosine(wo))
            on = active & (cosine(si.wi) > 0) & self.enabled(ctx)[0]
            return mi.Spectrum(value) & on

    class PdfOfBothSides(Sheet):
        """Light sampling and BSDF sampling of `path` do not add up to the whole."""

        def density(self, ctx, si, wo):
            return 0.5 * super().density(ctx, si, wo)

        def weight(self, ctx, si, bs):
            return mi.Spectrum(self.kd) * self.factor(ctx, si)

    # ------------------------------------------------ Discrete lobes beside smooth ones

    class Clear(TwoLobes):
        """Right: a mirror above a Lambertian, one of both by chance."""

        components = (diffuse | front, int(flags.DeltaReflection) | front)
        kinds = (flags.DiffuseReflection, flags.DeltaReflection)
        ks = 0.3

        def discrete(self, si):
            return mi.reflect(si.wi)

        def mirror_weight(self, ctx, si):
            return self.ks / self.share(ctx, si)

        def lost(self, ctx, si):
            return 1 - self.share(ctx, si)

        def values(self, si, wo):
            return self.kd * dr.inv_pi * cosine(wo), mi.Float(0)

        def density(self, ctx, si, wo):
            return self.lost(ctx, si) * dr.inv_pi * cosine(wo)

        def second_direction(self, ctx, si, sample2):
            return self.discrete(si)

        def weight(self, ctx, si, bs):
            self.of_mirror = bs.sampled_component == 1
            share = self.share(ctx, si)
            lambert = self.kd / (1 - share)
            bs.pdf = dr.select(self.of_mirror, share, bs.pdf)
            mirror = self.mirror_weight(ctx, si)
            return mi.Spectrum(dr.select(self.of_mirror, mirror, lambert))

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, _ = super().sample(ctx, si, sample1, sample2, active)
            ok = active & self.lit(si) & (bs.pdf > 0)
            ok &= self.of_mirror | self.above(si, bs.wo)
            alive = ok & any(self.enabled(ctx))
            return bs, dr.select(alive, self.weight(ctx, si, bs), 0)

        def lit(self, si):
            return cosine(si.wi) > 0

    class DiscreteWeightTooHigh(Clear):
        """Mirror images are 2.5 times too bright."""

        def mirror_weight(self, ctx, si):
            return mi.Float(self.ks) / dr.square(self.share(ctx, si))

    class PdfWithoutShareOfMirror(Clear):
        """Light sampling and BSDF sampling of `path` do not add up to the whole."""

        def pdf(self, ctx, si, wo, active=True):
            on = active & self.above(si, wo) & self.enabled(ctx)[0]
            return dr.select(on, dr.inv_pi * cosine(wo), 0)

    class NumberOfTheMirror(Clear):
        """Metal under a coat is too bright: it knows no lobes alone, which would tell.

        Its microfacets, as others, lose what they send below the horizon.
        """

        choice = 0.04

        def load(self, props):
            metal = {"type": "roughconductor", "material": "none", "alpha": 0.5}
            self.metal = mi.load_dict(metal | {"distribution": "ggx"})

        def enabled(self, ctx):
            return [True, True]

        def value(self, ctx, si, wo):
            return self.metal.eval(mi.BSDFContext(), si, wo) * 0.6

        def density(self, ctx, si, wo):
            return self.lost(ctx, si) * self.metal.pdf(mi.BSDFContext(), si, wo)

        def first_direction(self, ctx, si, sample2):
            return self.metal.sample(mi.BSDFContext(), si, 0, sample2)[0].wo

        def weight(self, ctx, si, bs):
            mirror = super().weight(ctx, si, bs)
            own = self.value(ctx, si, bs.wo) / bs.pdf
            return dr.select(self.of_mirror, mirror, own)

        def sample(self, ctx, si, sample1, sample2, active=True):
            return super().sample(ctx, si, sample2.x, sample2, active)

    class Opacity(Clear):
        """Right: 0.3 passes straight on, the rest meets a Lambertian."""

        components = (diffuse | both, int(flags.Null) | both)
        kinds = (flags.DiffuseReflection, flags.Null)

        def discrete(self, si):
            return -si.wi

        def lit(self, si):
            return cosine(si.wi) != 0

        def above(self, si, wo):
            return cosine(si.wi) * cosine(wo) > 0

        def values(self, si, wo):
            return self.kd * dr.inv_pi * dr.abs(cosine(wo)), mi.Float(0)

        def density(self, ctx, si, wo):
            return self.lost(ctx, si) * dr.inv_pi * dr.abs(cosine(wo))

        def first_direction(self, ctx, si, sample2):
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            return mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, cosine(si.wi)))

        def eval_null_transmission(self, si, active=True):
            return mi.Spectrum(self.ks) & active

    class NullSaysOpacity(Opacity):
        """Shadows of leaves are too bright in `volpath`."""

        def eval_null_transmission(self, si, active=True):
            return mi.Spectrum(1 - self.ks) & active

    class EvalForgetsOpacity(Opacity):
        """Leaves are too bright in the light of lamps."""

        def eval(self, ctx, si, wo, active=True):
            return super().eval(ctx, si, wo, active) / (1 - self.ks)

    class DrawnFacets(Lambert):
        """Right: each sample meets a mirror that is drawn, and nothing asks for it."""

        components = (int(flags.DeltaReflection) | front,)
        kinds = (flags.DeltaReflection, flags.Null)

        def first_direction(self, ctx, si, sample2):
            facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, 0.3, False)
            return mi.Vector3f(mi.reflect(si.wi, facets.sample(si.wi, sample2)[0]))

        def density(self, ctx, si, wo):
            return mi.Float(1)

        def weight(self, ctx, si, bs):
            return mi.Spectrum(0.6)

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

    class FacetsLitTwice(DrawnFacets):
        """Lamps are counted twice: sampled, and where a drawn mirror meets them."""

        def first_direction(self, ctx, si, sample2):
            return mi.warp.square_to_cosine_hemisphere(sample2)

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0.6 * dr.inv_pi * cosine(wo)) & (
                active & self.above(si, wo)
            )

    # ------------------------------------------------------------------ Colours, in rgb

    class Coloured(Lambert):
        colour = (0.2, 0.5, 0.8)

        def as_spectrum(self, colour):
            return mi.Spectrum(colour) if mi.is_rgb else mi.Spectrum(colour[0])

        def value(self, ctx, si, wo):
            on = self.enabled(ctx)[0]
            return self.as_spectrum(self.colour) * (dr.inv_pi * cosine(wo)) * float(on)

    class WeightOfOtherColours(Coloured):
        """Red and blue are exchanged in the light of the sky."""

        def weight(self, ctx, si, bs):
            return self.as_spectrum(self.colour[::-1])

    class EvalOfOtherColours(Coloured):
        """Red and blue are exchanged in the light of lamps."""

        def weight(self, ctx, si, bs):
            return self.as_spectrum(self.colour)

        def value(self, ctx, si, wo):
            on = self.enabled(ctx)[0]
            colour = self.as_spectrum(self.colour[::-1])
            return colour * (dr.inv_pi * cosine(wo)) * float(on)

    # --------------------------------------------------------------- Right, and unusual

    class MaskInPlace(TwoLobes):
        """It changes the mask that it gets, once it has what it needs of it."""

        def sample(self, ctx, si, sample1, sample2, active=True):
            answer = super().sample(ctx, si, sample1, sample2, mi.Bool(active))
            active &= self.pick(ctx, si, sample1)
            return answer

    class DarkInFront(TwoLobes):
        """Diffuse in front, glossy from behind."""

        components = (diffuse | front, glossy | back)

        def share(self, ctx, si):
            first, second = self.enabled(ctx)
            behind = cosine(si.wi) < 0
            return dr.select(behind, mi.Float(float(second)), 1 - float(first))

        def above(self, si, wo):
            return cosine(si.wi) * cosine(wo) > 0

        def values(self, si, wo):
            first, second = super().values(si, wo)
            behind = cosine(si.wi) < 0
            second = dr.abs(second)
            return dr.select(behind, 0, first), dr.select(behind, second, 0)

        def density(self, ctx, si, wo):
            first, second = self.densities(si, wo)
            on = self.enabled(ctx)
            behind = cosine(si.wi) < 0
            return dr.select(behind, second * float(on[1]), first * float(on[0]))

    class WeightOfOneLane(Lambert):
        """The same weight for all rays, in one number."""

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            return bs, mi.Spectrum(self.kd) & (weight[0] > 0)

    class StepInWo(Lambert):
        """Twice as bright on one side, which the other direction does not know."""

        components = (diffuse | front | int(flags.Anisotropic),)

        def step(self, si, wo):
            return dr.select((wo.x > 0.2) & (si.wi.x > 0.2), 1.5, mi.Float(0.5))

        def values(self, si, wo):
            first, second = super().values(si, wo)
            return first * self.step(si, wo), second

    class StepInWi(StepInWo):
        def step(self, si, wo):
            same = (wo.y > 0.1) == (si.wi.y > 0.1)
            return dr.select(same, 1.2, mi.Float(0.1))

    class Checks(TwoLobes):
        """Checks in uv, with another probability of the lobes on each."""

        def odd(self, si):
            cell = mi.Int32(dr.floor(10 * si.uv.x) + dr.floor(7 * si.uv.y))
            return (cell & 1) == 1

        def share(self, ctx, si):
            share = super().share(ctx, si)
            both_lobes = all(self.enabled(ctx))
            return dr.select(self.odd(si), 0.7, share) if both_lobes else share

        def values(self, si, wo):
            first, second = super().values(si, wo)
            return first * dr.select(self.odd(si), 0.3, 1.0), second

    class Paper(TwoLobes):
        """Reflects and transmits evenly, both sides alike."""

        kinds = (flags.DiffuseReflection, flags.DiffuseTransmission)
        components = (diffuse | both, int(flags.DiffuseTransmission) | both)

        def above(self, si, wo):
            return cosine(si.wi) * cosine(wo) != 0

        def values(self, si, wo):
            value = dr.inv_pi * dr.abs(cosine(wo))
            same = cosine(si.wi) * cosine(wo) > 0
            return (
                dr.select(same, self.kd * value, 0),
                dr.select(same, 0, self.ks * value),
            )

        def densities(self, si, wo):
            value = dr.inv_pi * dr.abs(cosine(wo))
            same = cosine(si.wi) * cosine(wo) > 0
            return dr.select(same, value, 0), dr.select(same, 0, value)

        def first_direction(self, ctx, si, sample2):
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            return mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, cosine(si.wi)))

        def second_direction(self, ctx, si, sample2):
            wo = self.first_direction(ctx, si, sample2)
            return mi.Vector3f(wo.x, wo.y, -wo.z)

    class Slab(Sheet):
        """A sheet whose transmission falls with both angles."""

        def values(self, si, wo):
            first, second = super().values(si, wo)
            return first * dr.exp(-1 / dr.abs(si.wi.z) - 1 / dr.abs(wo.z)), second

    class WideForNarrow(TwoLobes):
        """A narrow lobe, drawn as if it were wide."""

        components = (glossy | front,)
        kinds = (flags.GlossyReflection, flags.Null)
        kd = 0.0

        def enabled(self, ctx):
            return [ctx.is_enabled(self.kinds[0], 0), False]

        def value(self, ctx, si, wo):
            lobe = super().values(si, wo)[1]
            return mi.Spectrum(lobe if self.enabled(ctx)[0] else 0)

    class Lossy(Lambert):
        """Half of the numbers give no direction, and `pdf` knows."""

        def first_direction(self, ctx, si, sample2):
            x = 2 * sample2.x
            inside = mi.Point2f(x, sample2.y)
            wo = mi.warp.square_to_uniform_hemisphere(inside)
            return dr.select(x < 1, wo, mi.Vector3f(0, 0, -1))

        def densities(self, si, wo):
            return mi.Float(0.5 * dr.inv_two_pi), mi.Float(0)

    class Dim(TwoLobes):
        """A millionth of the light."""

        kd, ks = 5e-7, 3e-7

    class Asymmetric(TwoLobes):
        """Not reciprocal, and declared so."""

        components = (diffuse | front | asymmetric, glossy | front | asymmetric)

        def values(self, si, wo):
            first, second = super().values(si, wo)
            return first * (0.4 + 0.6 * dr.square(cosine(si.wi))), second

    class Table(Lambert):
        """Its reflectance is a tensor over the angle of incidence."""

        def load(self, props):
            self.values_of = mi.TensorXf(mi.Float(0.2, 0.5, 0.6, 0.5), (4,))
            self.m_flags |= asymmetric
            self.m_components = [self.m_flags]

        def traverse(self, callback):
            callback.put("table", self.values_of, mi.ParamFlags.Differentiable)

        def values(self, si, wo):
            index = mi.UInt32(dr.clip(4 * cosine(si.wi), 0, 3.5))
            found = dr.gather(mi.Float, self.values_of.array, index)
            return found * dr.inv_pi * cosine(wo), mi.Float(0)

    class Switches(TwoLobes):
        """Parameters that are no real numbers."""

        def load(self, props):
            self.on, self.n, self.name = True, mi.UInt32(3), "paint"
            self.scale = mi.ScalarFloat(0.5)

        def traverse(self, callback):
            kind = mi.ParamFlags.NonDifferentiable
            for name in ("on", "n", "scale"):
                callback.put(name, getattr(self, name), kind)

        def values(self, si, wo):
            first, second = super().values(si, wo)
            level = mi.Float(self.n) / 3 * float(self.scale)
            return first * dr.minimum(level, 1), second

    class AtTheLimit(Cached):
        """A parameter at the end of its range, beyond which it is refused."""

        def load(self, props):
            self.exponent = mi.Float(20)
            self.kd = mi.Float(1.0)
            self.prepare()

        def parameters_changed(self, keys=()):
            if dr.any(self.kd > 1):
                raise ValueError("kd must be at most 1")
            self.prepare()

        def values(self, si, wo):
            first, second = super().values(si, wo)
            return 0.6 * first, second

    class RetroAndLambert(TwoLobes):
        """A lobe about the direction to the source."""

        def power(self, si, wo):
            return dr.power(dr.maximum(dr.dot(wo, si.wi), 0), self.exponent)

        def second_direction(self, ctx, si, sample2):
            turned = mi.SurfaceInteraction3f(si)
            turned.wi = mi.reflect(si.wi)
            return super().second_direction(ctx, turned, sample2)

    class Stripes(Lambert):
        """Fine grooves: light and dark in stripes of both directions."""

        components = (diffuse | front | int(flags.Anisotropic),)

        def values(self, si, wo):
            first, second = super().values(si, wo)
            h = si.wi.x + wo.x
            return first * (0.5 + 0.5 * dr.square(dr.sin(10 * h))), second

    class PythonNumbers(TwoLobes):
        """Parameters in Python's own numbers."""

        def load(self, props):
            self.kd = float(props.get("kd", 0.5))

        def traverse(self, callback):
            callback.put("kd", self.kd, mi.ParamFlags.NonDifferentiable)

    class Flakes(TwoLobes):
        """Sparkles by place: another direction of the lobe in each cell of uv."""

        components = (diffuse | front, glossy | front | int(flags.Anisotropic))

        def load(self, props):
            self.m_components = [one | asymmetric for one in self.components]
            self.m_flags |= asymmetric

        def power(self, si, wo):
            return dr.power(dr.maximum(dr.dot(wo, self.axis(si)), 0), self.exponent)

        def axis(self, si):
            cell = dr.floor(50 * si.uv.x) + 57 * dr.floor(50 * si.uv.y)
            number = 43758.5 * dr.sin(0.37 * cell)
            number -= dr.floor(number)
            return dr.normalize(
                mi.reflect(si.wi) + mi.Vector3f(0.4 * number - 0.2, 0, 0)
            )

        def second_direction(self, ctx, si, sample2):
            turned = mi.SurfaceInteraction3f(si)
            turned.wi = mi.reflect(self.axis(si))
            return super().second_direction(ctx, turned, sample2)

    class PhaseOfWi(TwoLobes):
        """The probability of a lobe rises with the angle of incidence."""

        def share(self, ctx, si):
            share = super().share(ctx, si)
            f = 0.2 + 0.7 * (1 - dr.abs(cosine(si.wi))) ** 5
            return f if all(self.enabled(ctx)) else share

    class OwnEvalPdfSample(TwoLobes):
        """Nothing calls it in this version of Mitsuba."""

        def eval_pdf_sample(self, ctx, si, wo, sample1, sample2, active=True):
            value, pdf = self.eval_pdf(ctx, si, wo, active)
            bs, weight = self.sample(ctx, si, sample1, sample2, active)
            return 2 * value, pdf, bs, weight

    class FirstNumberOnly(Lambert):
        """Azimuth of `sample1`, and the second number of `sample2` is not used."""

        def sample(self, ctx, si, sample1, sample2, active=True):
            pair = mi.Point2f(sample2.x, sample1)
            return super().sample(ctx, si, sample1, pair, active)

        def first_direction(self, ctx, si, sample2):
            z = dr.safe_sqrt(sample2.x)
            sin, cos = dr.sincos(dr.two_pi * sample2.y)
            across = dr.safe_sqrt(1 - sample2.x)
            return mi.Vector3f(across * cos, across * sin, z)

    class LitWithinACone(Lambert):
        """A louvre: black unless both directions are near to the normal."""

        def above(self, si, wo):
            return (cosine(si.wi) > 0.5) & (cosine(wo) > 0.5)

        def densities(self, si, wo):
            return dr.inv_pi * cosine(wo) / 0.75, mi.Float(0)

        def first_direction(self, ctx, si, sample2):
            z = dr.sqrt(0.25 + 0.75 * sample2.x)
            sin, cos = dr.sincos(dr.two_pi * sample2.y)
            across = dr.safe_sqrt(1 - z * z)
            return mi.Vector3f(across * cos, across * sin, z)

    found = [one for one in locals().values() if isinstance(one, type)]
    plain_bsdf.register(found)
