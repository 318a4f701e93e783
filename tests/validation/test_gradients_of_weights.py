# ruff: noqa: ARG001, ARG002 (functions have one signature, and methods Mitsuba's)
"""Gradients of the weights of discrete lobes, where `eval` is 0; and at all angles."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from plain_bsdf import plain
from reproduced import is_short, told

from gonio_mi.validation import reproducer, validate
from gonio_mi.validation.arrays import of_eval
from gonio_mi.validation.checks.gradients import gradient, weight_slopes

CONDUCTOR = {"type": "conductor", "specular_reflectance": 0.9}
GREY = CONDUCTOR | {"specular_reflectance": 0.4}


def two_lobes(weight, kinds=("DeltaReflection", "Null")):
    """Plugin of two discrete lobes, the first by chance `a`, and their weights.

    `weight` takes a, its detached value, an interaction and a mode; kinds are types.
    """
    flags, sides = mi.BSDFFlags, mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
    types = [int(getattr(flags, kind)) for kind in kinds]

    class Lobes(plain()):
        components = [kind | int(sides) for kind in types]

        def load(self, props):
            self.a = mi.Float(0.4)

        def traverse(self, callback):
            callback.put("a", self.a, mi.ParamFlags.Differentiable)

        def sample(self, ctx, si, sample1, sample2, active=True):
            p = dr.detach(self.a)
            first = active & (sample1 < p)
            bs = dr.zeros(mi.BSDFSample3f, dr.width(sample1))
            bs.eta, bs.pdf = 1.0, dr.select(first, p, 1 - p)
            bs.sampled_component = dr.select(first, mi.UInt32(0), 1)
            bs.sampled_type = dr.select(first, mi.UInt32(types[0]), types[1])
            mirrored = bs.sampled_type != int(flags.Null)
            bs.wo = dr.select(mirrored, mi.reflect(si.wi), -si.wi)
            one, other = weight(self.a, p, si, ctx.mode)
            return bs, mi.Spectrum(dr.select(first, one, other)) & active

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0 * wo.z)

        def pdf(self, ctx, si, wo, active=True):
            return 0 * wo.z

        def eval_null_transmission(self, si, active=True):
            return mi.Spectrum(0 if "Null" not in kinds else 1 - dr.detach(self.a))

    mi.register_bsdf("lobes", Lobes)
    return validate({"type": "lobes"}, effort="quick")


def of_light(a, p, si, mode):
    """.9 times a is mirrored, what is left goes straight on."""
    return 0.9 * a / p, (1 - a) / (1 - p)


def null_detached(a, p, si, mode):
    """As mitsuba3 PR#911 found it in `mask`."""
    return 0.9 * a / p, dr.detach(1 - a) / (1 - p)


def by_an_attached_probability(a, p, si, mode):
    """As `plastic` has it: what is drawn more often seems to carry less."""
    return 0.9 + 0 * a, (1 - a) / (1 - p)


def lost_at_large_angles(a, p, si, mode):
    one, other = of_light(a, p, si, mode)
    return dr.select(si.wi.z < 0.5, dr.detach(one), one), other


def lost_in_radiance_mode(a, p, si, mode):
    one, other = of_light(a, p, si, mode)
    return dr.detach(one) if mode == mi.TransportMode.Radiance else one, other


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize(
    "wrong",
    [
        None,
        null_detached,
        by_an_attached_probability,
        lost_at_large_angles,
        lost_in_radiance_mode,
    ],
)
def test_gradients_of_discrete_lobes(wrong):
    """The first is the twin of the others."""
    judged = two_lobes(wrong or of_light)
    found = judged["parameters"]
    assert (found.status == "fails") == bool(wrong), str(judged)
    if wrong:
        assert judged.function == "sample"
        assert found.mistake.startswith("gradients of the weight of `sample` by a ")
        assert found.condition.mode == "importance" or "lost" in wrong.__name__
        text = reproducer(judged, "parameters")
        assert is_short(text)
        assert told(text) > 1


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("wrong", [False, True])
def test_lobes_of_one_direction_are_one(wrong):
    """All samples have the weight of both lobes, whichever was drawn; or it is lost."""

    def weight(a, p, si, mode):
        both = 0.9 * a + 0.4 * (1 - a)
        both = dr.detach(both) if wrong else both
        return both, both

    judged = two_lobes(weight, ("DeltaReflection", "DeltaReflection"))
    assert (judged["parameters"].status == "fails") == wrong, str(judged)


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize(
    ("specimen", "name"),
    [
        ({"type": "blendbsdf", "weight": 0.3, "a": CONDUCTOR, "b": GREY}, "weight"),
        ({"type": "plastic", "specular_reflectance": 0.8}, "diffuse_reflectance"),
        ({"type": "thindielectric"}, "eta"),
        ({"type": "blendbsdf", "weight": 0.3, "a": GREY, "b": GREY}, None),
        ({"type": "mask", "opacity": 0.6, "a": CONDUCTOR}, None),
        ({"type": "mask", "opacity": 0.98, "a": {"type": "diffuse"}}, None),
        (CONDUCTOR | {"eta": 0.2, "k": 3.9}, None),
        ({"type": "dielectric", "specular_reflectance": 0.8}, None),
    ],
)
def test_stock_lobes(specimen, name):
    """Of Mitsuba's own, three are wrong; the twins are right."""
    judged = validate(specimen, effort="quick")
    found = judged["parameters"]
    assert (found.status == "fails") == bool(name), str(judged)
    if name:
        assert f"of the weight of `sample` by {name}" in found.mistake
        assert told(reproducer(judged, "parameters")) > 1


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("wrong", [False, True])
def test_gradients_at_large_angles(wrong):
    """Of `eval`, beyond those of single directions."""

    class Grey(plain()):
        def load(self, props):
            self.a = mi.Float(0.4)

        def traverse(self, callback):
            callback.put("a", self.a, mi.ParamFlags.Differentiable)

        def value(self, ctx, si, wo):
            lost = (si.wi.z < 0.6) & wrong
            a = dr.select(lost, dr.detach(self.a), self.a)
            return mi.Spectrum(a * dr.inv_pi * wo.z)

    mi.register_bsdf("grey", Grey)
    found = validate({"type": "grey"}, effort="quick")["parameters"]
    assert (found.status == "fails") == wrong, found


@pytest.mark.usefixtures("mono")
def test_a_script_finds_right_gradients_right():
    """Rounding of differences of sums, of a step of 1e-3."""
    bsdf, si = mi.load_dict({"type": "diffuse"}), dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    u = mi.Point3f(*np.random.default_rng(0).random((3, 1000), dtype=np.float32))
    name = "reflectance.value"
    change, told = gradient(bsdf, mi.BSDFContext(), si, u, of_eval, name)
    assert told > 0
    np.testing.assert_allclose(change, told, rtol=1e-3)


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize(
    ("specimen", "wrong"),
    [
        ({"type": "mask", "opacity": 0.6, "a": CONDUCTOR}, False),
        (CONDUCTOR | {"eta": 0.2, "k": 3.9}, False),
        ({"type": "diffuse"}, False),
        ({"type": "plastic"}, True),
    ],
)
def test_slopes_of_all_weights(specimen, wrong):
    """As the table of conformance asks them: 8 standard errors, of the worst."""
    n = 2**18
    bsdf, si = mi.load_dict(specimen), dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    u = mi.Point3f(*np.random.default_rng(0).random((3, n), dtype=np.float32))
    a, b, error = weight_slopes(bsdf, mi.BSDFContext(), si, u)
    assert (np.abs(a - b) > 8 * error).any() == wrong
    assert (len(a) == 1) == (specimen["type"] == "diffuse")
