# ruff: noqa: ARG001, ARG002, ARG005 (functions of one form, methods of Mitsuba's)
"""Historic defects of public renderers, made again in a few lines, with their mends.

`EXHIBITS` holds for each its thread, the functions that may be named and the properties
of which one should fail; what was wrong is the docstring. With ``mended=True`` the same
function is right. Shaders are functions on arrays, given to Mitsuba by `from_numpy`;
what concerns Mitsuba's own interface is a mixin as in :mod:`broken_by_dimension`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import broken_by_dimension as mixins
import drjit as dr
import mitsuba as mi
import numpy as np
from broken_by_dimension import Coat, DepolarisesWithTime, Veil
from plain_bsdf import lobes, name_of

from gonio_mi.validation import from_numpy


@dataclass(frozen=True)
class Exhibit:
    """A defect; `make(mended)` is a BSDF or a dictionary of a plugin."""

    thread: str
    functions: str
    properties: str
    make: Callable
    variant: str = "mono"


EXHIBITS = {}


def exhibit(thread, functions, properties, **options):
    """Decorator that enters a function of `mended`, or a mixin with such a switch."""

    def enter(made):
        name, make = made.__name__, made
        if isinstance(made, type):
            kind, name = options.pop("kind", "bsdf"), name_of(made)

            def make(mended):
                switched = type(made.__name__, (made,), {"mended": mended})
                return mixins.load(mixins.Declaration(switched, "", "", "", kind=kind))

        EXHIBITS[name] = Exhibit(thread, functions, properties, make, **options)
        return made

    return enter


# ----------------------------------------------------------- parts of right models


def unit(v):
    """Vectors over their length."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)


def dot(a, b):
    """Products of vectors."""
    return np.sum(a * b, axis=-1)


def polar(z, phi):
    """Unit vectors of cosines and azimuths."""
    across = np.sqrt(np.maximum(1 - z * z, 0))
    return np.stack([across * np.cos(phi), across * np.sin(phi), z], axis=-1)


def cosine(wi, u):
    """Directions of the density cos/pi."""
    return polar(np.sqrt(1 - u[:, 1]), 2 * np.pi * u[:, 2])


def cosine_density(wi, wo):
    """Their density, on both sides."""
    return np.abs(wo[:, 2]) / np.pi


def above(wi, wo):
    """Whether both directions are on the front."""
    return (wi[:, 2] > 0) & (wo[:, 2] > 0)


def schlick(c):
    """Fresnel reflectance of glass."""
    return 0.04 + 0.96 * (1 - np.clip(c, 0, 1)) ** 5


def mirrored(wi, h):
    """Directions wi mirrored by facets."""
    return 2 * dot(wi, h)[:, None] * h - wi


ALPHA = 0.3
DOWN = np.array([1.0, 1.0, -1.0])


def facets(h, alpha=ALPHA):
    """Density of microfacet normals (GGX)."""
    return alpha**2 / (np.pi * (1 + (alpha**2 - 1) * h[:, 2] ** 2) ** 2)


def masking(w, alpha=ALPHA):
    """Fraction of facets that are seen (Smith's G1)."""
    z2 = np.maximum(w[:, 2] ** 2, 1e-12)
    return 2 / (1 + np.sqrt(1 + alpha**2 * (1 - z2) / z2))


def shadowing(wi, wo, alpha=ALPHA):
    """Fraction that is seen from both directions, each for itself (G)."""
    return masking(wi, alpha) * masking(wo, alpha)


def visible(wi, u, alpha=ALPHA):
    """Normals of facets that are seen from wi (Dupuy and Benyoub 2023)."""
    stretched = unit(wi * [alpha, alpha, 1])
    z = (1 - u[:, 1]) * (1 + stretched[:, 2]) - stretched[:, 2]
    return unit((polar(z, 2 * np.pi * u[:, 2]) + stretched) * [alpha, alpha, 1])


def gloss(wi, wo, shade=shadowing, alpha=ALPHA):
    """Microfacets as mirrors: `eval` of reflectance 1."""
    h = unit(wi + wo)
    return facets(h, alpha) * shade(wi, wo, alpha) / (4 * np.maximum(wi[:, 2], 1e-9))


def gloss_density(wi, wo, alpha=ALPHA):
    """Density of directions mirrored by visible facets."""
    return gloss(wi, wo, lambda wi, wo, a: masking(wi, a), alpha)


def glossy(wi, u, alpha=ALPHA):
    """Such directions."""
    return mirrored(wi, visible(wi, u, alpha))


def matte(wi, wo):
    """Lambertian: `eval`."""
    return 0.6 * cosine_density(wi, wo)


def made(direction, value, density, *, weighed=None, pdf=None, lit=above, **sides):
    """BSDF of parts; `weighed` and `pdf` are others of `value` and `density`.

    Parts of two sides are written for light from the front.
    """

    def sample(wi, u):
        side = face(wi, sides)
        wo = direction(wi * side, u)
        wi, there = wi * side, wo * side
        p = density(wi, wo)
        ok = lit(wi, wo) & (p > 0)
        return there, (weighed or value)(wi, wo) / np.where(ok, p, 1) * ok, p * ok

    def on_its_side(function):
        def of(wi, wo):
            side = face(wi, sides)
            return function(wi * side, wo * side) * lit(wi * side, wo * side)

        return of

    return from_numpy(sample, on_its_side(value), on_its_side(pdf or density), **sides)


def face(wi, sides=True):
    """Factors that turn z to the side of the light."""
    return np.where((wi[:, 2:] < 0) & bool(sides), DOWN, 1.0)


def two_lobes(share, drawn_share=None, diffuse=0.5, pdf_share=None):
    """A Lambertian and microfacets; the shares are those of the latter, at (wi, wo)."""
    drawn_share, pdf_share = drawn_share or share, pdf_share or share

    def direction(wi, u):
        own = u[:, 0] < drawn_share(wi, None)
        return np.where(own[:, None], glossy(wi, u), cosine(wi, u))

    def density(wi, wo, of=share):
        s = of(wi, wo)
        return s * gloss_density(wi, wo) + (1 - s) * cosine_density(wi, wo)

    def value(wi, wo):
        return diffuse * cosine_density(wi, wo) + 0.5 * gloss(wi, wo)

    return made(
        direction, value, density, pdf=lambda wi, wo: density(wi, wo, pdf_share)
    )


# ------------------------------------------------------------------------ exhibits


@exhibit("AcademySoftwareFoundation/OpenShadingLanguage#2158", "sample pdf", "sampling")
def lobe_by_the_brightest_colour(mended):
    """Lobes are drawn by the largest of F, and weighed by the largest of 1 - F."""
    f = np.array([0.2, 0.5, 0.8])
    drawn, passes = (f.mean(), 1 - f.mean()) if mended else (f.max(), 1 - f.min())

    def direction(wi, u):
        return cosine(wi, u) * np.where(u[:, :1] < drawn, 1.0, DOWN)

    def lobes(up, down):
        return lambda wi, wo: np.where(wo[:, 2] > 0, up, down) * cosine_density(wi, wo)

    return made(
        direction,
        lobes(f.mean(), 1 - f.mean()),
        lobes(drawn, passes),
        lit=lambda wi, wo: wi[:, 2] > 0,
        transmits=True,
    )


@exhibit("gkjohnson/three-gpu-pathtracer#847", "pdf", "sampled_pdf sampling")
def lobe_weights_of_another_half_vector(mended):
    """`sample` weighs its lobes at the normal, `pdf` at the half vector."""

    def at_normal(wi, wo):
        return 0.2 + 0.6 * schlick(wi[:, 2])

    def at_half(wi, wo):
        return 0.2 + 0.6 * schlick(dot(wi, unit(wi + wo)))

    return two_lobes(at_normal, pdf_share=None if mended else at_half)


@exhibit("mmp/pbrt-v4#215", "pdf", "sampled_pdf sampling")
def directions_exchanged(mended):
    """`f` and `PDF` take wi for wo; f is symmetric, so that the density suffers."""

    def exchanged(wi, wo):
        return cosine_density(wo, wi)

    return made(cosine, matte, cosine_density, pdf=None if mended else exchanged)


@exhibit("RayTracing/raytracing.github.io#933", "sample pdf", "sampling")
def uniform_in_name_only(mended):
    """The density is that of a uniform hemisphere, directions are cosine-weighted."""

    def uniform(wi, u):
        return polar(u[:, 1], 2 * np.pi * u[:, 2])

    return made(
        uniform if mended else cosine,
        matte,
        lambda wi, wo: np.full(len(wo), 0.5 / np.pi),
    )


@exhibit("RayTracing/TheRestOfYourLife#8", "sample", "directions sampling")
def across_twice_as_long(mended):
    """Cosine-weighted directions get twice their x and y, then unit length."""
    scale = 1 if mended else 2
    return made(
        lambda wi, u: unit(cosine(wi, u) * [scale, scale, 1]), matte, cosine_density
    )


@exhibit("RayTracing/raytracing.github.io#145", "sample", "sampling")
def point_in_the_ball(mended):
    """Normal plus a point in the unit ball, not on the sphere: a density of cos^3."""

    def direction(wi, u):
        point = polar(2 * u[:, 1] - 1, 2 * np.pi * u[:, 2])
        radius = 1 if mended else np.cbrt(u[:, :1])
        return unit([0, 0, 1] + radius * point)

    return made(direction, matte, cosine_density)


@exhibit("google/nerfactor#18", "eval", "sampled_weight reciprocity")
def half_of_the_shadowing(mended):
    """The microfacet model has the shadowing of one direction only."""
    return made(
        glossy, gloss if mended else gloss_density, gloss_density, weighed=gloss
    )


@exhibit("gkjohnson/three-gpu-pathtracer#215", "pdf", "sampled_pdf sampling")
def visible_from_the_other_side(mended):
    """The density of visible normals is that of wo, not of wi: bright edges."""

    def of_wo(wi, wo):
        return facets(unit(wi + wo)) * masking(wo) / (4 * np.maximum(wo[:, 2], 1e-9))

    return made(glossy, gloss, gloss_density, pdf=None if mended else of_wo)


@exhibit("appleseedhq/appleseed#1945", "pdf", "sampled_pdf sampling")
def half_vector_of_transmission(mended):
    """Transmitted directions get the half vector of another interface."""

    def through(function):
        return lambda wi, wo: function(wi, wo * DOWN)

    def pdf(wi, wo):
        h = unit(wi + 1.3 * wo)
        return facets(h) * masking(wi) / (4 * np.maximum(wi[:, 2], 1e-9))

    return made(
        lambda wi, u: glossy(wi, u) * DOWN,
        through(gloss),
        through(gloss_density),
        pdf=through(gloss_density if mended else pdf),
        lit=lambda wi, wo: (wi[:, 2] > 0) & (wo[:, 2] < 0),
        transmits=True,
    )


@exhibit("appleseedhq/appleseed#2308", "eval", "reciprocity")
def cosine_left_over(mended):
    """An Oren-Nayar surface keeps a cosine of the incident direction."""
    return _rough(lambda wi, wo: 1 if mended else wi[:, 2])


@exhibit("buildaworldnet/IrrlichtBAW#331", "eval flags", "flags")
def sum_of_azimuths(mended):
    """An Oren-Nayar surface takes the cosine of phi_i + phi_o for the difference."""
    return _rough(sign=1 if mended else -1)


def _rough(factor=lambda wi, wo: 1, sign=1):
    """Rough clay (Oren and Nayar's qualitative model)."""

    def value(wi, wo):
        across = wi[:, 0] * wo[:, 0] + sign * wi[:, 1] * wo[:, 1]
        t = np.where(across > 0, np.maximum(wi[:, 2], wo[:, 2]), 1)
        f = 0.7 + 0.3 * across / np.maximum(t, 1e-9)
        return 0.6 * f * factor(wi, wo) * cosine_density(wi, wo)

    return made(cosine, value, cosine_density)


@exhibit("mitsuba-renderer/mitsuba3#1728", "sample", "sampling")
def frame_transposed(mended):
    """What is drawn about wi leaves the frame of wi by its transpose."""

    def density(wi, wo):
        return 6 / (2 * np.pi) * np.maximum(dot(wi, wo), 0) ** 5

    def direction(wi, u):
        local = polar(u[:, 1] ** (1 / 6), 2 * np.pi * u[:, 2])
        first = unit(np.cross([0.0, 1.0, 0.01], wi))
        frame = np.stack([first, np.cross(wi, first), wi], axis=1)
        return np.einsum("nij,ni->nj" if mended else "nij,nj->ni", frame, local)

    def value(wi, wo):
        return 0.6 * density(wi, wo) * wo[:, 2]

    return made(direction, value, density)


@exhibit("vga-group/tauray#5", "sample", "sampling")
def number_used_twice(mended):
    """The number that picks the lobe is used for its direction again."""

    def direction(wi, u):
        again = u if mended else np.stack([u[:, 0], u[:, 0], u[:, 2]], 1)
        own = u[:, :1] < 0.5
        return np.where(own, glossy(wi, again), cosine(wi, again))

    def density(wi, wo):
        return 0.5 * (gloss_density(wi, wo) + cosine_density(wi, wo))

    return made(
        direction, lambda wi, wo: 0.5 * matte(wi, wo) + 0.4 * gloss(wi, wo), density
    )


@exhibit("knightcrawler25/GLSL-PathTracer#72", "sample", "sampling")
def fresnel_of_no_direction(mended):
    """The lobe is picked by the Fresnel term of a direction that is not drawn yet."""

    def at_normal(wi, wo):
        return schlick(wi[:, 2])

    return two_lobes(
        at_normal, None if mended else lambda wi, wo: schlick(0 * wi[:, 2])
    )


@exhibit("knightcrawler25/GLSL-PathTracer#96", "eval", "sampled_weight weights")
def smooth_all_around(mended):
    """A smooth surface shows its full highlight in all directions to `eval`."""

    def peak(wi, wo):
        return gloss(wi, mirrored(wi, 0 * wi + [0, 0, 1]), alpha=0.05)

    def value(wi, wo):
        return gloss(wi, wo, alpha=0.05)

    return made(
        lambda wi, u: glossy(wi, u, 0.05),
        value if mended else peak,
        lambda wi, wo: gloss_density(wi, wo, 0.05),
        weighed=value,
    )


@exhibit("raysect/source#349", "eval", "sampled_weight energy")
def bsdf_without_pi(mended):
    """The BSDF of a Lambertian lacks 1/pi, which its sampling makes up for."""
    scale = 1 if mended else np.pi
    return made(
        cosine, lambda wi, wo: scale * matte(wi, wo), cosine_density, weighed=matte
    )


@exhibit("bevyengine/bevy#23818", "eval", "energy")
def layers_that_gain(mended):
    """The diffuse layer is not reduced by all that its coat reflects."""
    return two_lobes(lambda wi, wo: 0.5, diffuse=0.5 if mended else 0.8)


@exhibit("Derpius/VisTrace#69", "eval", "sampled_weight weights")
def black_from_behind(mended):
    """`eval` is black for transmission that arrives on the back."""

    def density(wi, wo):
        return np.where(wi[:, 2] * wo[:, 2] > 0, 0.4, 0.6) * cosine_density(wi, wo)

    def sample(wi, u):
        passes = (u[:, 0] > 0.4)[:, None]
        wo = cosine(wi, u) * face(np.where(passes, -wi, wi))
        return wo, np.ones(len(wo)), density(wi, wo)

    def value(wi, wo):
        seen = (wi[:, 2] > 0) | (wo[:, 2] < 0) | mended
        return density(wi, wo) * seen

    return from_numpy(sample, value, density, transmits=True)


@exhibit("xelatihy/yocto-gl#474", "sample", "sampling directions")
def normals_not_flipped(mended):
    """`sample` draws above the front where the surface is lit from behind."""

    def density(wi, wo):
        return cosine_density(wi, wo) * (wi[:, 2] * wo[:, 2] > 0)

    def sample(wi, u):
        wo = cosine(wi, u) * (face(wi) if mended else 1)
        return wo, np.full(len(wo), 0.6), cosine_density(wi, wo)

    return from_numpy(
        sample, lambda wi, wo: 0.6 * density(wi, wo), density, two_sided=True
    )


@exhibit("mitsuba-renderer/mitsuba3#455", "sample", "sampling", kind="phase")
class NegativeG:
    """Where g is negative, `sample` draws evenly over the sphere."""

    def __init__(self, props):
        super().__init__(props)
        self.g = mi.Float(-0.5)

    def sample(self, ctx, mei, u1, u2, active=True):
        wo = mei.to_world(self.draw(self.g, u2))
        if not self.mended:
            wo = mi.warp.square_to_uniform_sphere(u2)
        return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]


@exhibit("ThomasKroes/exposure-render#21", "eval", "sampled_weight", kind="phase")
class PhaseOverPi:
    """An isotropic phase function is 1/pi, not 1/(4 pi)."""

    def density(self, cosine, g):
        return dr.inv_four_pi + 0 * cosine

    def eval_pdf(self, ctx, mei, wo, active=True):
        value, pdf = super().eval_pdf(ctx, mei, wo, active)
        return value * (1 if self.mended else 4), pdf

    def sample(self, ctx, mei, u1, u2, active=True):
        wo = mi.warp.square_to_uniform_sphere(u2)
        return wo, mi.Spectrum(1.0), mi.Float(dr.inv_four_pi)


@exhibit("mitsuba-renderer/mitsuba3#1681", "sample", "sampled_pdf")
class PdfOfTheNestedOne(Coat):
    """A sample of a blend comes with the density of the nested BSDF that was drawn."""

    def sample(self, ctx, si, sample1, sample2, active=True):
        bs, weight = super().sample(ctx, si, sample1, sample2, active)
        own = self.glossy_density(si, bs.wo), dr.inv_pi * bs.wo.z
        if not self.mended:
            bs.pdf = dr.select(self.picked, *own)
        return bs, weight


@exhibit("mitsuba-renderer/mitsuba3#1719", "eval_null_transmission", "delta")
class NullForgotten(Veil):
    """What holds a BSDF with gaps does not pass on their transmission."""

    def eval_null_transmission(self, si, active=True):
        return super().eval_null_transmission(si, active) * float(self.mended)


@exhibit(
    "mitsuba-renderer/mitsuba3#957", "eval", "answers frames ends", variant="polarised"
)
class NanStraightBack(DepolarisesWithTime):
    """Matrices are NaN where wo is wi: the plane of incidence is unknown there."""

    def eval(self, ctx, si, wo, active=True):
        m = self.nested.eval(ctx, si, wo, active)
        back = dr.all(wo == si.wi) & (not self.mended)
        return m * dr.select(back, dr.nan, 1.0)


@exhibit("pjessesco/caramel#36", "sample", "adjoint")
class RadianceWithoutEta:
    """Refracted radiance is not divided by eta^2."""

    components = lobes(
        "DeltaReflection FrontSide BackSide",
        "DeltaTransmission FrontSide BackSide NonSymmetric",
    )

    def load(self, props):
        self.nested = mi.load_dict({"type": "dielectric"})

    def sample(self, ctx, si, sample1, sample2, active=True):
        asked = mi.BSDFContext(
            ctx.mode if self.mended else mi.TransportMode.Importance,
            ctx.type_mask,
            ctx.component,
        )
        return self.nested.sample(asked, si, sample1, sample2, active)

    def eval(self, ctx, si, wo, active=True):
        return mi.Spectrum(0)

    def pdf(self, ctx, si, wo, active=True):
        return mi.Float(0)
