# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Broken BSDFs, a few phase functions and one with Mueller matrices, by dimension.

Each has one mistake, or two where the name of the guilty function is what is asked, and
is right wherever a flat, unmoved, untextured square of one wavefront is looked at.
`BROKEN` declares of each its dimension, the functions that may be named, the properties
of which one should fail, and what it biases. Classes are mixins on
:func:`plain_bsdf.plain`; :func:`load` makes one for the variant that is set.
"""

from dataclasses import dataclass
from functools import partial

import broken_phase_functions
import drjit as dr
import mitsuba as mi
from plain_bsdf import lobes, name_of, over, plain

VARIANTS = {
    "mono": "llvm_ad_mono",
    "spectral": "llvm_ad_spectral",
    "polarised": "llvm_ad_mono_polarized",
}


@dataclass(frozen=True)
class Declaration:
    """What is known of a plugin before it is looked at.

    `kind` is "bsdf" or "phase", `variant` a key of `VARIANTS`; names are separated by
    spaces.
    """

    cls: type
    dimension: str
    functions: str
    properties: str
    biases: str
    kind: str = "bsdf"
    variant: str = "mono"


BROKEN = {}


def declare(table, *words, **options):
    """Decorator that enters a class into a table."""

    def enter(cls):
        table[name_of(cls)] = Declaration(cls, *words, **options)
        return cls

    return enter


broken = partial(declare, BROKEN)


def load(declaration):
    """Plugin of the variant that is set, as a dictionary."""
    name = name_of(declaration.cls)
    if declaration.kind == "phase":
        base = broken_phase_functions._classes()["right_lobe"]
        mi.register_phase(name, over(declaration.cls, base))
    else:
        mi.register_bsdf(name, over(declaration.cls, plain()))
    return {"type": name}


# ------------------------------------------------------------------------- right bases


class Grey:
    """Lambertian with a parameter."""

    def load(self, props):
        self.reflectance = mi.Float(props.get("reflectance", 0.6))

    def traverse(self, callback):
        kind = mi.ParamFlags.Differentiable
        callback.put("reflectance", self.reflectance, kind)


class Coat:
    """A Lambertian and microfacets, of which `sample1` picks one."""

    components = lobes("DiffuseReflection GlossyReflection FrontSide")
    ks, share = 0.4, 0.5

    def load(self, props):
        self.kd, self.alpha = mi.Float(0.4), mi.Float(0.3)

    def traverse(self, callback):
        kind = mi.ParamFlags.Differentiable
        callback.put("kd", self.kd, kind)
        callback.put("alpha", self.alpha, kind)

    def facets(self, si):
        return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.alpha, True)

    def glossy(self, si, wo):
        h, facets = dr.normalize(si.wi + wo), self.facets(si)
        return facets.eval(h) * facets.G(si.wi, wo, h) / (4 * si.wi.z)

    def glossy_density(self, si, wo):
        h = dr.normalize(si.wi + wo)
        return self.facets(si).pdf(si.wi, h) / (4 * dr.dot(wo, h))

    def value(self, ctx, si, wo):
        diffuse = self.kd * dr.inv_pi * wo.z
        return mi.Spectrum(diffuse + self.ks * self.glossy(si, wo))

    def density(self, ctx, si, wo):
        return dr.lerp(dr.inv_pi * wo.z, self.glossy_density(si, wo), self.share)

    def direction(self, ctx, si, sample1, sample2):
        h = self.facets(si).sample(si.wi, sample2)[0]
        lambert = mi.warp.square_to_cosine_hemisphere(sample2)
        self.picked = sample1 < self.share
        return dr.select(self.picked, mi.reflect(si.wi, h), lambert)

    def drawn(self, ctx, si, bs):
        flags = mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection
        bs.sampled_type = dr.select(self.picked, *(mi.UInt32(+one) for one in flags))


class Metal(Coat):
    """Microfacets alone."""

    components = lobes("GlossyReflection FrontSide")
    share = 1.0

    def value(self, ctx, si, wo):
        return mi.Spectrum(0.8 * self.glossy(si, wo))


class Brushed:
    """Grooves along x: more light where both directions lean to the same side."""

    components = lobes("DiffuseReflection FrontSide Anisotropic")

    def along(self, si, w):
        return w.x

    def value(self, ctx, si, wo):
        lean = 1 + 0.9 * self.along(si, si.wi) * self.along(si, wo)
        return super().value(ctx, si, wo) * (0.5 * lean)


class Textured:
    """Reflectance of a periodic texture."""

    components = lobes("DiffuseReflection FrontSide SpatiallyVarying")

    def turn(self, x):
        return x - dr.floor(x)

    def value(self, ctx, si, wo):
        return super().value(ctx, si, wo) * (0.3 + 0.7 * self.turn(si.uv.x))


class Spectral:
    """Reflectance that rises with the wavelength."""

    def at(self, si):
        return si.wavelengths

    def value(self, ctx, si, wo):
        return super().value(ctx, si, wo) * (0.2 + 0.8 * (self.at(si) - 380) / 400)


class Veil:
    """Straight through a gauze with the probability `gap`, else a Lambertian."""

    components = lobes("DiffuseReflection FrontSide", "Null FrontSide BackSide")

    def gap(self, si):
        return mi.Float(0.25)

    def value(self, ctx, si, wo):
        on = ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 0)
        return super().value(ctx, si, wo) * (1 - self.gap(si)) * float(on)

    def odds(self, ctx, si):
        both = mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.Null
        on = [ctx.is_enabled(one, i) for i, one in enumerate(both)]
        lit = on[0] & (si.wi.z > 0)
        return dr.select(lit, self.gap(si) if on[1] else 0, float(on[1])), on

    def density(self, ctx, si, wo):
        chance, on = self.odds(ctx, si)
        return (1 - chance) * dr.inv_pi * wo.z * float(on[0])

    def sample(self, ctx, si, sample1, sample2, active=True):
        chance, on = self.odds(ctx, si)
        bs, weight = super().sample(ctx, si, sample1, sample2, active)
        through = (sample1 < chance) & on[1]
        kinds = mi.BSDFFlags.Null, mi.BSDFFlags.DiffuseReflection
        bs.wo = dr.select(through, -si.wi, bs.wo)
        bs.pdf = dr.select(through, chance, bs.pdf)
        bs.sampled_type = dr.select(through, *(mi.UInt32(+one) for one in kinds))
        bs.sampled_component = dr.select(through, mi.UInt32(1), mi.UInt32(0))
        straight = mi.Spectrum(self.gap(si) / chance) & active
        return bs, dr.select(through, straight, weight)

    def eval_null_transmission(self, si, active=True):
        return mi.Spectrum(self.gap(si)) & active


# -------------------------------------------------- fields of the surface interaction


@broken(
    "fields", "eval", "sampled_weight weights", "0.40 of lamps after time 0, not 0.8"
)
class EvalFadesWithTime:
    def eval(self, ctx, si, wo, active=True):
        return super().eval(ctx, si, wo, active) * dr.select(si.time > 0, 0.5, 1.0)


@broken("fields", "pdf", "sampling sampled_pdf", "pdf 1.3 times too wide at t = 10")
class PdfOfDistance(Coat):
    def pdf(self, ctx, si, wo, active=True):
        own = self.alpha
        self.alpha = own * dr.clip(1 + (si.t - 1) / 30, 1, 2)
        found = super().pdf(ctx, si, wo, active)
        self.alpha = own
        return found


@broken(
    "fields", "sample", "sampled_weight weights", "albedo 1.2 below z = -1, not 0.8"
)
class WeightOfAFloor:
    def weight(self, ctx, si, bs):
        return super().weight(ctx, si, bs) * dr.select(si.p.z < -1, 1.5, 1.0)


@broken(
    "fields", "eval", "sampled_weight weights", "facets show on smooth meshes: 20 %"
)
class CosineOfTheFace:
    def eval(self, ctx, si, wo, active=True):
        cosine = dr.maximum(dr.dot(si.n, si.to_world(wo)), 0)
        lit = active & self.above(si, wo)
        return mi.Spectrum(self.reflectance * dr.inv_pi * cosine) & lit


@broken(
    "fields", "sample", "directions sampling", "a sheared dp_du turns 0.3 rad wrong"
)
class TangentsSheared:
    def direction(self, ctx, si, sample1, sample2):
        x, y, z = super().direction(ctx, si, sample1, sample2)
        s, t = (si.to_local(dr.normalize(one)) for one in (si.dp_du, si.dp_dv))
        return s * x + t * y + mi.Vector3f(0, 0, 1) * z


@broken(
    "fields", "eval", "sampled_weight weights", "grain of lamps across that of the sky"
)
class TangentOfTheMesh(Brushed):
    def eval(self, ctx, si, wo, active=True):
        axis = dr.normalize(si.dp_du)
        self.along = lambda si, w: dr.dot(axis, si.to_world(w))
        found = super().eval(ctx, si, wo, active)
        del self.along
        return found


@broken("fields", "eval", "sampled_weight weights", "odd triangles at half the light")
class EvalByTriangle:
    def eval(self, ctx, si, wo, active=True):
        odd = si.prim_index % 2 == 1
        return super().eval(ctx, si, wo, active) * dr.select(odd, 0.5, 1.0)


@broken("fields", "eval", "sampled_weight weights", "texture stretched outside [0, 1]")
class UvClamped(Textured):
    def eval(self, ctx, si, wo, active=True):
        self.turn = lambda x: dr.clip(x, 0, 1)
        found = super().eval(ctx, si, wo, active)
        del self.turn
        return found


@broken("fields", "sample", "sampled_weight weights", "0.05 for 0.65 at uv.x = -0.5")
class UvTruncated(Textured):
    def weight(self, ctx, si, bs):
        self.turn = lambda x: dr.maximum(x - dr.trunc(x), 0)
        found = super().weight(ctx, si, bs)
        del self.turn
        return found


@broken("fields", "pdf", "sampling sampled_pdf", "a line at the seam, lamps doubled")
class SeamOfTheTexture(Textured):
    def pdf(self, ctx, si, wo, active=True):
        seam = self.turn(si.uv.x) > 1 - 1 / 64
        return dr.select(seam, 0, super().pdf(ctx, si, wo, active))


@broken(
    "fields", "sample", "sampling sampled_pdf", "highlights mirrored in an instance"
)
class MirroredInstance(Coat):
    def direction(self, ctx, si, sample1, sample2):
        wo = super().direction(ctx, si, sample1, sample2)
        turned = dr.dot(dr.cross(si.dp_du, si.dp_dv), si.n) < 0
        return mi.Vector3f(wo.x, dr.select(turned, -wo.y, wo.y), wo.z)


@broken(
    "fields",
    "eval",
    "sampled_weight weights",
    "lamps have one colour",
    variant="spectral",
)
class HeroWavelength(Spectral):
    def eval(self, ctx, si, wo, active=True):
        self.at = lambda si: mi.UnpolarizedSpectrum(si.wavelengths[0])
        found = super().eval(ctx, si, wo, active)
        del self.at
        return found


@broken(
    "fields",
    "pdf",
    "sampling sampled_pdf",
    "deep red 1.6 times as bright in sky",
    variant="spectral",
)
class PdfOfRed(Spectral):
    def pdf(self, ctx, si, wo, active=True):
        red = si.wavelengths[0] > 740
        return super().pdf(ctx, si, wo, active) * dr.select(red, 0.6, 1.0)


# ---------------------------------------------------------------------------- places


@broken("places", "sample", "sampled_weight weights", "one of 64 tiles 1.2, not 0.8")
class OneTile(Textured):
    def weight(self, ctx, si, bs):
        u, v = dr.floor(8 * self.turn(si.uv.x)), dr.floor(8 * self.turn(si.uv.y))
        own = (u == 6) & (v == 1)
        return super().weight(ctx, si, bs) * dr.select(own, 1.5, 1.0)


@broken(
    "places", "pdf sample", "sampling sampled_pdf", "checks in the highlight of sky"
)
class MeanOfAMixture(Coat):
    """Draws by a check of a texture, `pdf` by the mean of both."""

    def direction(self, ctx, si, sample1, sample2):
        own = dr.floor(4 * si.uv.x) + dr.floor(4 * si.uv.y)
        odd = own - 2 * dr.floor(own / 2) == 1
        chance = dr.select(odd, 0.2, 0.8)
        again = dr.select(sample1 < chance, 0.25, 0.75)
        return super().direction(ctx, si, again, sample2)


# ------------------------------------------------------------------------- parameters


@broken("parameters", "pdf", "parameters sampling", "lamps lose 90 % at alpha = 0.003")
class ClampedBelow(Coat):
    def pdf(self, ctx, si, wo, active=True):
        own, self.alpha = self.alpha, dr.maximum(self.alpha, 0.02)
        found = super().pdf(ctx, si, wo, active)
        self.alpha = own
        return found


@broken(
    "parameters", "sample", "parameters sampled_weight", "white stays white: 0.6 of 0.3"
)
class BoundThatGrows(Grey):
    bound = 0.0

    def parameters_changed(self, keys=()):
        self.bound = dr.maximum(self.bound, self.reflectance)

    def weight(self, ctx, si, bs):
        return mi.Spectrum(dr.maximum(self.bound, self.reflectance))


@broken(
    "parameters", "sample", "parameters sampled_weight", "second edit has no effect"
)
class FirstUpdateOnly(Grey):
    updates = 0

    def load(self, props):
        super().load(props)
        self.albedo = mi.Float(self.reflectance)

    def parameters_changed(self, keys=()):
        self.updates += 1
        if self.updates <= 1:
            self.albedo = mi.Float(self.reflectance)

    def weight(self, ctx, si, bs):
        return mi.Spectrum(self.albedo)


@broken(
    "parameters", "eval", "parameters sampled_weight", "0.78 left after eight edits"
)
class ScaledAtEachUpdate(Grey):
    gain = 1.0

    def parameters_changed(self, keys=()):
        self.gain *= 0.97

    def eval(self, ctx, si, wo, active=True):
        return super().eval(ctx, si, wo, active) * dr.opaque(mi.Float, self.gain)


@broken(
    "parameters", "pdf", "parameters sampling", "0.8 of the sky's light at kd = 0.8"
)
class PdfAboveHalf(Coat):
    def pdf(self, ctx, si, wo, active=True):
        found = super().pdf(ctx, si, wo, active)
        return found * dr.select(self.kd > 0.5, 1.25, 1.0)


# -------------------------------------------------------------------------- gradients


@broken("gradients", "eval_pdf", "parameters", "prb: no gradient from lamps, 0 for 1")
class EvalPdfDetached(Grey):
    def eval_pdf(self, ctx, si, wo, active=True):
        return dr.detach(self.eval(ctx, si, wo, active)), self.pdf(ctx, si, wo, active)


@broken("gradients", "pdf", "parameters", "gradients of MIS weights lack their pdf")
class PdfDetached(Coat):
    def pdf(self, ctx, si, wo, active=True):
        return dr.detach(super().pdf(ctx, si, wo, active))


class Through:
    """Lambertian whose reflectance passes an operation with derivatives of its own."""

    forward, backward = 1.0, 1.0

    def value(self, ctx, si, wo):
        ways = self.forward, self.backward

        class Same(dr.CustomOp):
            def eval(self, x):
                return mi.Float(x)

            def forward(self):
                self.set_grad_out(ways[0] * self.grad_in("x"))

            def backward(self):
                if ways[1] is None:
                    raise RuntimeError("backward is not implemented")
                self.set_grad_in("x", ways[1] * self.grad_out())

        own, self.reflectance = self.reflectance, dr.custom(Same, self.reflectance)
        found = super().value(ctx, si, wo)
        self.reflectance = own
        return found


class GreyThrough(Grey, Through):
    """Both, in the order of :func:`plain_bsdf.over`: right."""


@broken("gradients", "eval", "parameters", "prb's backward pass raises")
class BackwardRaises(GreyThrough):
    backward = None


@broken("gradients", "eval", "parameters", "optimisers walk away: -1 for 1")
class BackwardWithWrongSign(GreyThrough):
    backward = -1.0


@broken("gradients", "eval", "parameters", "forward gradients are NaN")
class GradientNan(Grey):
    def value(self, ctx, si, wo):
        none = dr.sqrt(self.reflectance - dr.detach(self.reflectance))
        return super().value(ctx, si, wo) * (1 + dr.opaque(mi.Float, 0.0) * none)


# ---------------------------------------------------------------- lanes and state


def lane(one):
    """Number of each lane."""
    return dr.arange(mi.UInt32, dr.width(one))


@broken("lanes", "eval", "answers sampled_weight", "half of lamps beyond 2^22 rays")
class FourMillionLanes:
    def eval(self, ctx, si, wo, active=True):
        far = lane(wo) >= 1 << 22
        return super().eval(ctx, si, wo, active) * dr.select(far, 0.5, 1.0)


@broken(
    "lanes", "pdf", "answers sampled_pdf sampling", "previews of 500 pixels off by 2"
)
class FewHundredLanes:
    def pdf(self, ctx, si, wo, active=True):
        scale = 2.0 if dr.width(wo) < 1000 else 1.0
        return super().pdf(ctx, si, wo, active) * scale


@broken("lanes", "sample", "answers sampled_weight weights", "a black edge of 0.4 %")
class EndOfTheWavefront:
    def sample(self, ctx, si, sample1, sample2, active=True):
        bs, weight = super().sample(ctx, si, sample1, sample2, active)
        n = dr.width(sample2)
        return bs, weight & (lane(sample2) < n - n // 256)


@broken(
    "state", "eval", "answers sampled_weight", "0.9 of lamps from the 150th call on"
)
class AfterManyCalls:
    calls = 0

    def eval(self, ctx, si, wo, active=True):
        self.calls += 1
        late = dr.opaque(mi.Float, 0.9 if self.calls > 150 else 1.0)
        return super().eval(ctx, si, wo, active) * late


@broken("state", "sample", "answers sampled_weight weights", "0.8 after 3e6 samples")
class AfterManySamples:
    samples = 0

    def sample(self, ctx, si, sample1, sample2, active=True):
        late = dr.opaque(mi.Float, 0.8 if self.samples > 600_000 else 1.0)
        self.samples += dr.width(sample2)
        bs, weight = super().sample(ctx, si, sample1, sample2, active)
        return bs, weight * late


@broken("state", "eval eval_pdf", "answers eval_pdf", "0.95 once a path tracer ran")
class EvalPdfChangesEval:
    known = False

    def eval_pdf(self, ctx, si, wo, active=True):
        self.known = True
        return super().eval_pdf(ctx, si, wo, active)

    def eval(self, ctx, si, wo, active=True):
        late = dr.opaque(mi.Float, 0.95 if self.known else 1.0)
        return super().eval(ctx, si, wo, active) * late


# --------------------------------------------------------- eval_null_transmission


@broken(
    "null", "eval_null_transmission", "delta", "shadows at 0.75 of full light, not 0"
)
class NullClaimed:
    def eval_null_transmission(self, si, active=True):
        return mi.Spectrum(0.75) & active


@broken("null", "eval_null_transmission", "delta", "gauze in shadows without its holes")
class NullWithoutTexture(Veil):
    def gap(self, si):
        odd = dr.floor(2 * si.uv.x) == 1
        return dr.select(odd, 0.4, mi.Float(0.1))

    def eval_null_transmission(self, si, active=True):
        return mi.Spectrum(0.1) & active


# ----------------------------------------------------------------- the right name


@broken("names", "sample", "sampled_weight weights", "0.72 of the sky's light, not 0.8")
class UnguardedPdfAndWeight:
    def pdf(self, ctx, si, wo, active=True):
        return dr.select(active & (wo.z > 0), dr.inv_pi * wo.z, 0)

    def weight(self, ctx, si, bs):
        return 0.9 * super().weight(ctx, si, bs)


@broken("names", "pdf", "sampling sampled_pdf", "highlights of sky 2 times too bright")
class PdfOfOneOfTwo(Coat):
    def pdf(self, ctx, si, wo, active=True):
        found = dr.lerp(dr.inv_pi * wo.z, 0.5 * self.glossy_density(si, wo), self.share)
        return dr.select(active & self.above(si, wo), found, 0)


@broken("names", "pdf", "sampling sampled_pdf", "sparks: a lobe of 3 % is not in pdf")
class PdfWithoutRareLobe(Coat):
    share = 0.03

    def pdf(self, ctx, si, wo, active=True):
        found = (1 - self.share) * dr.inv_pi * wo.z
        return dr.select(active & self.above(si, wo), found, 0)


@broken(
    "names", "sample", "sampled_weight weights", "metal 1.15 times too bright in sky"
)
class WeightWithoutG1(Metal):
    def weight(self, ctx, si, bs):
        return mi.Spectrum(0.8)


# ------------------------------------------- phase functions and Mueller matrices


@broken("fields", "eval", "sampled_weight", "0.5 of lamps after time 0", kind="phase")
class PhaseFadesWithTime:
    def eval_pdf(self, ctx, mei, wo, active=True):
        value, pdf = super().eval_pdf(ctx, mei, wo, active)
        return value * dr.select(mei.time > 0, 0.5, 1.0), pdf


@broken(
    "places", "sample", "sampling", "haze scatters evenly beyond x = 3", kind="phase"
)
class PhaseByPlace:
    def sample(self, ctx, mei, u1, u2, active=True):
        wo = mei.to_world(self.draw(self.g, u2))
        even = mi.warp.square_to_uniform_sphere(u2)
        wo = dr.select(mei.p.x > 3, even, wo)
        return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]


@broken(
    "fields",
    "eval",
    "sampled_weight",
    "lamps are depolarised after time 0: degree 0, not 0.3",
    variant="polarised",
)
class DepolarisesWithTime:
    components = lobes("GlossyReflection FrontSide")

    def load(self, props):
        own = {"type": "roughconductor", "eta": 0.2, "k": 3.0, "alpha": 0.3}
        self.nested = mi.load_dict(own)

    def sample(self, ctx, si, sample1, sample2, active=True):
        return self.nested.sample(ctx, si, sample1, sample2, active)

    def eval(self, ctx, si, wo, active=True):
        m = self.nested.eval(ctx, si, wo, active)
        return dr.select(si.time > 0, mi.depolarizer(m[0, 0]), m)

    def pdf(self, ctx, si, wo, active=True):
        return self.nested.pdf(ctx, si, wo, active)
