"""What `validate` finds in Mitsuba's own BSDFs, confirmed by plain calls of Mitsuba.

Nothing of gonio_mi takes part here: if a later Mitsuba mends one of these, its test
fails, and the README's table has a row too many.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("mono")

GGX = {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"}
DIFFUSE = {"type": "diffuse"}


def lit_from(theta, side=1):
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(float(np.sin(theta)), 0, float(side * np.cos(theta)))
    # with literals, Dr.Jit would skip what it knows to be inactive
    dr.make_opaque(si.wi)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    return si


def context(component=None):
    ctx = mi.BSDFContext()
    if component is not None:
        ctx.component = component
    return ctx


def only(value):
    return float(np.ravel(np.array(value))[0])


def test_beckmann_density():
    """Counted in 2^22 samples, and by a midpoint rule of 4800 x 1500 directions."""
    bsdf = mi.load_dict({"type": "roughconductor", "alpha": 0.3})
    si = lit_from(np.radians(80))
    n = 2**22
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, n)
    weight = bsdf.sample(context(), si, sampler.next_1d(), sampler.next_2d())[1]
    sampled = np.count_nonzero(np.array(weight)) / n
    z = np.sqrt((np.arange(4800) + 0.5) / 4800)[:, None]
    phi = (np.arange(1500) + 0.5) / 1500 * 2 * np.pi
    sine = np.sqrt(1 - z**2)
    wo = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), z))
    pdf = bsdf.pdf(context(), si, mi.Vector3f(wo.reshape(3, -1).astype(np.float32)))
    # in z^2: d omega = d(z^2) d phi / 2 z
    integral = np.mean(pdf.numpy().reshape(4800, 1500) / (2 * z)) * 2 * np.pi
    std_err = np.sqrt(sampled * (1 - sampled) / n)
    assert sampled - integral > 20 * std_err


def test_roughplastic_has_a_density_below_the_horizon():
    bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"})
    below = mi.Vector3f(0.6, 0, -0.8)
    dr.make_opaque(below)
    si = lit_from(0.5)
    assert only(bsdf.pdf(context(), si, below)) > 0
    assert only(bsdf.eval(context(), si, below)) == 0


def test_blendbsdf():
    bsdf = mi.load_dict({"type": "blendbsdf", "weight": 0.3, "a": DIFFUSE, "b": GGX})
    random = mi.Float([0.1]), mi.Point2f(0.0, 0.5)
    behind = bsdf.sample(context(), lit_from(0.5, -1), mi.Float([0.0]), random[1])
    assert np.isnan(only(behind[1]))
    first, second = (
        bsdf.sample(context(), lit_from(0.5), mi.Float([u]), mi.Point2f(0.3, 0.6))[0]
        for u in (0.9, 0.1)
    )
    assert only(first.sampled_type) != only(second.sampled_type)
    assert only(first.sampled_component) == only(second.sampled_component) == 0


def test_principled():
    bsdf = mi.load_dict({"type": "principled"})
    si, wo = lit_from(0.5), mi.Vector3f(0, 0.6, 0.8)
    values = {only(bsdf.eval(context(i), si, wo)) for i in (None, 0, 1)}
    assert len(values) == 1
    one = bsdf.sample(context(), si, mi.Float([0.95]), mi.Point2f(0.3, 0.6))[0]
    assert only(one.sampled_component) == 3 > bsdf.component_count() - 1
    behind = lit_from(0.5, -1)
    down = mi.Vector3f(0.6, 0, -0.8)
    assert only(bsdf.pdf(context(), behind, down)) > 0
    weight = bsdf.sample(context(), behind, mi.Float([0.5]), mi.Point2f(0.3, 0.6))[1]
    assert only(weight) == 0


def test_principledthin_is_not_reciprocal():
    settings = {"spec_trans": 0.5, "diff_trans": 1.0, "roughness": 0.4}
    bsdf = mi.load_dict({"type": "principledthin"} | settings)
    one, other = lit_from(0.5), lit_from(1.2, -1)
    there = only(bsdf.eval(context(), one, other.wi)) / np.cos(1.2)
    back = only(bsdf.eval(context(), other, one.wi)) / np.cos(0.5)
    assert abs(there / back - 1) > 0.01


def test_pplastic_samples_an_undeclared_component():
    bsdf = mi.load_dict({"type": "pplastic", "alpha": 0.3})
    one = bsdf.sample(context(), lit_from(0.5), mi.Float([0.9]), mi.Point2f(0.3, 0.6))
    assert only(one[0].sampled_component) == bsdf.component_count() == 1


def test_mask():
    bsdf = mi.load_dict({"type": "mask", "opacity": 0.4, "nested": DIFFUSE})
    si, random = lit_from(0.5), (mi.Float([0.5]), mi.Point2f(0.3, 0.6))
    bs, weight = bsdf.sample(context(0), si, *random)
    assert only(weight) == only(bs.pdf) == 1
    assert only(bsdf.pdf(context(0), si, bs.wo)) == 0


@pytest.mark.parametrize(
    "specimen", [{"type": "null"}, {"type": "mask", "opacity": 0.4, "n": DIFFUSE}]
)
def test_inactive_rays_get_weight(specimen):
    bsdf = mi.load_dict(specimen)
    random = mi.Float([0.9]), mi.Point2f(0.3, 0.6)
    assert only(bsdf.sample(context(), lit_from(0.5), *random, False)[1]) == 1


def test_twosided_counts_its_back_twice():
    bsdf = mi.load_dict({"type": "twosided", "a": DIFFUSE, "b": GGX})
    si, wo = lit_from(0.5, -1), mi.Vector3f(-0.5, 0, -(0.75**0.5))
    values = [only(bsdf.eval(context(i), si, wo)) for i in (None, 0, 1)]
    assert values[0] == values[1] == values[2] > 0
