# ruff: noqa: ARG001, ARG002 (every method has Mitsuba's signature)
"""Functions that Mitsuba's loops cannot record, which `mi.render` needs."""

import drjit as dr
import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest

from gonio_mi.validation import validate


def value_by_numpy(self, ctx, si, wo):
    cosine = np.maximum(np.array(wo.z), 0)
    return mi.Spectrum(mi.Float(np.float32(0.8 / np.pi * cosine)))


def pdf_by_branch(self, ctx, si, wo, active=True):
    lit = active & self.above(si, wo)
    if dr.none(lit):
        return mi.Float(0.0)
    return dr.select(lit, self.density(ctx, si, wo), 0)


def pdf_in_a_loop(self, ctx, si, wo, active=True):
    """As many plugins draw by rejection: what Dr.Jit records."""
    _, density = dr.while_loop(
        (mi.UInt32(0), mi.Float(0.0)),
        lambda i, _: i < 2,
        lambda i, sum_: (i + 1, sum_ + 0.5 * self.density(ctx, si, wo)),
    )
    return dr.select(active & self.above(si, wo), density, 0)


CASES = {
    "eval": {"value": value_by_numpy},
    "pdf": {"pdf": pdf_by_branch},
    "": {"pdf": pdf_in_a_loop},
}


def renders(name):
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "surface": {"type": "rectangle", "bsdf": {"type": name}},
            "light": {"type": "constant"},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f()
                .translate([0, 0, 3])
                .rotate([0, 1, 0], 180),
                "film": {
                    "type": "hdrfilm",
                    "width": 2,
                    "height": 2,
                    "pixel_format": "luminance",
                },
            },
        }
    )
    try:
        mi.render(scene, spp=1)
    except RuntimeError:
        return False
    return True


@pytest.mark.parametrize("function", CASES)
def test_a_function_that_no_loop_records_is_told(function):
    plugin = type("Plugin", (plain_bsdf.plain(),), CASES[function])
    mi.register_bsdf("recorded", plugin)
    judged = validate({"type": "recorded"}, effort="quick")
    assert judged.passed
    found = judged["cost"]
    assert found.status == "holds"
    assert (found.effect == "adds cost") == bool(function)
    assert (f"`{function}` cannot be recorded" in found.statistic) == bool(function)
    # with BSDFs of other tests, if these are kept, a right one may not render either
    assert not (function and renders("recorded"))


def test_a_phase_function_that_no_loop_records_is_told():
    class Isotropic(mi.PhaseFunction):
        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.m_flags = mi.PhaseFunctionFlags.Isotropic
            self.m_components = [self.m_flags]

        def sample(self, ctx, mei, sample1, sample2, active):
            wo = mi.warp.square_to_uniform_sphere(sample2)
            return wo, mi.Spectrum(1.0), mi.Float(dr.inv_four_pi)

        def eval_pdf(self, ctx, mei, wo, active):
            n = len(np.array(wo.z))
            pdf = mi.Float(np.full(n, 1 / (4 * np.pi), np.float32))
            return mi.Spectrum(pdf), pdf

        def to_string(self):
            return "Isotropic[]"

    mi.register_phase("isotropic_by_numpy", Isotropic)
    judged = validate({"type": "isotropic_by_numpy"}, effort="quick")
    assert "cannot be recorded" in judged["cost"].statistic
