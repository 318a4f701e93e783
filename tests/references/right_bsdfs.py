# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Right BSDFs: Mitsuba's own and ours, and such whose weights have heavy tails.

The heavy ones are a Lambertian plus microfacets (GGX); a direction is drawn by a
sampler that is good or bad for it, with the sampler's own density and eval over pdf as
weight. All are unbiased; of some the weight has no finite variance.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

GGX = {"type": "roughconductor", "distribution": "ggx"}
GLASS = {"type": "roughdielectric", "distribution": "ggx"}
DIFFUSE = {"type": "diffuse", "reflectance": 0.6}


def interface(inside):
    """Refractive indices of a surface in air."""
    return {"int_ior": inside, "ext_ior": 1.0}


RIGHT = {
    "lambert": {"type": "diffuse", "reflectance": 1.0},
    "ggx 0.001": GGX | {"alpha": 0.001},
    "ggx 0.01": GGX | {"alpha": 0.01},
    "ggx 0.01, all normals": GGX | {"alpha": 0.01, "sample_visible": False},
    "ggx 0.05": GGX | {"alpha": 0.05},
    "ggx 0.05, all normals": GGX | {"alpha": 0.05, "sample_visible": False},
    "ggx 0.2": GGX | {"alpha": 0.2},
    "ggx 1": GGX | {"alpha": 1.0},
    "ggx brushed, all normals": GGX
    | {"alpha_u": 0.1, "alpha_v": 0.4, "sample_visible": False},
    "rough glass": GLASS | {"alpha": 0.2},
    "rough glass 0.01": GLASS | {"alpha": 0.01},
    "rough glass 1": GLASS | {"alpha": 1.0},
    "rough glass of index 1.0001": GLASS | {"alpha": 0.1} | interface(1.0001),
    "rough glass of index 1.02": GLASS | {"alpha": 0.3} | interface(1.02),
    "rough glass of index 3": GLASS | {"alpha": 0.1} | interface(3.0),
    "mirror": {"type": "conductor"},
    "glass": {"type": "dielectric"},
    "glass of index 1.0001": {"type": "dielectric"} | interface(1.0001),
    "glass of index 1.01": {"type": "dielectric"} | interface(1.01),
    "glass of index 3": {"type": "dielectric"} | interface(3.0),
    "air in glass": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 2.4},
    "pane of index 3": {"type": "thindielectric"} | interface(3.0),
    "plastic": {"type": "plastic"},
    "plastic of index 3": {"type": "plastic", "nonlinear": True} | interface(3.0),
    "two sides": {"type": "twosided", "nested": GGX | {"alpha": 0.2}},
    "glossymixture": {"type": "glossymixture"},
    "cosinelobe": {"type": "cosinelobe"},
    "anisotropicphong": {"type": "anisotropicphong"},
}

# What fails for all seeds, and is so: of Mitsuba's own, see test_validation_stock.py.
KNOWN = {
    "bump map": {"reciprocity", "flags"},
    "normal map": {"reciprocity", "flags"},
    "mask": {"sampling", "masks", "flags"},
    "null": {"masks"},
    "principled": {"flags", "components"},
    "principled metal": {"flags", "components"},
    "two BSDFs": {"flags", "components"},
}


def textured():
    """Right BSDFs that need a variant when they are made: maps, and what holds others.

    Failures of `KNOWN` are those of a nicety, or a property of the model.
    """
    noise = np.random.default_rng(5).uniform(0.1, 0.9, (8, 8, 1))
    heights, normals = np.linspace(0, 0.3, 16), np.tile([0.55, 0.5, 0.99], 4)
    noise, heights, normals = (
        {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}
        for values in (
            noise.astype(np.float32),
            heights.astype(np.float32).reshape(4, 4, 1),
            normals.astype(np.float32).reshape(2, 2, 3),
        )
    )
    checks = {"type": "checkerboard", "color0": 0.05, "color1": 0.5}
    metal = GGX | {"alpha": 0.3}
    return {
        "checkerboard": {"type": "diffuse", "reflectance": checks},
        "bitmap": {"type": "diffuse", "reflectance": noise},
        "bitmap of roughness": GGX | {"alpha": noise},
        "checkerboard of roughness": GGX | {"alpha": checks},
        "bump map": {"type": "bumpmap", "heights": heights, "nested": DIFFUSE},
        "normal map": {"type": "normalmap", "normalmap": normals, "nested": metal},
        "mask": {"type": "mask", "opacity": noise, "nested": metal},
        "null": {"type": "null"},
        "principled": {"type": "principled"},
        "principled metal": {"type": "principled", "metallic": 1.0, "roughness": 0.3},
        "two BSDFs": {"type": "twosided", "front": DIFFUSE, "back": metal},
    }


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
            alpha, diffuse, self.sampler, parameter = HEAVY[props["case"]]
            # no literals, so that cases of one sampler share kernels
            self.alpha, self.diffuse, self.parameter = (
                dr.opaque(mi.Float, x) for x in (alpha, diffuse, parameter)
            )
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
