# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Right BSDFs that are unusual: none biases an image, whatever one may remark of it.

`UNUSUAL` declares of each the names of properties that may fail as a remark. Classes
are mixins as those of :mod:`broken_by_dimension`; the rest are Mitsuba's own, nested.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from broken_by_dimension import Coat, Grey, Metal, Spectral, Textured, Veil, odd
from plain_bsdf import lobes, name_of, over, plain


@dataclass(frozen=True)
class Right:
    """A mixin or a dictionary, what may be remarked of it, and what it lacks."""

    of: Any
    remarks: str = ""
    variant: str = "mono"
    allow: str = ""


def both(nested):
    """A BSDF seen from both sides."""
    return {"type": "twosided", "nested": nested}


# blendbsdf divides 0 by 0 where a nested one is lit from behind
DIFFUSE = both({"type": "diffuse", "reflectance": 0.5})
METAL = both({"type": "roughconductor", "alpha": 0.3})
GLASS = {"type": "roughdielectric", "alpha": 0.3}
FLAT = {"type": "roughconductor", "alpha": 0.3}


def checks(low, high):
    """Texture of checks, three to a unit."""
    to_uv = mi.ScalarTransform4f().scale([3, 3, 1])
    colours = {"color0": low, "color1": high}
    return {"type": "checkerboard", "to_uv": to_uv} | colours


def blend(first, second, weight=0.5):
    """Two BSDFs in one."""
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


def mask(nested, opacity):
    """Partly open."""
    return {"type": "mask", "opacity": opacity, "nested": nested}


def bump(nested):
    """Shading normals that differ from place to place."""
    slopes = np.linspace(0, 0.3, 16, dtype=np.float32).reshape(4, 4, 1)
    heights = {"type": "bitmap", "bitmap": mi.Bitmap(slopes), "raw": True}
    return {"type": "bumpmap", "heights": heights, "nested": nested}


# blends are one component whatever they draw, and 0/0 at 90 degrees exactly
BLEND, MASK, BUMP = "ends flags components", "sampling masks flags", "reciprocity flags"

# what holds a texture is made once a variant is set
UNUSUAL = {
    "blend of blends": Right(blend(blend(DIFFUSE, METAL, 0.3), METAL), BLEND),
    "blend of weight 0": Right(blend(DIFFUSE, METAL, 0.0), BLEND),
    "blend by checks": Right(lambda: blend(DIFFUSE, METAL, checks(0.1, 0.9)), BLEND),
    # whose discrete lobe has no gradient by the weight
    "blend with nothing": Right(
        blend({"type": "null"}, DIFFUSE, 0.6), BLEND, allow="parameters"
    ),
    "two sides of blends": Right(both(blend(blend(FLAT, FLAT), FLAT)), BLEND),
    "mask by checks": Right(lambda: mask(METAL, checks(0.2, 0.8)), MASK),
    "closed mask": Right(mask(DIFFUSE, 1.0), MASK),
    "open mask": Right(mask(DIFFUSE, 0.0), MASK),
    "mask of rough glass": Right(mask(GLASS, 0.5), MASK),
    "bumps": Right(lambda: bump(FLAT), BUMP),
    "mask of bumps": Right(lambda: mask(bump(DIFFUSE), 0.7), f"{BUMP} {MASK}"),
    "polarised mask": Right(mask(FLAT, 0.5), MASK, "polarised"),
    "polarised depolariser": Right({"type": "diffuse"}, "", "polarised"),
    "spectral mirror": Right(
        {"type": "conductor", "eta": 0.2, "k": 3.0}, "", "spectral"
    ),
}


def unusual(*words, **options):
    """Decorator that enters a class into `UNUSUAL`."""

    def enter(cls):
        UNUSUAL[name_of(cls)] = Right(cls, *words, **options)
        return cls

    return enter


def load(right):
    """Plugin of the variant that is set, as a dictionary."""
    if isinstance(right.of, dict):
        return right.of
    if not isinstance(right.of, type):
        return right.of()
    name = name_of(right.of)
    mi.register_bsdf(name, over(right.of, plain()))
    return {"type": name}


class Noisy(Grey):
    """Draws numbers of its own; it has a parameter."""

    calls = 0

    def own(self, n):
        self.calls += 1
        lane = dr.arange(mi.UInt64, n)
        first, second = mi.sample_tea_64(lane, dr.opaque(mi.UInt64, self.calls)), lane
        return mi.PCG32(initstate=first, initseq=second)


@unusual("answers")
class StochasticEval(Noisy):
    """`eval` is 0 or twice its mean by chance, as of a layered model."""

    def eval(self, ctx, si, wo, active=True):
        coin = self.own(dr.width(wo, si.wi)).next_float32()
        return super().eval(ctx, si, wo, active) * dr.select(coin < 0.5, 2.0, 0.0)


@unusual("answers")
class RippledEval(Noisy):
    """`eval` is noisy by half its mean."""

    def eval(self, ctx, si, wo, active=True):
        coin = self.own(dr.width(wo, si.wi)).next_float32()
        return super().eval(ctx, si, wo, active) * (0.5 + coin)


@unusual()
class NarrowsItsContext(Grey):
    """Changes its copy of the context, as integrators give it to plugins in Python."""

    def sample(self, ctx, *args):
        bs, weight = super().sample(ctx, *args)
        weight, ctx.type_mask = weight * (ctx.type_mask > 0), 0
        return bs, weight


@unusual("answers eval_pdf_sample")
class OwnRandomNumbers(Noisy):
    """`sample` does not use the numbers that it gets."""

    def direction(self, ctx, si, sample1, sample2):
        rng = self.own(dr.width(sample2, si.wi))
        point = mi.Point2f(rng.next_float32(), rng.next_float32())
        return mi.warp.square_to_cosine_hemisphere(point)


@unusual("sampled_weight sampling")
class WeightByCoin:
    """A Russian roulette inside of `sample`: weights are 0 or twice their mean."""

    def weight(self, ctx, si, bs):
        return super().weight(ctx, si, bs) * dr.select(self.kept, 2.0, 0.0)

    def direction(self, ctx, si, sample1, sample2):
        self.kept = sample1 < 0.5
        return super().direction(ctx, si, sample1, sample2)


@unusual("ends answers")
class NanAtGrazing:
    """Ward's division by the root of both cosines, NaN at 90 degrees exactly."""

    def eval(self, ctx, si, wo, active=True):
        root = dr.sqrt(si.wi.z * wo.z)
        value = super().eval(ctx, si, wo, active)
        return value * dr.select((si.wi.z == 0) | (wo.z == 0), root / root, 1)


@unusual()
class MirroredTexture(Textured):
    """A texture that is mirrored at each border, uv of any sign."""

    def turn(self, x):
        return dr.abs(x - 2 * dr.floor(0.5 * x + 0.5))


@unusual()
class GrainOfTheMesh:
    """Anisotropic along dp_du, in all functions, sheared or not."""

    components = lobes("DiffuseReflection FrontSide Anisotropic")

    def value(self, ctx, si, wo):
        axis = si.to_local(dr.normalize(si.dp_du))
        lean = 1 + 0.9 * dr.dot(axis, si.wi) * dr.dot(axis, wo)
        return super().value(ctx, si, wo) * (0.5 * lean)


@unusual("delta")
class CornerCube:
    """All light goes back where it came from."""

    components = lobes("DeltaReflection FrontSide")

    def eval(self, ctx, si, wo, active=True):
        return mi.Spectrum(0)

    def pdf(self, ctx, si, wo, active=True):
        return mi.Float(0)

    def sample(self, ctx, si, sample1, sample2, active=True):
        bs, _ = super().sample(ctx, si, sample1, sample2, active)
        bs.wo, bs.pdf = mi.Vector3f(si.wi), mi.Float(1)
        return bs, mi.Spectrum(0.7) & (active & (si.wi.z > 0))


@unusual()
class ConeAroundWi:
    """Black unless both directions are within 60 degrees of each other."""

    components = lobes("GlossyReflection FrontSide")

    def value(self, ctx, si, wo):
        return super().value(ctx, si, wo) & (dr.dot(si.wi, wo) > 0.5)


@unusual()
class RetroreflectiveLobe:
    """Light goes back about where it came from: a power of the cosine about wi."""

    components = lobes("GlossyReflection FrontSide")
    power = 50

    def value(self, ctx, si, wo):
        lobe = dr.maximum(dr.dot(si.wi, wo), 0) ** self.power
        norm = (self.power + 1) * 0.5 * dr.inv_pi
        return mi.Spectrum(0.7 * norm * lobe * mi.Frame3f.cos_theta(wo))

    def density(self, ctx, si, wo):
        lobe = dr.maximum(dr.dot(si.wi, wo), 0) ** self.power
        return (self.power + 1) * 0.5 * dr.inv_pi * lobe

    def direction(self, ctx, si, sample1, sample2):
        height = sample2.x ** (1 / (self.power + 1))
        sine = dr.sqrt(dr.maximum(1 - height * height, 0))
        sin, cos = dr.sincos(2 * dr.pi * sample2.y)
        return mi.Frame3f(si.wi).to_world(mi.Vector3f(sine * cos, sine * sin, height))


@unusual()
class TinyLobe(Coat):
    """Its second lobe has a hundred-thousandth of the light, and half of the rays."""

    ks = 1e-5


@unusual()
class LobeOfNoWeight(Coat):
    """Its second lobe is drawn with a tenth of the rays, for nothing."""

    ks, share = 0.0, 0.1


@unusual()
class ByTriangle:
    """A reflectance for each triangle, in all functions."""

    components = lobes("DiffuseReflection FrontSide SpatiallyVarying")

    def value(self, ctx, si, wo):
        own = si.prim_index % 2 == 1
        return super().value(ctx, si, wo) * dr.select(own, 0.25, 1.0)


@unusual("answers")
class TableOfFaces:
    """A reflectance for each of two faces, and an albedo that is not theirs."""

    def load(self, props):
        self.table, self.axis = mi.Float([0.2, 0.7]), mi.Vector3f(0, 0, 1)

    def traverse(self, callback):
        callback.put("axis", self.axis, mi.ParamFlags.Differentiable)

    def value(self, ctx, si, wo):
        own = dr.gather(mi.Float, self.table, si.prim_index)
        return super().value(ctx, si, wo) * own

    def eval_diffuse_reflectance(self, si, active=True):
        return mi.Spectrum(0.1)


@unusual()
class CheckedRange(Grey):
    """A parameter that is refused beyond its range."""

    def parameters_changed(self, keys):
        if dr.any((self.reflectance < 0.5) | (self.reflectance > 0.62)):
            raise ValueError("reflectance must be in [0.5, 0.62]")


@unusual()
class RoughensWithTime(Metal):
    """Its roughness grows while the shutter is open."""

    def facets(self, si):
        alpha = self.alpha + 0.2 * si.time
        return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)


@unusual()
class Peaked(Metal):
    """Nearly a mirror."""

    def load(self, props):
        self.kd, self.alpha = mi.Float(0), mi.Float(2e-3)


@unusual(variant="spectral")
class Line(Spectral):
    """Reflects a band of 10 nm about 589 nm, and little else."""

    def value(self, ctx, si, wo):
        own = dr.abs(si.wavelengths - 589) < 5
        return super().value(ctx, si, wo) * dr.select(own, 1.0, 0.02)


@unusual()
class GauzeOfChecks(Veil):
    """Its holes are those of a texture, in all functions."""

    def gap(self, si):
        return dr.select(odd(2 * si.uv.x), 0.4, mi.Float(0.1))
