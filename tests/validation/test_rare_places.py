# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Mistakes that show at few directions, places, values or in one mode; and grainy ones.

Each is a change of `eval` or `sample` of a Lambertian; the twin is the one without.
"""

import json

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from plain_bsdf import name_of, plain
from reproduced import is_short, told

from gonio_mi import cli
from gonio_mi.validation import reproducer, validate
from gonio_mi.validation.conditions import Condition, Effort
from gonio_mi.validation.maps import four_maps, unexplained_light
from gonio_mi.validation.probe import Probe

ALBEDO = 0.7


def registered(name):
    """Dictionary of a plugin with one mistake, or of the right one."""

    class Right(plain()):
        def load(self, props):
            self.albedo = mi.Float(ALBEDO)
            SHARED["albedo"] = self.albedo

        def traverse(self, callback):
            callback.put("albedo", self.albedo, mi.ParamFlags.Differentiable)

        def value(self, ctx, si, wo):
            return mi.Spectrum(self.albedo * dr.inv_pi * wo.z)

        def weight(self, ctx, si, bs):
            return mi.Spectrum(self.albedo)

        def eval(self, ctx, si, wo, active=True):
            return self.evaluated(ctx, si, wo) & (active & self.above(si, wo))

        def evaluated(self, ctx, si, wo):
            return self.value(ctx, si, wo)

    class Grainy(Right):
        """3 % too dark, by numbers that directions seed."""

        mean = 0.97

        def evaluated(self, ctx, si, wo):
            h = dr.sin(wo.x * 917.3 + wo.y * 2113.1 + si.wi.x * 311.7) * 43758.547
            return self.value(ctx, si, wo) * (self.mean + 0.4 * (h - dr.floor(h) - 0.5))

    class GrainyRight(Grainy):
        mean = 1.0

    class GrainyALittle(Grainy):
        """Found by the mean over all angles of incidence alone."""

        mean = 0.998

    class NormalLost(Right):
        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = super().sample(ctx, si, sample1, sample2, active)
            return bs, weight & ((si.wi.x != 0) | (si.wi.y != 0))

    class ArcCosine(Right):
        """Beyond 1 by rounding where wo is wi."""

        def evaluated(self, ctx, si, wo):
            angle = dr.acos(dr.dot(si.wi, wo))
            return self.value(ctx, si, wo) * dr.select(angle >= 0, 1, dr.nan)

    class Clamped(Right):
        def evaluated(self, ctx, si, wo):
            return mi.Spectrum(dr.minimum(self.albedo, 0.9) * dr.inv_pi * wo.z)

    class OfTheClass(Right):
        def evaluated(self, ctx, si, wo):
            return mi.Spectrum(SHARED["albedo"] * dr.inv_pi * wo.z)

    class FarDarker(Right):
        def evaluated(self, ctx, si, wo):
            near = dr.select(si.t > 100, mi.Float(0.8), 1)
            return self.value(ctx, si, wo) * near

    class Detached(Right):
        """Of half of the texture."""

        def detached(self, ctx, si):
            return si.uv.x > 0.5

        def evaluated(self, ctx, si, wo):
            fixed = self.detached(ctx, si)
            own = dr.select(fixed, dr.detach(self.albedo), self.albedo)
            return mi.Spectrum(own * dr.inv_pi * wo.z)

    class DetachedInRadiance(Detached):
        def detached(self, ctx, si):
            return mi.Bool(ctx.mode == mi.TransportMode.Radiance)

    ones = {name_of(one): one for one in locals().values() if isinstance(one, type)}
    mi.register_bsdf(name, ones[name])
    return {"type": name}


SHARED = {}

# By plugin the functions that may be named, and what fails first.
WRONG = {
    "grainy": ("eval or sample", "sampled_weight"),
    "grainy_a_little": ("eval or sample", "sampled_weight"),
    "normal_lost": ("sample", "weights"),
    "arc_cosine": ("eval", "ends"),
    "clamped": ("eval or sample", "parameters"),
    "of_the_class": ("eval", "answers"),
    "far_darker": ("eval or sample", "answers"),
    "detached": ("eval", "parameters"),
    "detached_in_radiance": ("eval", "parameters"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
@pytest.mark.usefixtures("mono")
def test_mistake_is_found_and_named(name):
    verdict = validate(registered(name), effort="quick")
    function, first = WRONG[name]
    assert not verdict.passed, str(verdict)
    assert verdict.function == function
    assert verdict.failures[0].name == first
    text = reproducer(verdict)
    assert is_short(text)
    if name not in ("of_the_class", "far_darker"):
        assert told(text) > 1, text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["right", "grainy_right"])
@pytest.mark.usefixtures("mono")
def test_right_ones_pass(name):
    """The twins."""
    verdict = validate(registered(name), effort="quick")
    assert verdict.passed, str(verdict)
    assert not verdict.failures


@pytest.mark.slow
@pytest.mark.usefixtures("mono")
def test_the_share_of_a_grainy_eval_is_no_lower_bound():
    """3 % of the light; each patch of a map alone is within chance."""
    verdict = validate(registered("grainy"), effort="quick")
    share = verdict["sampled_weight"].share
    assert 0.02 < share < 0.04
    assert "of the flux from an illuminated surface is wrong" in verdict.headline


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["eval", "sample", ""])
@pytest.mark.usefixtures("mono")
def test_where_weights_alone_fail_both_functions_are_named(wrong):
    """Facets of alpha 1e-3, whose roundings hide a permille of each sample."""
    facets = {"type": "roughconductor", "distribution": "ggx", "alpha": 1e-3}

    class Sharp(plain()):
        components = (mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide,)

        def load(self, props):
            self.facets = mi.load_dict(facets)

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = self.facets.sample(ctx, si, sample1, sample2, active)
            return bs, weight * (0.999 if wrong == "sample" else 1)

        def eval(self, ctx, si, wo, active=True):
            value = self.facets.eval(ctx, si, wo, active)
            return value * (0.999 if wrong == "eval" else 1)

        def pdf(self, ctx, si, wo, active=True):
            return self.facets.pdf(ctx, si, wo, active)

    mi.register_bsdf("sharp", Sharp)
    verdict = validate({"type": "sharp"}, effort="quick")
    assert [one.name for one in verdict.failures] == ["weights"] * bool(wrong)
    assert verdict.function == ("eval or sample" if wrong else None), str(verdict)


@pytest.mark.parametrize(("sign", "least"), [(1, 0.02), (0, 0.0)])
@pytest.mark.usefixtures("mono")
def test_what_all_patches_share_is_in_the_bound(sign, least):
    """Scores of 1 or 2 in each, which chance explains alone; the twin has none."""
    plan = Effort.named("quick")
    bsdf, condition = mi.load_dict(registered("right")), Condition(35.0, 25.0)
    maps = four_maps(bsdf, condition, plan.patches, 2**17, (0, 1))
    n, due = maps.totals.n, maps.pdf
    maps.totals.counts += sign * 1.5 * np.sqrt(n * due * (1 - due))
    assert unexplained_light(maps, "sampling", 1e-4) >= least


@pytest.mark.usefixtures("mono")
def test_a_rounded_product_is_more_than_1():
    """Of many directions, so that some of them show it."""
    probe = Probe(mi.load_dict(registered("arc_cosine")), Condition(40.0))
    rng = np.random.default_rng(0)
    wi = rng.normal(size=(1024, 3)) * [1, 1, 0] + [0, 0, 1]
    wi /= np.linalg.norm(wi, axis=1)[:, None]
    assert 0 < np.isnan(probe.values(wi, wi)).sum() < len(wi)


# A right plugin that prints.
PRINTING = """
import drjit as dr, mitsuba as mi
print("loaded")

class Printing(mi.BSDF):
    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]
        self.diffuse = mi.load_dict({"type": "diffuse"})
        print("made")

    def sample(self, *asked):
        return self.diffuse.sample(*asked)

    def eval(self, *asked):
        return self.diffuse.eval(*asked)

    def pdf(self, *asked):
        return self.diffuse.pdf(*asked)

    def to_string(self):
        return "Printing[]"

mi.register_bsdf("printing", Printing)
"""


def test_what_a_plugin_prints_is_not_in_the_json(tmp_path, capsys):
    plugin = tmp_path / "printing.py"
    plugin.write_text(PRINTING)
    words = ["validate", "printing", "--effort", "quick", "--json", "--plugin", plugin]
    cli.main([*map(str, words), "--variant", mi.variant()])
    out, err = capsys.readouterr()
    assert json.loads(out)["name"] == "printing"
    assert "made" in err


@pytest.mark.slow
@pytest.mark.parametrize("slight", [True, False], ids=["slight", "twin"])
@pytest.mark.parametrize("function", ["pdf", "sample"])
@pytest.mark.usefixtures("mono")
def test_a_density_that_counts_do_not_tell_may_be_either(function, slight):
    """1 % of the cosine; the twin, 80 %, is that of one function."""
    base, part = plain(), 0.01 if slight else 0.8

    def factor(wo):
        return 1 + part * wo.x

    class Skewed(base):
        def pdf(self, ctx, si, wo, active=True):
            pdf = base.pdf(self, ctx, si, wo, active)
            return pdf * factor(wo) if function == "pdf" else pdf

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs, weight = base.sample(self, ctx, si, sample1, sample2, active)
            if function == "sample":
                bs.pdf, weight = bs.pdf * factor(bs.wo), weight / factor(bs.wo)
            return bs, weight

    mi.register_bsdf("skewed", Skewed)
    verdict = validate({"type": "skewed"}, effort="quick")
    assert not verdict.passed
    assert verdict.function == ("sample or pdf" if slight else function)


@pytest.mark.slow
@pytest.mark.parametrize("half", [True, False], ids=["right", "twin"])
@pytest.mark.usefixtures("mono")
def test_a_forgotten_flag_is_no_wrong_density(half):
    """Half of the light is transmitted; the twin's density is that of one half."""

    class Thin(plain()):
        def above(self, si, wo):
            return si.wi.z > 0

        def direction(self, ctx, si, sample1, sample2):
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            return mi.Vector3f(wo.x, wo.y, dr.select(sample1 < 0.5, wo.z, -wo.z))

        def value(self, ctx, si, wo):
            return mi.Spectrum(0.4 * dr.inv_pi * dr.abs(wo.z))

        def density(self, ctx, si, wo):
            return (0.5 if half else 1.0) * dr.inv_pi * dr.abs(wo.z)

        def weight(self, ctx, si, bs):
            return mi.Spectrum(0.8)

    mi.register_bsdf("thin", Thin)
    verdict = validate({"type": "thin"}, effort="quick")
    assert verdict.passed == half, str(verdict)
    assert ("sampling" in {one.name for one in verdict.failures}) != half
