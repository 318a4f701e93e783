"""Corpora that were made before a check was: broken, unusual right, and historic ones.

What is not reached yet is in `NOT_YET`, whose tests must fail.
"""

import budget
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from broken_by_dimension import BROKEN, load
from museum import EXHIBITS
from unusual_right import UNUSUAL, load as load_right

from gonio_mi.validation import validate

# What today's checks do not do; a check that reaches one takes it off.
NOT_YET = {
    "broken": "pdf_detached, four_million_lanes",
    "unusual": "",
    "museum": "",
}


# What is said where a factor, or a change from call to call, is known.
SAID = {
    "weight_without_g1": "`sample` weight lacks the factor G1(wo), ",
    "eval_moves_wo": "`eval` changes its arguments in place, which joint",
    "after_many_calls": "`eval` returns different values when called again",
    "after_many_samples": "`sample` returns different values when called again",
    "mueller_fades_with_distance": "`eval` or `sample`: `eval` depends, and `sample` "
    "does not, on si.t",
    "mueller_density_by_tangents": "`sample` or `pdf`: `pdf` depends, and `sample` "
    "does not, on si.dp_du",
}


def cases(test, table):
    """Parameters of a test, of which those that are not reached yet must fail."""
    late = " ".join(NOT_YET[test].split()).split(", ") if NOT_YET[test] else []
    assert {*late} <= {*table}
    return pytest.mark.parametrize(
        "name",
        [
            pytest.param(name, marks=pytest.mark.xfail(strict=True))
            if name in late
            else name
            for name in table
        ],
    )


def check_found(verdict, functions, properties):
    """One of the properties fails, and of one or two functions one is guilty."""
    named = {*str(verdict.function).split(" or ")}
    assert {one.name for one in verdict.failures} & properties, str(verdict)
    assert len(named) <= 2, str(verdict)
    assert named & {*functions.split()}, str(verdict)


@cases("broken", BROKEN)
def test_broken_ones_are_found_and_named(request, name):
    one = BROKEN[name]
    request.getfixturevalue(one.variant)
    verdict = validate(load(one), effort="quick")
    check_found(verdict, one.functions, one.shown_by)
    assert verdict.mistake.startswith(SAID.get(name, "")), str(verdict)


@cases("unusual", UNUSUAL)
def test_unusual_right_ones_do_not_fail(request, name):
    one = UNUSUAL[name]
    request.getfixturevalue(one.variant)
    how = {"effort": "quick", "alpha": budget.ALPHA, "allow": one.allow.split()}
    verdict = validate(load_right(one), **how)
    assert verdict.passed, str(verdict)
    remarks = {found.name for found in verdict.failures}
    assert remarks <= {*one.remarks.split()}, str(verdict)


@cases("museum", EXHIBITS)
def test_historic_defects_are_found_and_named(request, name):
    one = EXHIBITS[name]
    request.getfixturevalue(one.variant)
    verdict = validate(one.make(mended=False), effort="quick")
    check_found(verdict, one.functions, {*one.properties.split()})


# Mended, they are the very functions of another one: bsdf_without_pi (twice),
# half_of_the_shadowing, cosine_left_over.
ALIKE = (
    *("directions_exchanged", "across_twice_as_long"),
    *("visible_from_the_other_side", "sum_of_azimuths"),
)


@pytest.mark.parametrize("name", [name for name in EXHIBITS if name not in ALIKE])
def test_mended_ones_are_right(request, name):
    """The twins."""
    one = EXHIBITS[name]
    request.getfixturevalue(one.variant)
    if mi.is_polarized:
        # nothing passes without the unpolarised variant, which must know it
        mi.set_variant("llvm_ad_mono")
        one.make(mended=True)
        mi.set_variant("llvm_ad_mono_polarized")
    verdict = validate(
        one.make(mended=True), effort="quick", alpha=budget.ALPHA, strict=True
    )
    assert verdict.passed, str(verdict)


def tilted(degrees):
    """Normal that leans towards x."""
    angle = np.radians(degrees)
    return [float(np.sin(angle)), 0.0, float(np.cos(angle))]


@pytest.mark.parametrize(
    ("name", "quantity", "fields", "due"),
    [
        ("eval_fades_with_time", "eval", {"time": 0.7}, 0.40),
        ("weight_of_a_floor", "sample", {"p": [0, 0, -2]}, 1.20),
        ("cosine_of_the_face", "eval", {"n": tilted(20)}, 0.776),
        ("eval_by_triangle", "eval", {"prim_index": 3}, 0.40),
        ("uv_clamped", "eval", {"uv": [1.5, 0.5]}, 0.80),
        ("uv_truncated", "sample", {"uv": [-0.25, 0.5]}, 0.24),
        ("seam_of_the_texture", "pdf", {"uv": [0.995, 0.5]}, 0.0),
        ("one_tile", "sample", {"uv": [6.5 / 8, 1.5 / 8]}, 1.04),
        ("few_hundred_lanes", "pdf", {}, 2.0),
        ("unguarded_pdf_and_weight", "sample", {}, 0.72),
        ("weight_without_g1", "sample", {}, 0.731),
        ("pdf_of_one_of_two", "pdf", {}, 0.727),
        ("null_claimed", "null", {}, 0.75),
        ("null_without_texture", "null", {"uv": [0.7, 0.5]}, 0.10),
    ],
)
@pytest.mark.usefixtures("mono")
def test_what_they_bias(name, quantity, fields, due):
    """Sums over regular points, whose error is below half a percent."""
    side = 28 if name == "few_hundred_lanes" else 256
    x, y = (np.indices((side, side)).reshape(2, -1) + 0.5) / side
    points = mi.Point2f(np.float32(x), np.float32(y))
    si = dr.zeros(mi.SurfaceInteraction3f, len(x))
    si.wi, si.n = mi.Vector3f(0.6, 0, 0.8), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    for field, value in fields.items():
        setattr(si, field, type(getattr(si, field))(value))
    bsdf, ctx = mi.load_dict(load(BROKEN[name])), mi.BSDFContext()
    wo = mi.warp.square_to_uniform_hemisphere(points)
    answer = {
        "eval": lambda: bsdf.eval(ctx, si, wo, True)[0] * dr.two_pi,
        "pdf": lambda: bsdf.pdf(ctx, si, wo, True) * dr.two_pi,
        "sample": lambda: bsdf.sample(ctx, si, points.y, points, True)[1][0],
        "null": lambda: bsdf.eval_null_transmission(si, True)[0],
    }[quantity]()
    assert abs(np.mean(np.array(answer)) - due) < 0.005 * max(due, 1)
