"""Standard errors and intervals against SciPy's own, by rounding alone."""

import numpy as np
import pytest
from budget import Verdict, agree, disagree, single
from scipy import special, stats

from gonio_mi.results import statistics

EPS = np.finfo(float).eps
# rounding: a few operations, and two implementations of the same special function
# that are each good to some tens of eps
FUNCTIONS = 1000 * EPS


def test_ratio_of_sums():
    sums = np.array([[1, 2], [3, 5], [6, 8]], dtype=np.uint64)
    incident = np.array([[10], [10], [20]], dtype=np.uint64)
    np.testing.assert_array_equal(statistics.ratio(sums, incident), [10 / 40, 15 / 40])
    assert np.isnan(statistics.ratio(0 * sums, 0 * incident)).all()


def test_std_err_of_equal_batches_is_that_of_their_mean():
    sums = np.array([[1, 20], [3, 50], [6, 80], [7, 70]], dtype=np.uint64)
    incident = np.full((4, 1), 100, np.uint64)
    expected = stats.sem(sums / 100, axis=0)
    # rounding: some ten operations
    np.testing.assert_allclose(
        statistics.batch_std_err(sums, incident), expected, rtol=16 * EPS
    )
    assert np.isnan(statistics.batch_std_err(sums[:1], incident[:1])).all()


def test_std_err_of_batches_of_one_ratio_is_zero():
    """Whatever their sizes: only the scatter of the ratio counts."""
    incident = np.array([10, 20, 40], dtype=np.uint64)
    assert statistics.batch_std_err(incident // np.uint64(2), incident) == 0


def test_std_err_of_unequal_batches_is_cochrans():
    """Eq. 6.13: of n batches, sum (y - R x)^2 n / (n - 1), over the sum of x."""
    sums, incident = np.array([1, 5, 3], np.uint64), np.array([10, 30, 20], np.uint64)
    residual = np.array([1, 5, 3]) - 9 / 60 * np.array([10, 30, 20])
    expected = np.sqrt(np.sum(residual**2) * 3 / 2) / 60
    # rounding: some ten operations
    np.testing.assert_allclose(
        statistics.batch_std_err(sums, incident), expected, rtol=16 * EPS
    )


def test_std_err_of_unlike_batches_leaves_each_out():
    """Efron's jackknife; of a batch that has most, Cochran's sees little deviation."""
    sums, incident = np.array([1.0, 2.0, 90.0]), np.array([3.0, 5.0, 92.0])
    without = (sums.sum() - sums) / (incident.sum() - incident)
    expected = np.sqrt(np.sum((without - 93 / 100) ** 2) * (1 - 1 / 3))
    found = statistics.batch_std_err(sums, incident, unlike=True)
    # rounding: some ten operations, one of them a difference of near numbers
    np.testing.assert_allclose(found, expected, rtol=64 * EPS)
    assert found > 2 * statistics.batch_std_err(sums, incident)


def test_effective_batches():
    """Exact: all of them if alike, in any unit; one that has all is one and a part."""
    np.testing.assert_array_equal(statistics.effective_batches(np.full(16, 2.0)), 16)
    alone = np.array([0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(statistics.effective_batches(alone), 1 + 3 / 4)


def test_binomial_std_err():
    std_err = statistics.binomial_std_err(np.array([0, 25, 100]), 100)
    # rounding: some five operations
    np.testing.assert_allclose(
        std_err, [np.nan, np.sqrt(0.25 * 0.75 / 100), 0], rtol=8 * EPS
    )


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("rays", [1, 30, 1000])
def test_binomial_interval_is_clopper_and_pearsons(rays, level):
    """At either limit, what was seen or more extreme has the chance (1 - level) / 2."""
    hits, tail = np.unique([0, 1, rays // 3, rays - 1, rays]), (1 - level) / 2
    low, high = statistics.binomial_interval(hits, rays, level)
    assert low[0] == 0
    assert high[-1] == 1
    # an eps of a limit p moves the tail by about hits / p + misses / (1 - p) eps
    above = stats.binom.sf(hits[1:] - 1, rays, low[1:])
    moved = hits[1:] + (rays - hits[1:]) / (1 - low[1:])
    assert np.all(np.abs(above / tail - 1) <= FUNCTIONS + moved * EPS)
    below = stats.binom.cdf(hits[:-1], rays, high[:-1])
    moved = hits[:-1] + (rays - hits[:-1]) / (1 - high[:-1])
    assert np.all(np.abs(below / tail - 1) <= FUNCTIONS + moved * EPS)


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("n_batches", [2, 3, 16])
def test_student_interval(n_batches, level):
    value, std_err = np.array([1.0, 2.0]), np.array([0.1, 0.3])
    interval = statistics.student_interval(value, std_err, n_batches, level)
    exact = stats.t.interval(level, n_batches - 1, value, std_err)
    np.testing.assert_allclose(interval, exact, rtol=FUNCTIONS)


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999, 1 - 2.0**-20, 1 - 2.0**-50])
def test_student_quantile(level):
    """Against SciPy's, of dof from 1 on, also between whole numbers."""
    dof = np.array([1, 1.3, 2, 3, 4.7, 15, 63, 1e3, 1e5, 1e6, 1e8, 1e9])
    quantiles = [statistics.student_quantile(one, level) for one in dof]
    exact = -special.stdtrit(dof, (1 - level) / 2)
    np.testing.assert_allclose(quantiles, exact, rtol=FUNCTIONS)


def test_student_interval_of_batches_of_unlike_numbers():
    n_batches, std_err = np.array([[2.0], [4.5]]), np.array([0.1, 0.3])
    interval = statistics.student_interval(1.0, std_err, n_batches, 0.9)
    exact = stats.t.interval(0.9, n_batches - 1, 1.0, std_err)
    np.testing.assert_allclose(interval, exact, rtol=FUNCTIONS)


def test_student_interval_has_a_resolution():
    std_err = np.array([0.0, np.nan])
    low, high = statistics.student_interval(1.0, std_err, 4, 0.9, 0.25, above=0.5)
    np.testing.assert_array_equal((low, high), [[0.75, np.nan], [1.5, np.nan]])


def test_gamma_interval_of_equal_weights_is_that_of_their_count():
    """The exact Poisson interval (Garwood 1936), by the chi-square law of SciPy."""
    hits, weight = np.array([1, 3, 40]), 0.25
    low, high = statistics.gamma_interval(
        hits * weight, np.sqrt(hits) * weight, weight, 0.9
    )
    # the variance is a square of a root
    rtol = FUNCTIONS + 16 * EPS
    np.testing.assert_allclose(
        low, weight * stats.chi2.ppf(0.05, 2 * hits) / 2, rtol=rtol
    )
    np.testing.assert_allclose(
        high, weight * stats.chi2.ppf(0.95, 2 * hits + 2) / 2, rtol=rtol
    )
    # without a scatter, the upper limit of a hit of the largest weight
    low, high = statistics.gamma_interval(np.array([0.5]), np.array([0.0]), 1.0, 0.9)
    assert low == 0.5
    np.testing.assert_allclose(high, stats.gamma.ppf(0.95, 1.5**2) / 1.5, rtol=rtol)


def test_gamma_interval_counts_the_heavy_hits_that_explain_the_scatter():
    """Of a sum of 7.5 that scatters as 3 hits of 1/2, 6 are certain; or all, as one."""
    hits, weight = np.array([3.0, 0.0]), 0.5
    low, high = statistics.gamma_interval(
        6 + hits * weight, np.sqrt(hits) * weight, weight, 0.9, weight
    )
    rtol = FUNCTIONS + 16 * EPS
    limit = stats.chi2.ppf([0.05, 0.95], [6, 8]) / 2
    np.testing.assert_allclose((low[0], high[0]), 6 + weight * limit, rtol=rtol)
    limit = stats.chi2.ppf(0.95, 2) / 2
    np.testing.assert_allclose((low[1], high[1]), (6, 6 + weight * limit), rtol=rtol)


@pytest.mark.parametrize("n_batches", [10, 64])
def test_one_hit_that_scatters_tells_its_weight(n_batches):
    """Exact up to rounding, which is its sum.

    A single hit in a patch may be one of many alike, and of few batches one may differ
    by chance.
    """
    sums = np.zeros((n_batches, 2, 3, 1))
    sums[1, 0, 1] = 8
    incident = np.full((n_batches, 1, 1, 1), 100.0)
    hits = np.full((2, 3, 1), 4)
    found, share = statistics.heavy_hits(sums, incident, hits)
    np.testing.assert_allclose(found, 8 / (100 * n_batches), rtol=64 * EPS)
    # of one in 24 hits; that all four of its patch weigh 2 takes one of four parts off
    np.testing.assert_allclose(share, 0.75 / 24, rtol=64 * EPS)
    assert statistics.heavy_hits(sums, incident, hits // 4)[0] == 0
    assert statistics.heavy_hits(sums[:2], incident[:2], hits)[0] == 0
    assert statistics.heavy_hits(0 * sums, incident, hits)[0] == 0


def test_weight_of_the_hits_that_scatter():
    """Of independent hits, a hundredth of which weigh 1 and all others 0.05.

    Of h hits, ``(h - 1) V`` and ``(h - 1) 3 m V + (h - 1/h) K`` are more than hits of
    their mean weight m have, with V and K the second and third central moments of the
    weight of one; the latter counts h / (h + 1) times. Twins: the mean weight, and
    E[w^2] / E[w].
    """
    rng = np.random.default_rng(3)
    means = np.geomspace(0.1, 1000, 100)[:, None, None]
    weights, shares = np.array([0.05, 1.0]), np.array([0.99, 0.01])
    mean = shares @ weights
    second, third = (shares @ (weights - mean) ** power for power in (2, 3))
    found, expected = [], []
    for _ in range(60):
        counts = rng.poisson(means * shares / 16, (16, 100, 1, 2))
        hits = counts.sum(axis=(0, 3))[..., None]
        incident = np.full((16, 1, 1, 1), 1 / 16)
        sums = counts @ weights[:, None]
        found.append(statistics.heavy_hits(sums, incident, hits)[0][0])
        hits = np.maximum(hits, 1)
        part = ((hits - 1) / (hits + 1)).sum() / (1 - 1 / hits).sum()
        expected.append(third / second + 3 * mean * part)
    std_err = np.std(found, ddof=1) / 60**0.5
    agree(single((np.mean(found) - np.mean(expected)) / std_err))
    for wrong in (mean, shares @ weights**2 / mean):
        disagree(single((np.mean(found) - wrong) / std_err))


def test_patches_that_differ_in_weight_do_not_scatter():
    """As the lobe and the background of a blend; twin: both weights in each patch."""
    rng = np.random.default_rng(8)
    weights = np.where(np.arange(900) < 90, 1.0, 0.05)[:, None]
    incident = np.full((16, 1, 1, 1), 1 / 16)

    def _verdict(of_each_hit):
        told = 0
        for mean in np.geomspace(0.3, 1000, 60):
            counts = rng.poisson(mean / 16, (16, 900, 1))
            if of_each_hit:
                heavy = rng.binomial(counts, 0.1)
                sums = 0.05 * counts + 0.95 * heavy
            else:
                sums = counts * weights
            hits = counts.sum(axis=0)[..., None]
            told += statistics.heavy_hits(sums[..., None], incident, hits)[0][0] > 0
        p = stats.binom.sf(told - 1, 60, stats.norm.sf(statistics.MIN_SKEWNESS))
        return Verdict({"told": float(p)})

    agree(_verdict(False))
    disagree(_verdict(True))


def test_gamma_interval_of_few_unlike_weights_covers():
    """Poisson counts of two weights; twin: the normal interval of the same sums."""
    rng = np.random.default_rng(5)
    weights, means = np.array([0.1, 1.0]), np.array([8.0, 1.0])
    counts = rng.poisson(means, (20_000, 2))
    counts = counts[counts.any(axis=1)]
    value, std_err = counts @ weights, np.sqrt(counts @ weights**2)

    def _verdict(low, high):
        outside = np.count_nonzero((low > weights @ means) | (high < weights @ means))
        p = stats.binom.sf(outside - 1, len(value), 0.05)
        return Verdict({"outside": float(p)})

    agree(_verdict(*statistics.gamma_interval(value, std_err, 1.0, 0.95)))
    disagree(_verdict(*stats.norm.interval(0.95, value, std_err)))


@pytest.mark.parametrize("level", [0.5, 0.95])
@pytest.mark.parametrize("rays", [1, 10, 10**9])
def test_upper_limit_leaves_a_patch_empty_as_often_as_it_says(rays, level):
    limit = statistics.upper_limit(rays, level)
    # rounding: log, division and exponential, and the power of the check that makes
    # n eps of the eps in 1 - p, by log1p none
    empty = np.exp(rays * np.log1p(-limit))
    np.testing.assert_allclose(empty, (1 - level) / 2, rtol=64 * EPS)
