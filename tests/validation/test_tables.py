"""Verdicts on measured tables: piecewise, and large kernels."""

from dataclasses import replace

import budget
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gonio_mi import measure
from gonio_mi.validation import validate
from gonio_mi.validation.checks import sampled_pdf
from gonio_mi.validation.conditions import Condition
from gonio_mi.validation.evidence import Evidence
from gonio_mi.validation.probe import Probe
from gonio_mi.validation.samples import samples_of


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Record of a rough metal: a `goniometric` of reflection.

    Of transmission, another mode and components, tests of `goniometric` ask the same.
    """
    mi.set_variant("llvm_ad_mono")
    record = measure(
        {"type": "roughconductor", "alpha": 0.3},
        theta_i=(0, 30, 60),
        collector="angle:9x12",
        rays=2**16,
    )
    path = tmp_path_factory.mktemp("table") / "metal.npz"
    record.save(path)
    return {"type": "goniometric", "filename": str(path)}


def test_table_is_judged(table):
    verdict = validate(table, effort="quick", alpha=budget.ALPHA, allow="reciprocity")
    assert verdict.passed, str(verdict)
    assert verdict["sampling"].status == "holds"


def test_table_with_a_density_of_another_incidence_is_caught(table):
    """The twin of the test above: by a degree only."""
    bsdf, condition = mi.load_dict(table), Condition(40.0, 25.0)
    samples, evidence = samples_of(bsdf, condition, 2**12, (0, 1)), Evidence(bsdf)
    sampled_pdf.check_samples(evidence, samples)
    assert not evidence.breaches
    plugin, ctx, si, u = samples.asked
    other = Probe(bsdf, replace(condition, theta_i=41.0)).interactions(samples.n)

    class OfAnotherIncidence:
        def sample(self, *asked):
            return plugin.sample(*asked)

        def pdf(self, ctx, si, *asked):  # noqa: ARG002
            return plugin.pdf(ctx, other, *asked)

    samples.asked = OfAnotherIncidence(), ctx, si, u
    sampled_pdf.check_samples(evidence, samples)
    assert evidence.of("sampled_pdf")


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
