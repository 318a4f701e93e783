# ruff: noqa: ARG001, ARG002 (every method has Mitsuba's signature)
"""Functions that disagree about a side, a place in the world, or differentials."""

import drjit as dr
import mitsuba as mi
import plain_bsdf
import pytest
from reproduced import told

from gonio_mi.validation import reproducer, validate


def verdict(base, **changes):
    mi.register_bsdf("of_places", type("Plugin", (base,), changes))
    return validate({"type": "of_places"}, effort="quick")


# ------------------------------------------------------------------------------- sides

VEIL = 0.3


def veiled_glass():
    """Rough glass with holes; right if the number of the choice is `rescaled`."""
    flags = mi.BSDFFlags

    class VeiledGlass(mi.BSDF):
        rescaled = True

        def __init__(self, props):
            super().__init__(props)
            rough = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
            self.glass = mi.load_dict(rough)
            null = flags.Null | flags.FrontSide | flags.BackSide
            lobes = [self.glass.flags(0), self.glass.flags(1), int(null)]
            self.m_components, self.m_flags = lobes, self.glass.flags() | int(null)

        def sample(self, ctx, si, sample1, sample2, active=True):
            passes = sample1 < VEIL
            own = (sample1 - VEIL) / (1 - VEIL) if self.rescaled else sample1
            bs, weight = self.glass.sample(ctx, si, own, sample2, active)
            bs.wo = dr.select(passes, -si.wi, bs.wo)
            bs.pdf = dr.select(passes, VEIL, (1 - VEIL) * bs.pdf)
            bs.eta = dr.select(passes, 1.0, bs.eta)
            null = mi.UInt32(int(flags.Null))
            bs.sampled_type = dr.select(passes, null, bs.sampled_type)
            bs.sampled_component = dr.select(passes, 2, bs.sampled_component)
            return bs, dr.select(passes & active, mi.Spectrum(1.0), weight)

        def eval(self, *asked):
            return (1 - VEIL) * self.glass.eval(*asked)

        def pdf(self, *asked):
            return (1 - VEIL) * self.glass.pdf(*asked)

        def eval_pdf(self, *asked):
            return self.eval(*asked), self.pdf(*asked)

        def eval_null_transmission(self, si, active=True):
            return mi.Spectrum(VEIL) & active

        def to_string(self):
            return "VeiledGlass[]"

    return VeiledGlass


def test_a_sample_that_misses_a_side_is_guilty():
    """Where `eval` and `pdf` agree about it, and leave it its probability."""
    base = veiled_glass()
    assert verdict(base).passed
    judged = verdict(base, rescaled=False)
    assert judged.function == "sample"
    assert judged.mistake.startswith("`sample` never goes to a side where `pdf`")


def test_a_pdf_of_a_side_too_much_is_guilty():
    """Matte on the lit side, of which all numbers give a direction."""
    base = plain_bsdf.plain()

    def above(self, si, wo):
        return si.wi.z > 0

    def value(self, ctx, si, wo):
        return mi.Spectrum(0.5 * dr.inv_pi * dr.abs(wo.z))

    def density(self, ctx, si, wo):
        return dr.inv_pi * dr.select(wo.z > 0, wo.z, -0.1 * wo.z)

    judged = verdict(base, above=above, value=value, density=density)
    assert judged.function == "pdf"
    assert "on a side where `sample` never goes" in judged.mistake


# ------------------------------------------------------------------ place in the world


@pytest.fixture
def base():
    return plain_bsdf.plain()


def by_place(si):
    return 1 + 0.5 * dr.sin(7 * si.p.x)


def by_axis(si):
    return 1 + 0.5 * si.sh_frame.n.x


@pytest.mark.parametrize("factor", [by_place, by_axis])
@pytest.mark.parametrize("forgetful", ["value", "weight", None])
def test_place_and_rotation_are_told_apart(base, factor, forgetful):
    """One function forgets them; the twin is a model that depends on the world."""

    def value(self, ctx, si, wo):
        return base.value(self, ctx, si, wo) * factor(si)

    def weight(self, ctx, si, bs):
        return base.value(self, ctx, si, bs.wo) / bs.pdf * factor(si)

    changes = {"value": value, "weight": weight}
    changes.pop(forgetful, None)
    if forgetful == "weight":
        changes["weight"] = lambda self, *_: mi.Spectrum(self.reflectance)
    judged = verdict(base, **changes)
    assert judged.passed == (forgetful is None)
    if forgetful is None:
        return
    found = judged["answers"]
    if factor is by_place:
        seeing, blind = (
            ("sample", "eval") if forgetful == "value" else ("eval", "sample")
        )
        said = (
            f"`eval` or `sample`: `{seeing}` depends, and `{blind}` does not, on si.p"
        )
        assert found.function == "eval or sample"
        assert found.mistake == said
        assert told(reproducer(judged, "answers")) > 1
    else:
        assert "mixes local and world coordinates" in found.mistake


# ------------------------------------------------------------------------ differentials


@pytest.mark.parametrize(
    ("forgetful", "failing"),
    [
        ((), ()),
        (("direction", "sampled"), ("sampled_pdf", "sampling")),
        (("direction",), ("sampling", "weights")),
    ],
)
def test_all_functions_heed_differentials_that_are_declared(base, forgetful, failing):
    """A lobe of cos^3 is a Lambertian where the footprint of a ray is large."""

    def power(self, name, si):
        large = dr.abs(si.duv_dx.x) > 0.01
        return dr.select(large & (name not in forgetful), 1.0, 3.0)

    def density(self, ctx, si, wo, name="pdf"):
        n = self.power(name, si)
        return (n + 1) * dr.inv_two_pi * dr.power(wo.z, n)

    def direction(self, ctx, si, sample1, sample2):
        z = dr.power(sample2.x, 1 / (self.power("direction", si) + 1))
        s, c = dr.sincos(dr.two_pi * sample2.y)
        r = dr.safe_sqrt(1 - z * z)
        return mi.Vector3f(r * c, r * s, z)

    def value(self, ctx, si, wo):
        return mi.Spectrum(0.8 * self.density(ctx, si, wo))

    def sample(self, ctx, si, sample1, sample2, active=True):
        bs, weight = base.sample(self, ctx, si, sample1, sample2, active)
        bs.pdf = self.density(ctx, si, bs.wo, "sampled")
        return bs, (self.value(ctx, si, bs.wo) / bs.pdf) & (weight > 0)

    changes = {f.__name__: f for f in (power, density, direction, value, sample)}
    changes["needs_differentials"] = lambda _: True
    judged = verdict(base, **changes)
    failed = {p.name for p in judged.failures if p.effect == "biases images"}
    assert failed == {*failing}
    if failing:
        assert "with differentials" in judged[failing[0]].statistic
        assert told(reproducer(judged)) > 1
