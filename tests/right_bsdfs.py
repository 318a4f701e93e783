# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Right BSDFs whose weights have ever heavier tails: one model, many samplers.

The model is a Lambertian plus microfacets (GGX); a direction is drawn by a sampler that
is good or bad for it, with the sampler's own density and eval over pdf as weight. All
are unbiased; of some the weight has no finite variance.
"""

import drjit as dr
import mitsuba as mi

# Name: roughness of the model, its share of diffuse light, sampler, its parameter.
HEAVY = {
    "lambert by uniform": (0.3, 1.0, "power", 0.0),
    "lambert by cosine^2": (0.3, 1.0, "power", 2.0),
    "lambert by cosine^3": (0.3, 1.0, "power", 3.0),
    "lambert by cosine^10": (0.3, 1.0, "power", 10.0),
    "ggx 0.3 by cosine": (0.3, 0.5, "power", 1.0),
    "ggx 0.1 by cosine": (0.1, 0.5, "power", 1.0),
    "ggx 0.05 by cosine": (0.05, 0.5, "power", 1.0),
    "ggx 0.2 by uniform": (0.2, 0.3, "power", 0.0),
    "ggx 0.2 by mirrored power": (0.2, 0.0, "mirrored", 20.0),
    "ggx 0.5 by mirrored power": (0.5, 0.2, "mirrored", 10.0),
    "ggx 0.3 by beckmann 0.4": (0.3, 0.0, "beckmann", 0.4),
    "ggx 0.5 by beckmann 0.3": (0.5, 0.0, "beckmann", 0.3),
    "ggx 0.3 by ggx 0.1": (0.3, 0.2, "ggx", 0.1),
    "ggx 0.05 by ggx 0.05, all normals": (0.05, 0.0, "ggx", 0.05),
}


def register():
    """Define and register the plugin ``heavy`` for the variant that is set."""
    flags = mi.BSDFFlags
    cosine = mi.Frame3f.cos_theta

    class Heavy(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            case = HEAVY[props["case"]]
            self.alpha, self.diffuse, self.sampler, self.parameter = case
            self.m_flags = int(flags.GlossyReflection) | int(flags.FrontSide)
            self.m_components = [self.m_flags]

        def facets(self, kind, alpha):
            return mi.MicrofacetDistribution(kind, alpha, False)

        def drawn_facets(self):
            name = "GGX" if self.sampler == "ggx" else "Beckmann"
            return self.facets(getattr(mi.MicrofacetType, name), self.parameter)

        def above(self, si, wo):
            return (cosine(si.wi) > 0) & (cosine(wo) > 0)

        def value(self, si, wo):
            h = dr.normalize(si.wi + wo)
            facets = self.facets(mi.MicrofacetType.GGX, self.alpha)
            lobe = facets.eval(h) * facets.G(si.wi, wo, h) / (4 * cosine(si.wi))
            diffuse = self.diffuse * 0.9 * dr.inv_pi * cosine(wo)
            return diffuse + (1 - self.diffuse) * 0.9 * lobe

        def density(self, si, wo):
            if self.sampler in ("beckmann", "ggx"):
                h = dr.normalize(si.wi + wo)
                return self.drawn_facets().pdf(si.wi, h) / (4 * dr.dot(wo, h))
            axis = self.axis(si)
            n = self.parameter
            along = dr.maximum(dr.dot(wo, axis), 0)
            return (n + 1) / (2 * dr.pi) * dr.power(along, n)

        def axis(self, si):
            return (
                mi.reflect(si.wi)
                if self.sampler == "mirrored"
                else mi.Vector3f(0, 0, 1)
            )

        def direction(self, si, sample2):
            if self.sampler in ("beckmann", "ggx"):
                return mi.reflect(si.wi, self.drawn_facets().sample(si.wi, sample2)[0])
            z = dr.power(sample2.x, 1 / (self.parameter + 1))
            across = dr.safe_sqrt(1 - z * z)
            sin, cos = dr.sincos(dr.two_pi * sample2.y)
            local = mi.Vector3f(across * cos, across * sin, z)
            return mi.Frame3f(self.axis(si)).to_world(local)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = mi.Vector3f(self.direction(si, sample2))
            bs.pdf = self.pdf(ctx, si, bs.wo)
            bs.eta = 1.0
            bs.sampled_type = mi.UInt32(+flags.GlossyReflection)
            ok = active & (bs.pdf > 0)
            return bs, (self.eval(ctx, si, bs.wo) / bs.pdf) & ok

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(self.value(si, wo)) & (active & self.above(si, wo))

        def pdf(self, ctx, si, wo, active=True):
            return dr.select(active & self.above(si, wo), self.density(si, wo), 0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return "Heavy[]"

    mi.register_bsdf("heavy", Heavy)
