# ruff: noqa: ARG002, ARG005 (every method has Mitsuba's signature)
"""Broken BSDFs, a few phase functions and one with Mueller matrices, by dimension.

Each has one mistake, or two where the name of the guilty function is what is asked, and
is right wherever a flat, unmoved, untextured square of one wavefront is looked at.
`BROKEN` declares of each its dimension, the functions that may be named, the properties
of which one should fail, and what it biases. Classes are mixins on
:func:`plain_bsdf.plain`; :func:`load` makes one for the variant that is set.
"""

from dataclasses import dataclass

import broken_phase_functions
import drjit as dr
import mitsuba as mi
from plain_bsdf import lobes, name_of, over, plain

VARIANTS = {
    "mono": "llvm_ad_mono",
    "spectral": "llvm_ad_spectral",
    "polarised": "llvm_ad_mono_polarized",
}


# Properties of which one should fail, by function.
SHOWN_BY = {
    "eval": "sampled_weight weights answers",
    "sample": "sampled_weight weights sampling sampled_pdf directions answers",
    "pdf": "sampling sampled_pdf answers",
    "eval_pdf": "eval_pdf answers",
    "eval_null_transmission": "delta",
}


@dataclass(frozen=True)
class Declaration:
    """What is known of a plugin before it is looked at.

    `kind` is "bsdf" or "phase", `variant` a key of `VARIANTS`; names are separated by
    spaces. Without `properties`, those that show such a function.
    """

    cls: type
    dimension: str
    functions: str
    biases: str
    properties: str = ""
    kind: str = "bsdf"
    variant: str = "mono"

    @property
    def shown_by(self):
        """Properties of which one should fail."""
        each = [SHOWN_BY.get(one, "") for one in self.functions.split()]
        each += ["parameters"] * (self.dimension == "parameters")
        return {*(self.properties or " ".join(each)).split()}


BROKEN = {}


def broken(dimension, functions, biases, **options):
    """Decorator that enters a class into `BROKEN`."""

    def enter(cls):
        BROKEN[name_of(cls)] = Declaration(cls, dimension, functions, biases, **options)
        return cls

    return enter


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

    components = lobes("DiffuseReflection Null FrontSide BackSide")

    def gap(self, si):
        return mi.Float(0.25)

    def value(self, ctx, si, wo):
        return super().value(ctx, si, wo) * (1 - self.gap(si))

    def density(self, ctx, si, wo):
        return dr.inv_pi * wo.z * (1 - self.gap(si))

    def sample(self, ctx, si, sample1, sample2, active=True):
        bs, weight = super().sample(ctx, si, sample1, sample2, active)
        chance = dr.select(si.wi.z > 0, self.gap(si), 1)
        through = sample1 < chance
        kinds = mi.BSDFFlags.Null, mi.BSDFFlags.DiffuseReflection
        bs.wo = dr.select(through, -si.wi, bs.wo)
        bs.pdf = dr.select(through, chance, bs.pdf)
        bs.sampled_type = dr.select(through, *(mi.UInt32(+one) for one in kinds))
        straight = mi.Spectrum(self.gap(si) / chance) & active
        return bs, dr.select(through, straight, weight)

    def eval_null_transmission(self, si, active=True):
        return mi.Spectrum(self.gap(si)) & active


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


def lane(one):
    """Number of each lane."""
    return dr.arange(mi.UInt32, dr.width(one))


def odd(x):
    """Whether the whole part of x is odd, also below 0."""
    return dr.floor(x) - 2 * dr.floor(x / 2) == 1


# --------------------------------------------- one function that is asked otherwise


def add(words, biases, of, base=object, **options):
    """Enter a class by "dimension name function", whose function is ``of``.

    ``of(self, call, si, wo)``, where `call` asks the function of `base`, with other
    attributes if it gets some. Of `sample` it is the weight.
    """
    dimension, name, function = words.split()
    method = "weight" if function == "sample" else function

    def answer(self, ctx, si, wo, *active):
        def call(**attributes):
            before = dict(self.__dict__)
            self.__dict__.update(attributes)
            below = getattr(type(self).__mro__[1], method)
            found = below(self, ctx, si, wo, *active)
            self.__dict__.clear()
            self.__dict__.update(before)
            return found

        return of(self, call, si, wo)

    title = name.title().replace("_", "")
    own = type(title, (base,), {method: answer})
    broken(dimension, function, biases, **options)(own)


def scaled(where, factor=0.5):
    """Function of what is asked for, times a factor where something is so."""
    return lambda self, call, si, wo: (
        call() * dr.select(where(self, si, wo), factor, 1.0)
    )


add(
    "fields eval_fades_with_time eval",
    "0.40 of lamps after time 0, not 0.80",
    scaled(lambda self, si, wo: si.time > 0),
)
add(
    "fields pdf_of_distance pdf",
    "lobe of pdf 1.3 times as wide at t = 10",
    lambda self, call, si, wo: call(
        alpha=self.alpha * dr.clip(1 + (si.t - 1) / 30, 1, 2)
    ),
    Coat,
)
add(
    "fields weight_of_a_floor sample",
    "1.20 of the sky below z = -1, not 0.80",
    scaled(lambda self, si, wo: si.p.z < -1, 1.5),
)
add(
    "fields cosine_of_the_face eval",
    "0.776 of lamps where n is 20 degrees off, not 0.80: facets of smooth meshes",
    lambda self, call, si, wo: (
        call() * dr.maximum(dr.dot(si.n, si.to_world(wo)) / dr.maximum(wo.z, 1e-9), 0)
    ),
)
add(
    "fields tangent_of_the_mesh eval",
    "grain of lamps across that of the sky where dp_du is not sh_frame.s",
    lambda self, call, si, wo: call(
        along=lambda si, w: dr.dot(dr.normalize(si.dp_du), si.to_world(w))
    ),
    Brushed,
)
add(
    "fields eval_by_triangle eval",
    "0.40 of lamps on odd triangles, not 0.80",
    scaled(lambda self, si, wo: si.prim_index % 2 == 1),
)
add(
    "fields uv_clamped eval",
    "0.80 of lamps at uv.x = 1.5, not 0.52",
    lambda self, call, si, wo: call(turn=lambda x: dr.clip(x, 0, 1)),
    Textured,
)
add(
    "fields uv_truncated sample",
    "0.24 of the sky at uv.x = -0.25, not 0.66",
    lambda self, call, si, wo: call(turn=lambda x: dr.maximum(x - dr.trunc(x), 0)),
    Textured,
)
add(
    "fields seam_of_the_texture pdf",
    "pdf integrates to 0 in the last texel: a bright line",
    scaled(lambda self, si, wo: self.turn(si.uv.x) > 1 - 1 / 64, 0.0),
    Textured,
)
add(
    "fields hero_wavelength eval",
    "lamps have one colour, that of the first wavelength",
    lambda self, call, si, wo: call(
        at=lambda si: mi.UnpolarizedSpectrum(si.wavelengths[0])
    ),
    Spectral,
    variant="spectral",
)
add(
    "fields pdf_of_red pdf",
    "pdf integrates to 0.60 beyond 740 nm",
    scaled(lambda self, si, wo: si.wavelengths[0] > 740, 0.6),
    Spectral,
    variant="spectral",
)
add(
    "places one_tile sample",
    "1.04 of the sky on one tile of 64, not 0.70",
    scaled(
        lambda self, si, wo: (
            (dr.floor(8 * self.turn(si.uv.x)) == 6)
            & (dr.floor(8 * self.turn(si.uv.y)) == 1)
        ),
        1.5,
    ),
    Textured,
)
add(
    "parameters clamped_below pdf",
    "lamps in highlights lose 9 of 10 parts at alpha = 0.003",
    lambda self, call, si, wo: call(alpha=dr.maximum(self.alpha, 0.02)),
    Coat,
)
add(
    "parameters pdf_above_half pdf",
    "pdf integrates to 1.25 at kd = 0.8",
    scaled(lambda self, si, wo: self.kd > 0.5, 1.25),
    Coat,
)
add(
    "gradients pdf_detached pdf",
    "derivative of pdf by alpha is 0: MIS weights do not follow",
    lambda self, call, si, wo: dr.detach(call()),
    Coat,
    properties="parameters",
)
add(
    "lanes four_million_lanes eval",
    "0.40 of lamps for rays beyond 2^22, not 0.80",
    scaled(lambda self, si, wo: lane(wo) >= 1 << 22),
)
add(
    "lanes few_hundred_lanes pdf",
    "pdf integrates to 2.00 in previews of 500 pixels",
    scaled(lambda self, si, wo: mi.Bool(dr.width(wo) < 1000), 2.0),
)
add(
    "lanes end_of_the_wavefront sample",
    "0 of the sky for the last 0.4 % of pixels",
    scaled(lambda self, si, bs: lane(bs.wo) >= dr.width(bs.wo) * 255 // 256, 0.0),
)
add(
    "names weight_without_g1 sample",
    "metal sends on 0.73 of the sky, not 0.68, at 37 degrees",
    lambda self, call, si, wo: mi.Spectrum(0.8),
    Metal,
)
add(
    "names pdf_of_one_of_two pdf",
    "pdf integrates to 0.73, not 0.96: lamps in highlights too bright",
    lambda self, call, si, wo: (
        call() - dr.select(self.above(si, wo), 0.25 * self.glossy_density(si, wo), 0)
    ),
    Coat,
)
add(
    "names pdf_without_rare_lobe pdf",
    "sparks in highlights: pdf integrates to 0.97",
    lambda self, call, si, wo: call(glossy_density=lambda si, wo: mi.Float(0)),
    type("Rare", (Coat,), {"share": 0.03}),
)


# ------------------------------------------------------------------------ all others


@broken("fields", "sample", "directions 0.54 to 1.31 long if dp_dv is 45 degrees off")
class TangentsSheared:
    def direction(self, ctx, si, sample1, sample2):
        x, y, z = super().direction(ctx, si, sample1, sample2)
        s, t = (si.to_local(dr.normalize(one)) for one in (si.dp_du, si.dp_dv))
        return s * x + t * y + mi.Vector3f(0, 0, 1) * z


@broken("fields", "sample", "highlights of the sky mirrored in mirrored instances")
class MirroredInstance(Coat):
    def direction(self, ctx, si, sample1, sample2):
        wo = super().direction(ctx, si, sample1, sample2)
        turned = dr.dot(dr.cross(si.dp_du, si.dp_dv), si.n) < 0
        return mi.Vector3f(wo.x, dr.select(turned, -wo.y, wo.y), wo.z)


@broken("places", "pdf sample", "highlights of the sky in checks of 0.4 and 1.6")
class MeanOfAMixture(Coat):
    """Draws by a check of a texture, `pdf` by the mean of both."""

    def direction(self, ctx, si, sample1, sample2):
        dark = odd(dr.floor(4 * si.uv.x) + dr.floor(4 * si.uv.y))
        again = dr.select(sample1 < dr.select(dark, 0.2, 0.8), 0.25, 0.75)
        return super().direction(ctx, si, again, sample2)


@broken("parameters", "sample", "0.60 of the sky after reflectance 0.6, then 0.3")
class BoundThatGrows(Grey):
    bound = 0.0

    def parameters_changed(self, keys=()):
        self.bound = dr.maximum(self.bound, self.reflectance)

    def weight(self, ctx, si, bs):
        return mi.Spectrum(dr.maximum(self.bound, self.reflectance))


@broken("parameters", "sample", "the sky's light does not follow a second edit")
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


@broken("parameters", "eval", "0.78 times the light of lamps after eight edits")
class ScaledAtEachUpdate(Grey):
    gain = 1.0

    def parameters_changed(self, keys=()):
        self.gain *= 0.97

    def eval(self, ctx, si, wo, active=True):
        return super().eval(ctx, si, wo, active) * dr.opaque(mi.Float, self.gain)


GRADIENTS = {"properties": "parameters"}


@broken("gradients", "eval_pdf", "prb: no gradient of lamps, 0 for 1", **GRADIENTS)
class EvalPdfDetached(Grey):
    def eval_pdf(self, ctx, si, wo, active=True):
        return dr.detach(self.eval(ctx, si, wo, active)), self.pdf(ctx, si, wo, active)


@broken("gradients", "eval", "prb's backward pass raises", **GRADIENTS)
class BackwardRaises(GreyThrough):
    backward = None


@broken("gradients", "eval", "optimisers walk away: -1 for 1", **GRADIENTS)
class BackwardWithWrongSign(GreyThrough):
    backward = -1.0


@broken("gradients", "eval", "forward gradients are NaN", **GRADIENTS)
class GradientNan(Grey):
    def value(self, ctx, si, wo):
        none = dr.sqrt(self.reflectance - dr.detach(self.reflectance))
        return super().value(ctx, si, wo) * (1 + dr.opaque(mi.Float, 0.0) * none)


@broken("state", "eval", "0.72 of lamps from the 151st call on, not 0.80")
class AfterManyCalls:
    calls = 0

    def eval(self, ctx, si, wo, active=True):
        self.calls += 1
        late = dr.opaque(mi.Float, 0.9 if self.calls > 150 else 1.0)
        return super().eval(ctx, si, wo, active) * late


@broken("state", "sample", "0.64 of the sky after 600 000 samples, not 0.80")
class AfterManySamples:
    samples = 0

    def sample(self, ctx, si, sample1, sample2, active=True):
        late = dr.opaque(mi.Float, 0.8 if self.samples > 600_000 else 1.0)
        self.samples += dr.width(sample2)
        bs, weight = super().sample(ctx, si, sample1, sample2, active)
        return bs, weight * late


@broken("state", "eval eval_pdf", "0.76 of lamps once a path tracer ran, not 0.80")
class EvalPdfChangesEval:
    known = False

    def eval_pdf(self, ctx, si, wo, active=True):
        self.known = True
        return super().eval_pdf(ctx, si, wo, active)

    def eval(self, ctx, si, wo, active=True):
        late = dr.opaque(mi.Float, 0.95 if self.known else 1.0)
        return super().eval(ctx, si, wo, active) * late


@broken("null", "eval_null_transmission", "shadows at 0.75 of full light, not 0")
class NullClaimed:
    def eval_null_transmission(self, si, active=True):
        return mi.Spectrum(0.75) & active


@broken("null", "eval_null_transmission", "shadows at 0.10 of full light, not 0.40")
class NullWithoutTexture(Veil):
    def gap(self, si):
        return dr.select(odd(2 * si.uv.x), 0.4, mi.Float(0.1))

    def eval_null_transmission(self, si, active=True):
        return mi.Spectrum(0.1) & active


@broken("names", "sample", "0.72 of the sky, not 0.80, beside a pdf that is lit below")
class UnguardedPdfAndWeight:
    def pdf(self, ctx, si, wo, active=True):
        return dr.select(active & (wo.z > 0), dr.inv_pi * wo.z, 0)

    def weight(self, ctx, si, bs):
        return 0.9 * super().weight(ctx, si, bs)


@broken("names", "pdf", "highlights of the sky too wide: every density of a lobe is")
class DensityOfOneOfTwo(Coat):
    def glossy_density(self, si, wo):
        own, self.alpha = self.alpha, 1.3 * self.alpha
        density = super().glossy_density(si, wo)
        self.alpha = own
        return density


@broken("names", "pdf", "highlights of the sky too bright: pdf integrates to 0.97")
class DensityWithoutRareLobe(Coat):
    share = 0.03

    def glossy_density(self, si, wo):
        return mi.Float(0)


# ------------------------------------------- phase functions and Mueller matrices


@broken("fields", "eval", "haze at 0.50 of lamps after time 0", kind="phase")
class PhaseFadesWithTime:
    def eval_pdf(self, ctx, mei, wo, active=True):
        value, pdf = super().eval_pdf(ctx, mei, wo, active)
        return value * dr.select(mei.time > 0, 0.5, 1.0), pdf


@broken("fields", "eval", "haze at 0.80 wherever t is not that of lane 0", kind="phase")
class PhaseOfTheFirstDistance:
    def eval_pdf(self, ctx, mei, wo, active=True):
        value, pdf = super().eval_pdf(ctx, mei, wo, active)
        first = dr.gather(mi.Float, mei.t, 0 * lane(mei.t))
        return value * dr.select(mei.t == first, 1.0, 0.8), pdf


@broken("fields", "pdf", "MIS weights of haze near tilted normals", kind="phase")
class PhaseDensityByNormal:
    def sample(self, ctx, mei, u1, u2, active=True):
        wo = mei.to_world(self.draw(self.g, u2))
        return wo, mi.Spectrum(1.0), super().eval_pdf(ctx, mei, wo, active)[1]

    def eval_pdf(self, ctx, mei, wo, active=True):
        value, pdf = super().eval_pdf(ctx, mei, wo, active)
        return value, pdf * dr.select(mei.n.x > 0.05, 1.2, 1.0)


@broken("places", "sample", "haze scatters evenly beyond x = 3", kind="phase")
class PhaseByPlace:
    def sample(self, ctx, mei, u1, u2, active=True):
        wo = mei.to_world(self.draw(self.g, u2))
        wo = dr.select(mei.p.x > 3, mi.warp.square_to_uniform_sphere(u2), wo)
        return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]


@broken("state", "eval", "MIS weights off by 1 / cos(theta_o)", properties="eval_pdf")
class EvalMovesWo:
    def eval(self, ctx, si, wo, active=True):
        value = super().eval(ctx, si, wo, active)
        wo.z = dr.select(wo.z > 0, 1.0, -1.0)
        return value


class Polarised:
    """Rough conductor with Mueller matrices: right."""

    components = lobes("GlossyReflection FrontSide")

    def load(self, props):
        own = {"type": "roughconductor", "eta": 0.2, "k": 3.0, "alpha": 0.3}
        self.nested = mi.load_dict(own)

    def sample(self, ctx, si, sample1, sample2, active=True):
        return self.nested.sample(ctx, si, sample1, sample2, active)

    def eval(self, ctx, si, wo, active=True):
        return self.nested.eval(ctx, si, wo, active)

    def pdf(self, ctx, si, wo, active=True):
        return self.nested.pdf(ctx, si, wo, active)


@broken("fields", "eval", "lamps lose their polarisation", variant="polarised")
class DepolarisesWithTime(Polarised):
    def eval(self, ctx, si, wo, active=True):
        m = super().eval(ctx, si, wo, active)
        return dr.select(si.time > 0, mi.depolarizer(m[0, 0]), m)


@broken("fields", "eval", "lamps at 0.50 beyond t = 1.5", variant="polarised")
class MuellerFadesWithDistance(Polarised):
    def eval(self, ctx, si, wo, active=True):
        m = super().eval(ctx, si, wo, active)
        return dr.select(si.t > 1.5, 0.5 * m, m)


@broken("fields", "pdf", "MIS weights where tangents are sheared", variant="polarised")
class MuellerDensityByTangents(Polarised):
    def pdf(self, ctx, si, wo, active=True):
        sheared = dr.abs(dr.dot(si.dp_du, si.dp_dv)) > 0.01
        return super().pdf(ctx, si, wo, active) * dr.select(sheared, 0.7, 1.0)
