"""Nominal intervals cover the truth as often as they say, for many and few hits.

Each verdict takes a share of the suite's false-alarm budget.
"""

from functools import cache

import mitsuba as mi
import numpy as np
import pytest
from budget import Verdict, agree, disagree, normal_scores, single
from scipy import stats

import gonio_mi as gonio

LEVEL = 0.95
SEEDS = 32
RHO = 0.5

# of the 100 equal patches of a grey Lambertian, each receives RHO / 100 of the rays
COLLECTOR = "projected:10x10"


@cache
def runs(rays, estimator):
    """Intervals of the patches and of dhr, ``(low, high)``, for each seed."""
    mi.set_variant("llvm_ad_mono")
    grey = mi.load_dict({"type": "diffuse", "reflectance": RHO})
    records = [
        gonio.measure(
            grey,
            theta_i=30,
            collector=COLLECTOR,
            rays=rays,
            estimator=estimator,
            sampler="independent",
            seed=seed,
        )
        for seed in range(SEEDS)
    ]
    return [(r.interval(LEVEL), r.interval(LEVEL, of="dhr")) for r in records]


def coverage(rays, estimator, shrink=1.0):
    """Covered fraction of the patches of each run."""
    fractions = []
    for (low, high), _ in runs(rays, estimator):
        middle, half = (low + high) / 2, shrink * (high - low) / 2
        fractions.append(np.mean(np.abs(RHO / np.pi - middle) <= half))
    return np.array(fractions)


def score(fractions):
    """Score of the mean coverage against LEVEL, from the scatter between runs."""
    std_err = fractions.std(ddof=1) / np.sqrt(len(fractions))
    return normal_scores((fractions.mean() - LEVEL) / std_err, len(fractions) - 1)


def wide_enough(z):
    """Verdict on intervals not being too narrow."""
    return Verdict({"coverage": float(stats.norm.cdf(z))})


@pytest.mark.parametrize(
    ("rays", "estimator"),
    [(300, "analog"), (300, "weighted"), (200_000, "weighted")],
)
def test_patch_intervals_cover(rays, estimator):
    """About 1.5, 3 and 2000 hits a patch; others: ``benchmark --coverage``."""
    z = score(coverage(rays, estimator))
    if rays == 200_000:
        agree(single(z))
    else:  # exact intervals of few hits may cover more
        agree(wide_enough(z))


def test_narrow_intervals_are_caught():
    """Twin: intervals of 0.85 of their width cover 90 %, and the score says so."""
    z = score(coverage(200_000, "weighted", shrink=0.85))
    disagree(wide_enough(z))
    disagree(single(z))


def test_total_interval_covers():
    """Dhr of a grey specimen under the analog estimator is binomial."""
    covered = sum(low[0] <= RHO <= high[0] for _, (low, high) in runs(300, "analog"))
    agree(Verdict({"covered": float(stats.binom.cdf(covered, SEEDS, LEVEL))}))
    # twin: the true value of another specimen
    wrong = sum(low[0] <= 0.6 <= high[0] for _, (low, high) in runs(300, "analog"))
    disagree(Verdict({"covered": float(stats.binom.cdf(wrong, SEEDS, LEVEL))}))


@pytest.mark.parametrize("rays", [3, 10])
def test_no_limit_of_a_patch_is_negative(rays):
    """Exact: deposits of few rays scatter by more than their sum."""
    mi.set_variant("llvm_ad_mono")
    settings = {"rays": rays, "collector": "projected:3x4", "trace": True}
    settings["estimator"] = "next_event"
    record = gonio.measure({"type": "diffuse", "reflectance": RHO}, 30, **settings)
    low, _ = record.interval(LEVEL)
    half = stats.t.ppf((1 + LEVEL) / 2, record.n_batches - 1) * record.brdf_std_err
    assert np.nanmin(record.brdf - half) < 0, "twin: Student's t alone"
    assert low.min() == 0


@pytest.mark.promise("an upper limit")
def test_empty_patches_have_an_upper_limit():
    """No hit in n rays: 1 - ((1 - level) / 2)^(1 / n), never 0 +- 0."""
    mi.set_variant("llvm_ad_mono")
    record = gonio.measure(
        {"type": "conductor"},
        theta_i=30,
        rays=1000,
        estimator="analog",
        sampler="independent",
    )
    low, high = record.interval(LEVEL)
    empty = record.counts[0] == 0
    limit = -np.expm1(np.log(0.025) / 1000)
    size = record.subdivision.projected_solid_angles[0, 0]
    assert empty.sum() == 899
    assert np.all(low[empty] == 0)
    # one rounding of each of the few operations
    np.testing.assert_allclose(high[empty], limit / size, rtol=16 * np.finfo(float).eps)
    assert np.all(np.isnan(record.brdf_std_err[empty]))
