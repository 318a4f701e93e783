"""Verdicts on measured tables: piecewise, and large kernels."""

import budget
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gonio_mi import measure
from gonio_mi.validation import validate
from gonio_mi.validation.conditions import Condition
from gonio_mi.validation.probe import Probe


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Record of rough glass: a `goniometric` of reflection and transmission."""
    mi.set_variant("llvm_ad_mono")
    record = measure(
        {"type": "roughdielectric", "alpha": 0.3},
        theta_i=(0, 30, 60),
        collector="angle:9x12",
        rays=2**16,
    )
    path = tmp_path_factory.mktemp("table") / "glass.npz"
    record.save(path)
    return {"type": "goniometric", "filename": str(path)}


def test_table_is_judged(table):
    verdict = validate(table, effort="quick", alpha=budget.ALPHA, allow="reciprocity")
    assert verdict.passed, str(verdict)
    assert verdict["sampling"].status == "holds"


def test_table_with_a_density_of_another_incidence_is_caught(table):
    """The twin of the test above: by a degree only."""
    inner = mi.load_dict(table)

    class Twin(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.m_components = [inner.flags(i) for i in range(2)]
            self.m_flags = inner.flags()

        def sample(self, ctx, si, sample1, sample2, active=True):
            return inner.sample(ctx, si, sample1, sample2, active)

        def eval(self, ctx, si, wo, active=True):
            return inner.eval(ctx, si, wo, active)

        def pdf(self, ctx, si, wo, active=True):
            other = mi.SurfaceInteraction3f(si)
            other.wi = dr.normalize(si.wi + mi.Vector3f(0.017, 0, 0))
            return inner.pdf(ctx, other, wo, active)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return "Twin"

    mi.register_bsdf("table_twin", Twin)
    verdict = validate({"type": "table_twin"}, effort="quick", allow="reciprocity")
    assert not verdict.passed
    assert verdict.function == "pdf", str(verdict)


def test_all_conditions_share_the_kernels_of_a_function(mono):
    """Compiling is what takes long: thirty-odd kernels, once 300, of a large plugin."""
    del mono
    bsdf = mi.load_dict({"type": "roughdielectric"})

    def asked(condition, n, lit=None):
        wo = mi.Vector3f(np.random.default_rng(n).normal(size=(3, n)))
        numbers = mi.Float(wo.x), mi.Point2f(wo.y, wo.z)
        dr.eval(numbers)
        probe = Probe(bsdf, condition)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            probe.eval(wo, wi=lit)
            probe.pdf(dr.normalize(wo), wi=lit)
            probe.sample(*numbers, wi=lit)
            kernels = {k["hash"] for k in dr.kernel_history() if "hash" in k}
            dr.kernel_history_clear()
        return kernels

    known = asked(Condition(0.0), 50)
    assert asked(Condition(0.0), 50) <= known
    assert asked(Condition(40.0, 25.0, "back", (0.1, 0.2)), 70) <= known
    lit = mi.Vector3f(np.random.default_rng(1).normal(size=(3, 70)))
    dr.eval(lit)
    assert asked(Condition(40.0), 70, lit) <= known
    assert not asked(Condition(40.0, mode="radiance"), 70) <= known
