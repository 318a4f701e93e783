"""A Lambertian and microfacets, one of them with a wrong cosine, asked alone or not."""

import drjit as dr
import mitsuba as mi


def register():
    """Define and register the plugin ``lobes`` for the variant that is set."""
    flags = mi.BSDFFlags
    diffuse, glossy = int(flags.DiffuseReflection), int(flags.GlossyReflection)
    cosine = mi.Frame3f.cos_theta

    class Lobes(mi.BSDF):
        """Weights follow ``eval``, so that only reciprocity contradicts it.

        `diffuse_power` and `glossy_power` are those k of which ``eval cos_i^k`` is the
        same with wi and wo exchanged: 1 is right. Light of the diffuse lobe has
        `coupled` to be refracted into the surface, but not out of it: a law of its own,
        that is not reciprocal. The lobes are components, or are told by parameters, if
        `told` is so; if it is "nothing", by neither.
        """

        def __init__(self, props):
            super().__init__(props)
            self.powers = props.get("diffuse_power", 1), props.get("glossy_power", 1)
            self.coupled = props.get("coupled", False)
            self.told = props.get("told", "nothing")
            self.reflectances = mi.Float(0.3), mi.Float(0.2)
            front = int(flags.FrontSide)
            self.m_components = [diffuse | front, glossy | front]
            if self.told != "components":
                self.m_components = [diffuse | glossy | front]
            if props.get("declared", False):
                self.m_components = [
                    one | int(flags.NonSymmetric) for one in self.m_components
                ]
            self.m_flags = 0
            for one in self.m_components:
                self.m_flags |= one

        def traverse(self, callback):
            if self.told == "parameters":
                for name, value in zip(("kd", "ks"), self.reflectances):
                    callback.put(name, value, mi.ParamFlags.Differentiable)

        def facets(self):
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, 0.3, False)

        def value(self, ctx, si, wo):
            h, facets = dr.normalize(si.wi + wo), self.facets()
            lobes = [dr.inv_pi, facets.eval(h) * facets.G(si.wi, wo, h) / 4]
            lobes[1] /= cosine(si.wi) * cosine(wo)
            if self.coupled:
                lobes[0] *= 1 - mi.fresnel(cosine(si.wi), 1.5)[0]
            value = mi.Float(0)
            for i in self.enabled(ctx):
                power = self.powers[i]
                angle = cosine(si.wi) if power < 0 else cosine(wo) ** power
                value += self.reflectances[i] * lobes[i] * angle
            return mi.Spectrum(value)

        def enabled(self, ctx):
            kinds = flags.DiffuseReflection, flags.GlossyReflection
            all_of_them = self.told != "components"
            return [
                i
                for i, kind in enumerate(kinds)
                if all_of_them or ctx.is_enabled(kind, i)
            ]

        def share(self, ctx):
            return {(0,): 0.0, (1,): 1.0}.get(tuple(self.enabled(ctx)), 0.5)

        def above(self, si, wo):
            return (cosine(si.wi) > 0) & (cosine(wo) > 0)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f)
            second = sample1 < self.share(ctx)
            h = self.facets().sample(si.wi, sample2)[0]
            lambert = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.wo = dr.select(second, mi.reflect(si.wi, h), lambert)
            bs.sampled_type = dr.select(second, mi.UInt32(glossy), mi.UInt32(diffuse))
            if self.told == "components":
                bs.sampled_component = dr.select(second, mi.UInt32(1), mi.UInt32(0))
            bs.eta = 1.0
            bs.pdf = self.pdf(ctx, si, bs.wo, active)
            value = self.eval(ctx, si, bs.wo, active & (bs.pdf > 0))
            return bs, dr.select(bs.pdf > 0, value / bs.pdf, 0)

        def eval(self, ctx, si, wo, active=True):
            return self.value(ctx, si, wo) & (active & self.above(si, wo))

        def pdf(self, ctx, si, wo, active=True):
            h, share = dr.normalize(si.wi + wo), self.share(ctx)
            glossy = self.facets().pdf(si.wi, h) / (4 * dr.dot(wo, h))
            density = share * glossy + (1 - share) * dr.inv_pi * cosine(wo)
            return dr.select(active & self.above(si, wo), density, 0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return "Lobes[]"

    mi.register_bsdf("lobes", Lobes)
