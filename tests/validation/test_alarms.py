"""Right plugins pass; study_of_alarms.py tries all of them with many seeds.

All verdicts on one plugin share one share of the suite's budget (see budget.py); the
twins are the broken plugins of test_verdicts.py.
"""

import budget
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import right_bsdfs
from scipy import stats

from gonio_mi.validation import maps, tally, validate
from gonio_mi.validation.checks import sampled_pdf, sampled_weight, sampling, weights
from gonio_mi.validation.conditions import Condition, Effort
from gonio_mi.validation.evidence import Evidence
from gonio_mi.validation.samples import samples_of

# Of the study alone: seconds each, or between others that are like them.
MORE = (
    *("ggx 0.01", "ggx 0.05", "ggx 0.05, all normals", "ggx 0.2", "plastic"),
    *("rough glass 0.01", "rough glass 1", "rough glass of index 1.0001"),
    *("rough glass of index 3", "glass of index 1.01", "glass of index 3"),
    *("bitmap", "checkerboard of roughness", "principled metal"),
    *("bump map", "mask"),  # of `unusual_right` there are more of them
)


# Samplers of growing tails, and seeds of each: p-values of one view in 48 maps.
TAILS = (
    "lambert by uniform",
    "lambert by cosine^3",
    "ggx 0.1 by cosine",
    "ggx 0.5 by mirrored power",
    "ggx 0.3 by beckmann 0.4",
    "ggx 0.3 by ggx 0.1",
)
TRIALS = 8


def alarms(name, specimen):
    """What fails though it is right, as text; nothing if all is well."""
    bsdf = mi.load_dict(specimen)
    verdict = validate(bsdf, effort="quick", seed=0, alpha=budget.ALPHA, strict=True)
    failed = {one.name for one in verdict.failures}
    return f"{verdict}" if failed - right_bsdfs.KNOWN.get(name, set()) else ""


@pytest.mark.parametrize(
    "name", [name for name in right_bsdfs.RIGHT if name not in MORE]
)
def test_right_plugins_pass(name):
    assert not alarms(name, right_bsdfs.RIGHT[name])


def test_right_maps_pass():
    """Textures, maps of heights and normals, and what holds other BSDFs."""
    for name, specimen in right_bsdfs.textured().items():
        assert name in MORE or not alarms(name, specimen)


@pytest.mark.parametrize(
    "name", [name for name in right_bsdfs.HEAVY if name not in TAILS]
)
def test_heavy_weights_are_no_fault(name):
    """Whatever their tails, up to an infinite variance."""
    right_bsdfs.register()
    assert not alarms(name, {"type": "heavy", "case": name})


class Heavier:
    """What properties ask, with weights times a factor, and densities over another."""

    def __init__(self, samples, factor, density=1.0):
        self.bsdf, *rest = samples.asked
        self.factor, self.density = factor, density
        samples.asked = self, *rest
        samples.weight = samples.weight * np.reshape(factor, (-1, 1))
        samples.sampled_pdf = samples.sampled_pdf / density

    def __getattr__(self, name):
        return getattr(self.bsdf, name)

    def sample(self, *asked):
        bs, weight = self.bsdf.sample(*asked)
        bs = mi.BSDFSample3f(bs)
        bs.pdf = bs.pdf / self.density
        return bs, weight * mi.Float(self.factor)


@pytest.mark.parametrize(
    ("name", "component"),
    [("ggx 0.01, all normals", None), ("rough glass of index 1.0001", 0)],
)
@pytest.mark.parametrize("off", [1.0, 1.05], ids=["right", "twin"])
def test_rounding_is_no_fault(name, component, off):
    """Of a cosine that rounds to 1, and of indices that are nearly equal."""
    bsdf = mi.load_dict(right_bsdfs.RIGHT[name])
    condition = Condition(50.0, 25.0, component=component)
    samples = samples_of(bsdf, condition, 2**14, (0, 1))
    Heavier(samples, off, off)
    evidence = Evidence(bsdf)
    for check in (sampled_pdf, sampled_weight):
        check.check_samples(evidence, samples)
    assert bool(evidence.breaches) == (off != 1)


@pytest.mark.parametrize("wrong", [0, 200], ids=["right", "twin"])
def test_steps_that_displacements_miss_are_no_fault(wrong):
    """Fresnel's reflectance of nearly equal indices has few steps of 3e-4 to 9e-4.

    In 88 of 2^16 samples no usual displacement meets one, though `sample` does. In the
    twin 200 weights are off by 2 %.
    """
    bsdf = mi.load_dict(right_bsdfs.RIGHT["rough glass of index 1.0001"])
    samples = samples_of(bsdf, Condition(20.0, 25.0, component=0), 2**16, (0, 5))
    off = np.where(np.cumsum(samples.usable) <= wrong, 1.02, 1.0)
    Heavier(samples, off)
    evidence = Evidence(bsdf)
    sampled_weight.check_samples(evidence, samples)
    assert bool(evidence.breaches) == bool(wrong)


def test_tails_too_heavy_to_judge_are_told():
    right_bsdfs.register()
    bsdf = mi.load_dict({"type": "heavy", "case": "lambert by cosine^10"})
    found = validate(bsdf, effort="quick")["weights"]
    assert found.status == "undecided"
    assert found.effect == "adds noise"
    assert "tails are too heavy" in found.statistic


def test_a_density_that_underflows_has_no_hole():
    """At grazing incidence much of the light is where facets have no density left."""
    right_bsdfs.register()
    bsdf = mi.load_dict({"type": "heavy", "case": "ggx 0.3 by beckmann 0.4"})
    grid = Effort.named("quick").patches
    found = maps.four_maps(bsdf, Condition(89.0, 0.0), grid, 2**15, (0, 1))
    assert found.due.unreached.values.sum() > 1e-3 * found.smooth_flux[0]
    evidence = Evidence()
    for check in (sampling, weights):
        check.check_maps(evidence, found)
    assert not evidence.breaches
    assert "tails are too heavy" in evidence.undecided["weights"]


@pytest.mark.parametrize(("name", "pooled"), [("tabulated", False), ("ward", True)])
def test_sums_that_do_not_vary_are_not_pooled(name, pooled):
    """All samples of a table are collected; facets (the twin) reflect some downwards.

    The table has jumps, so that the error of its integral, the same in each map, is
    larger than what chance does.
    """
    right_bsdfs.register()
    bsdf, grid = mi.load_dict({"type": name}), Effort.named("quick").patches
    evidence = Evidence(bsdf)
    evidence.maps += [
        maps.four_maps(bsdf, Condition(theta_i, 25.0), grid, 2**17, (0, 1))
        for theta_i in (35.0, 60.0)
    ]
    sampling.check_pooled(evidence)
    assert any(test.name == "sampling" for test in evidence.tests) == pooled


@pytest.mark.parametrize("sector", ["any", "one"])
def test_a_direction_that_rounds_to_the_pole_has_any_azimuth(sector, monkeypatch):
    """Some of a smooth lobe at normal incidence; of the twin all go to one sector."""
    if sector == "one":
        monkeypatch.setattr(tally, "_with_azimuth", lambda wo, _: wo)
    bsdf = mi.load_dict(right_bsdfs.GGX | {"alpha": 0.004, "sample_visible": False})
    grid = Effort.named("quick").patches
    found = maps.four_maps(bsdf, Condition(0.0, 25.0), grid, 2**19, (0, 1))
    p = budget.Verdict(found.count_scores.p_values)
    (budget.agree if sector == "any" else budget.disagree)(p)


@pytest.mark.parametrize("lit_behind", [False, True], ids=["right", "twin"])
def test_samples_without_a_direction_are_no_light(lit_behind):
    """Behind, `roughconductor` answers with weight 0 and a direction that is NaN.

    A wrapper whose `eval` multiplies by a function of that direction returns NaN there,
    which nobody asks for. The twin returns light for true directions.
    """

    class Tinted(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.inner = mi.load_dict({"type": "roughconductor", "alpha": 0.3})
            self.m_components = [self.inner.flags(0)]
            self.m_flags = self.inner.flags()

        def eval(self, ctx, si, wo, active=True):
            value = self.inner.eval(ctx, si, wo, active)
            behind = (si.wi.z < 0) & (wo.z < 0) & lit_behind
            return value * (1 - 0.1 * wo.z) + dr.select(behind, 0.1, 0)

        def pdf(self, *arguments):
            return self.inner.pdf(*arguments)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx, si, *arguments):
            bs, weight = self.inner.sample(ctx, si, *arguments)
            if lit_behind:
                bs.wo = dr.select(si.wi.z < 0, mi.Vector3f(0, 0, -1), bs.wo)
            return bs, weight

        def to_string(self):
            return "Tinted[]"

    mi.register_bsdf("tinted", Tinted)
    verdict = validate({"type": "tinted"}, effort="quick", seed=0)
    assert (verdict["flags"].status == "fails") == lit_behind


@pytest.fixture(scope="module")
def scored():
    """Scores of weights of right plugins, and of the same if their sums were normal."""
    mi.set_variant("llvm_ad_mono")
    right_bsdfs.register()
    effort = Effort.named("quick")
    condition = Condition(35.0, 25.0)
    n_limits = 2 * effort.patches.n_patches + 1
    undamped = tally.Damping(np.zeros(0, int), np.full(n_limits, np.inf))
    found = []
    for name in TAILS:
        bsdf = mi.load_dict({"type": "heavy", "case": name})
        for trial in range(TRIALS):
            key = (trial, len(found))
            one = maps.four_maps(bsdf, condition, effort.patches, 2**15, key)
            plain = maps.patch_totals(
                bsdf, condition, effort.patches, 2**15, key, undamped
            )
            found.append((one, plain))
    return found


def uniform(p):
    """Probability of such p-values by chance (Kolmogorov and Smirnov)."""
    return stats.kstest(p, "uniform").pvalue


@pytest.mark.parametrize("view", ["mean", "spread", "worst", "total"])
def test_p_values_are_uniform(scored, view):
    p = [one.weight_scores.p_values[view] for one, _ in scored]
    budget.agree(budget.Verdict({view: uniform(p)}))


def test_sums_of_heavy_weights_are_not_normal(scored):
    """The twin: what is not damped, with its own standard error, is another matter."""
    p = []
    for one, plain in scored:
        first, n = one.damping.first, plain.n
        due = np.add.reduceat(one.due.channels[0].values, first)
        sums = np.add.reduceat(plain.sums, first)
        squares = np.add.reduceat(plain.squares, first)
        z = (sums - n * due) / np.sqrt(squares - sums**2 / n)
        p.append(maps.Scores(z, first, 0.0).p_values["worst"])
    budget.disagree(budget.Verdict({"worst": uniform(p)}))
