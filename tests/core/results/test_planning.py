"""Numbers of rays: the paper's formulas, the planner's promise, and when to stop."""

import math

import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import Verdict, agree, disagree
from scipy import stats

import gonio_mi as gonio
from gonio_mi.results import planning
from gonio_mi.results.planning import lobe

PAPER = {"epsilon": 0.005, "delta": 0.01}
EPS = np.finfo(float).eps


def test_equation_17():
    """The paper's own numbers: 105 967 rays, 10^5.025."""
    assert planning.chebyshev_rays(**PAPER) == 105_967
    assert round(math.log10(105_967), 3) == 5.025


def test_equation_21_and_the_union_bound():
    assert planning.paper_rays(900, **PAPER) == 900 * 105_967
    exact = math.log(2 * 900 / 0.01) / (2 * 0.005**2)
    assert planning.union_rays(900, **PAPER) == math.ceil(exact)
    assert planning.union_rays(1, **PAPER) == planning.chebyshev_rays(**PAPER)


@pytest.mark.parametrize("epsilon", [0.0, 1.0, -0.1, float("nan"), "abc"])
def test_epsilon_outside_is_refused(epsilon):
    with pytest.raises((ValueError, TypeError), match="epsilon must be a number in"):
        planning.chebyshev_rays(epsilon, 0.01)


def test_relative_rays_of_one_patch():
    """One patch: N = z^2 (1 - p) / (p eps^2), the normal theory of a proportion."""
    p, rel_err, level = 0.01, 0.05, 0.9
    z = stats.norm.isf((1 - level) / 2)
    expected = math.ceil((z / rel_err) ** 2 * (1 - p) / p)
    # the odds carry a guard of 1e-12, far below one ray
    assert abs(planning.relative_rays([p], rel_err, level) - expected) <= 1


@pytest.mark.parametrize("probabilities", [[], [0.0], [0.5, -0.1], [1.5]])
def test_impossible_probabilities_are_refused(probabilities):
    with pytest.raises(ValueError, match="probabilities must be at least one"):
        planning.relative_rays(probabilities, 0.01)


def campaigns(factor):
    """Successes of 200 simulated campaigns, with `factor` times the rays asked."""
    grid = gonio.subdivision("solid:10x20")
    p = (grid.projected_solid_angles / np.pi).ravel()
    rays = int(factor * planning.relative_rays(p, 0.05, 0.95))
    fraction, _ = planning.simulated_reliability(p, 0.05, rays, campaigns=200)
    return round(200 * fraction)


def test_simultaneous_reliability_is_delivered():
    """Asked for 95 %, at least 95 %: not fewer successes than chance allows."""
    successes = campaigns(1.0)
    agree(Verdict({"successes": float(stats.binom.cdf(successes, 200, 0.95))}))


def test_too_few_rays_are_caught():
    """Twin: with half of the rays the same test fails."""
    few = campaigns(0.5)
    disagree(Verdict({"successes": float(stats.binom.cdf(few, 200, 0.95))}))


def test_std_err_of_simulated_reliability():
    """Of a proportion of 50 campaigns; of one in 50 where none or all succeeded."""
    p = np.full(20, 0.05)
    fraction, std_err = planning.simulated_reliability(p, 0.2, 5000, campaigns=50)
    assert 0 < fraction < 1
    # rounding: a handful of operations
    expected = math.sqrt(fraction * (1 - fraction) / 50)
    assert std_err == pytest.approx(expected, rel=4 * EPS)
    fraction, std_err = planning.simulated_reliability(p, 0.9, 5000, campaigns=50)
    assert (fraction, std_err) == (1, pytest.approx(1 / 50, rel=4 * EPS))


def test_reliability_is_the_union_bound():
    """Two tails of the normal law for each patch; 0 where that is no bound."""
    p, rays = np.array([0.1, 0.25]), 10**4
    z = 0.03 * np.sqrt(rays * p / (1 - p))
    expected = 1 - 2 * stats.norm.sf(z).sum()
    # two implementations of the error function, each good to some eps
    found = planning.reliability(p, 0.03, rays)
    assert found == pytest.approx(expected, rel=32 * EPS)
    assert planning.reliability(p, 1e-4, rays) == 0


def test_equal_patches_need_the_rays_of_one_at_a_stricter_level():
    """A union over m: N = z^2 (1 - p) / (p eps^2) for the tail (1 - level) / (2 m)."""
    m, rel_err, level = 50, 0.05, 0.9
    z = stats.norm.isf((1 - level) / (2 * m))
    expected = (z / rel_err) ** 2 * (m - 1)
    found = planning.relative_rays(np.full(m, 1 / m), rel_err, level)
    # up to the next whole ray, and the tolerance of the root, 9e-16 of ln N
    assert abs(found - expected) <= 1 + expected * 32 * EPS * math.log(expected)


@pytest.mark.parametrize("p", [[0.5], [0.2, 1e-6, 0.3], [1.0]])
@pytest.mark.parametrize("rel_err", [0.3, 1e-3])
def test_standard_error_is_that_of_the_rarest_count(p, rel_err):
    """Counts are binomial; one ray less would not do."""
    rays = planning.standard_error_rays(p, rel_err)
    counts = stats.binom([rays, rays - 1], min(p))
    enough, few = counts.std() / np.maximum(counts.mean(), 0.1)
    assert enough <= rel_err * (1 + 8 * EPS)
    assert few > rel_err * (1 - 8 * EPS) or rays == 1


def test_lobe_counts_what_is_above_the_floor():
    values = np.array([[10.0, 1.0], [0.4, 0.0]])
    inside = lobe(values, np.ones((2, 2)), floor=0.1)
    # the mean is 2.85, a tenth of it 0.285
    np.testing.assert_array_equal(inside, [[True, True], [True, False]])


@pytest.fixture
def mono():
    mi.set_variant("llvm_ad_mono")


def measured(**settings):
    return gonio.measure(
        {"type": "diffuse", "reflectance": 0.5},
        30,
        collector="projected:5x6",
        **settings,
    )


@pytest.mark.parametrize("sampler", ["independent", "sobol"])
@pytest.mark.parametrize("estimator", ["analog", "weighted"])
def test_rel_err_is_reached(sampler, estimator):
    record = measured(rel_err=0.005, sampler=sampler, estimator=estimator)
    worst = np.max(record.brdf_std_err / record.brdf)
    assert worst <= 0.005
    assert record.settings["reached"] == worst
    assert record.settings["n_lobe"] == 30
    assert record.settings["paper_rays"] == 30 * 105_967
    assert record.n_batches == 16


@pytest.mark.parametrize("goal", [{"rel_err": 0.005}, {"noise": 0.002}])
def test_rays_of_a_target_are_even(goal):
    """Exact: few launches send them; twin: the most rays that are allowed are not."""
    (batches, each), most = rays_of_batches(goal), 16 * 16_411
    assert (batches, each > 2**14, each % 2**11) == (16, True, 0)
    with pytest.warns(RuntimeWarning, match="was not reached"):
        assert rays_of_batches(goal | {"max_rays": most}) == (16, 16_411)


def rays_of_batches(goal):
    """Batches of a measurement, and the rays of each."""
    record = measured(**goal, sampler="independent")
    return record.n_batches, record.ledger.emitted // record.n_batches


def test_max_rays_comes_first():
    with pytest.warns(RuntimeWarning, match="rel_err of 0.0001 was not reached"):
        record = measured(rel_err=1e-4, max_rays=400_000, sampler="independent")
    assert record.ledger.emitted == 400_000
    assert record.settings["reached"] > 1e-4


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rel_err": 0}, "rel_err must be a number in"),
        ({"rel_err": 0.01, "rays": 100}, "rel_err and rays are mutually exclusive"),
        ({"max_rays": 10**6}, "max_rays requires rel_err"),
        ({"rel_err": 0.01, "max_rays": 5}, "at least 262144, the rays that show"),
        ({"rel_err": 0.01, "floor": 2}, "floor must be a fraction"),
    ],
)
def test_bad_targets(settings, message):
    with pytest.raises(ValueError, match=message):
        measured(**settings)


def test_a_pilot_finds_the_lobe():
    """The conductor lights part of the hemisphere; the plan needs m' only."""
    pilot = gonio.measure({"type": "roughconductor", "alpha": 0.1}, 30, rays=10**5)
    plan = gonio.plan(pilot)
    assert plan.n_patches == 900
    assert 0 < plan.n_lobe < 450
    assert plan.paper_lobe == plan.n_lobe * 105_967
    assert "m'" in str(plan)


def test_the_darkest_channel_decides():
    """Of the channels of a patch the one with the least light needs most rays."""
    grey = synthetic.record(rays=10**6)
    tinted = synthetic.record(rays=10**6, channels=("R", "G"))  # G has a quarter of R
    most = gonio.plan(tinted)
    assert most.n_lobe == gonio.plan(grey).n_lobe
    # a quarter of the light: four times the rays but for 1 - p, which is above 1 / 2
    assert 4 * gonio.plan(grey).relative <= most.relative
    assert most.relative <= 2 * 4 * gonio.plan(grey).relative


def test_a_pilot_without_light_is_refused():
    mi.set_variant("llvm_ad_mono")
    pilot = gonio.measure({"type": "diffuse", "reflectance": 0.0}, 30, rays=1000)
    with pytest.raises(ValueError, match="must have received some light"):
        gonio.plan(pilot)


def test_a_pilot_that_is_the_name_of_a_collector():
    with pytest.raises(
        TypeError, match="pilot must be a Record, got 'projected:30x30'"
    ):
        gonio.plan("projected:30x30")
