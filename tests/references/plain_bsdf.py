# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""The base of BSDF plugins that tests define: a lobe of a value and of a density."""

import types

import drjit as dr
import mitsuba as mi


def lobes(*words):
    """Components of flags by their names, as a property: flags need a variant."""

    def flags(_):
        return [
            sum(int(getattr(mi.BSDFFlags, word)) for word in one.split())
            for one in words
        ]

    return property(flags)


def over(mixin, base):
    """Class with the methods of `mixin` on `base`, whose ``super()`` is known.

    Mitsuba's classes are those of a variant, and no second base may stand beside them.
    """
    for part in [one for one in reversed(mixin.__mro__) if one is not object]:
        made = types.new_class(part.__name__, (base,))
        for name, value in vars(part).items():
            if isinstance(value, types.FunctionType):
                cells = [
                    types.CellType(made) if free == "__class__" else cell
                    for free, cell in zip(
                        value.__code__.co_freevars, value.__closure__ or ()
                    )
                ]
                again = types.FunctionType(
                    value.__code__, value.__globals__, name, None, tuple(cells) or None
                )
                again.__defaults__ = value.__defaults__
                value = again
            if name not in ("__dict__", "__weakref__"):
                setattr(made, name, value)
        base = made
    return base


def plain():
    """Class for the variant that is set: one Lambertian lobe, lit from above."""
    flags = mi.BSDFFlags
    cosine = mi.Frame3f.cos_theta

    class Plain(mi.BSDF):
        components = (flags.DiffuseReflection | flags.FrontSide,)
        reflectance = 0.8

        def __init__(self, props):
            super().__init__(props)
            self.m_components = [int(one) for one in self.components]
            self.m_flags = 0
            for one in self.m_components:
                self.m_flags |= one
            self.load(props)

        def load(self, props):
            """Read parameters."""

        def above(self, si, wo):
            """Where it is lit."""
            return (cosine(si.wi) > 0) & (cosine(wo) > 0)

        def value(self, ctx, si, wo):
            """Value of `eval` where it is lit."""
            return mi.Spectrum(self.reflectance * dr.inv_pi * cosine(wo))

        def density(self, ctx, si, wo):
            """Density where it is lit."""
            return dr.inv_pi * cosine(wo)

        def direction(self, ctx, si, sample1, sample2):
            return mi.warp.square_to_cosine_hemisphere(sample2)

        def weight(self, ctx, si, bs):
            return self.value(ctx, si, bs.wo) / bs.pdf

        def drawn(self, ctx, si, bs):
            """Set component and type of a sample."""
            lobes = int(flags.All)
            bs.sampled_type = mi.UInt32(self.m_components[0] & lobes)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = mi.Vector3f(self.direction(ctx, si, sample1, sample2))
            bs.pdf, bs.eta = self.density(ctx, si, bs.wo), 1.0
            self.drawn(ctx, si, bs)
            ok = active & self.above(si, bs.wo) & (bs.pdf > 0)
            return bs, self.weight(ctx, si, bs) & ok

        def eval(self, ctx, si, wo, active=True):
            return self.value(ctx, si, wo) & (active & self.above(si, wo))

        def pdf(self, ctx, si, wo, active=True):
            return dr.select(active & self.above(si, wo), self.density(ctx, si, wo), 0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return f"{type(self).__name__}[]"

    return Plain


def changed(base, **changes):
    """Dictionary of a plugin that has the functions of `base`, and other attributes.

    `base` is a class of functions alone: a plugin has no second base.
    """
    own = {}
    for one in reversed(base.__mro__[:-1]):
        own |= vars(one)
    own = {k: v for k, v in own.items() if k not in ("__dict__", "__weakref__")}
    mi.register_bsdf("changed", type("Plugin", (mi.BSDF,), own | changes))
    return {"type": "changed"}


def name_of(plugin):
    """Name of a class in small letters with underscores."""
    letters = (f"_{c.lower()}" if c.isupper() else c for c in plugin.__name__)
    return "".join(letters)[1:]


def register(plugins):
    """Register classes under their names, in small letters with underscores."""
    for plugin in plugins:
        mi.register_bsdf(name_of(plugin), plugin)
