"""Which interval a patch gets, on tallies made by hand: exact, or by rounding."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import synthetic
from budget import agree, disagree, often_enough

from gonio_mi.results import statistics
from gonio_mi.results.estimates import (
    MIN_DEPOSITS,
    MIN_EVEN_HITS,
    MIN_HITS,
    ControlledEstimate,
    Estimates,
    IntegralEstimate,
    SplitEstimate,
)
from gonio_mi.results.tally import WEIGHT_SCALE, Fate, Integrals, Tally

EPS = np.finfo(float).eps
LEVEL = 0.9
RAYS = 1000  # of each of two batches
HITS = ((50, 54), (40, 40), (12, 20), (2, 4), (0, 0))


def tally(hits=HITS, weight=0.5):
    """One ring of patches in two batches, whose hits had this weight."""
    hits = np.array(hits, np.uint64).T[:, None, None, :]
    fates = np.zeros((len(hits), len(Fate)), np.uint64)
    fates[:, Fate.REFLECTED] = hits.sum(axis=(1, 2, 3))
    fates[:, Fate.ABSORBED] = RAYS - fates[:, Fate.REFLECTED]
    unit = np.uint64(round(weight * WEIGHT_SCALE))
    return Tally(
        hits=hits.sum(axis=0, dtype=np.uint64),
        sums=(hits * unit)[..., None],
        incident=np.full((len(hits), 1), RAYS * WEIGHT_SCALE, np.uint64),
        fates=fates,
        scale=WEIGHT_SCALE,
    )


def close(found, expected):
    # rounding: some ten operations on either side
    np.testing.assert_allclose(found, expected, rtol=32 * EPS)


def student(estimates, patch):
    """Interval by Student's t of one patch, with what no hit leaves open; from 0 on."""
    sums = estimates.tally.sums[:, 0, 0, patch]
    weight = estimates.patches(0).value[0, patch] * 2 * RAYS / sum(HITS[patch])
    unseen = statistics.upper_limit(2 * RAYS, LEVEL) * weight
    std_err = statistics.batch_std_err(sums, estimates.tally.incident)
    value = estimates.patches(0).value[0, patch]
    ends = statistics.student_interval(value, std_err, 2, LEVEL, unseen, unseen)
    return np.maximum(ends, 0.0)


def test_values_and_standard_errors():
    estimates = Estimates(tally(), independent=True)
    hits = np.array(HITS)
    close(estimates.patches(0).value[0, :, 0], hits.sum(axis=1) * 0.5 / (2 * RAYS))
    scatter = np.abs(np.diff(hits))[:, 0] / 2 * 0.5 / RAYS  # of two batches
    close(estimates.patches(0).std_err[0, :4, 0], scatter[:4])
    assert np.isnan(estimates.patches(0).std_err[0, 4, 0])
    totals = hits.sum(axis=0)
    close(estimates.total(0).value[0], totals.sum() * 0.5 / (2 * RAYS))
    close(estimates.total(0).std_err[0], abs(np.diff(totals)[0]) / 2 * 0.5 / RAYS)


@pytest.mark.parametrize(("independent", "by_student"), [(True, 1), (False, 3)])
def test_few_hits_have_exact_intervals(independent, by_student):
    """From how many hits on Student's t is taken: 100, or 30 of even rays.

    Below, the limits of the count, or of weights unlike each other if these are wider.
    """
    assert sum(HITS[0]) > MIN_HITS > sum(HITS[1])
    assert sum(HITS[2]) > MIN_EVEN_HITS > sum(HITS[3])
    estimates = Estimates(tally(), independent=independent)
    low, high = (limit[0, :, 0] for limit in estimates.patches(0).interval(LEVEL))
    for patch, hits in enumerate(HITS[:4]):
        expected = np.ravel(student(estimates, patch))
        exact = statistics.binomial_interval(sum(hits), 2 * RAYS, LEVEL)
        exact = np.multiply(exact, 0.5)
        value = estimates.patches(0).value[0, patch, 0]
        std_err = estimates.patches(0).std_err[0, patch, 0]
        missed = max(0.5 / (2 * RAYS), std_err**2 / value)
        unlike = statistics.gamma_interval(value, std_err, missed, LEVEL)
        exact = min(exact[0], unlike[0]), max(exact[1], unlike[1])
        assert not np.allclose(exact, expected), "twin: the two are told apart"
        close((low[patch], high[patch]), expected if patch < by_student else exact)
    assert low[4] == 0
    close(high[4], statistics.upper_limit(2 * RAYS, LEVEL))


@pytest.mark.parametrize("n", [2, 4])
def test_few_even_hits_have_the_narrower_limits(n):
    """Of Student's t and of the count, at least those of weighted counts."""
    each = tally([(4, 3, 3, 5)[:n], (9, 9, 9, 9)[:n]], weight=1.0)
    one = Estimates(each).patches(0)
    value, std_err = one.value, one.scatter
    unseen = statistics.upper_limit(n * RAYS, LEVEL)
    ends = statistics.student_interval(value, std_err, n, LEVEL, unseen, unseen)
    exact = statistics.binomial_interval(one.hits[..., None], n * RAYS, LEVEL)
    assert (ends[1] > exact[1]).any() == (n == 2)
    assert (ends[1] < exact[1]).any(), "each is the narrower one somewhere"
    missed = np.fmax(1 / (n * RAYS), std_err**2 / value)
    unlike = statistics.gamma_interval(value, std_err, missed, LEVEL)
    low, high = np.maximum(ends[0], exact[0]), np.minimum(ends[1], exact[1])
    low = np.maximum(np.minimum(low, unlike[0]), 0.0)
    close(one.interval(LEVEL), (low, np.maximum(high, unlike[1])))


def test_few_hits_of_unlike_power_may_miss_one_of_another_patch():
    """Its mean square power, of the patch where that is most. Twin: a uniform beam."""
    uniform = tally()
    uneven = replace(uniform, incident=uniform.incident + np.uint64(1))
    for each, pooled in ((uneven, True), (uniform, False)):
        one = Estimates(each, independent=False)
        value, std_err = (
            one.patches(0).value[0, :4, 0],
            one.patches(0).std_err[0, :4, 0],
        )
        squares = std_err**2 / value
        missed = max(squares) if pooled else max(squares[3], 0.5 / (2 * RAYS))
        assert max(squares) > 1.1 * max(squares[3], 0.5 / (2 * RAYS))
        high = one.patches(0).interval(LEVEL)[1][0, 3, 0]
        alike = 0.5 * statistics.binomial_interval(sum(HITS[3]), 2 * RAYS, LEVEL)[1]
        other = statistics.gamma_interval(value[3], std_err[3], missed, LEVEL)[1]
        assert (other > alike) == pooled
        close(high, max(alike, other))


def test_few_deposits_have_the_limits_of_weighted_counts():
    """At least: where Student's t of the two batches is wider, it stays."""
    hits = (*HITS, (150, 151))
    estimates = Estimates(tally(hits), independent=False, deposited=True)
    assert max(map(sum, HITS)) < MIN_DEPOSITS < sum(hits[5])
    low, high = (limit[0, :, 0] for limit in estimates.patches(0).interval(LEVEL))
    wider = set()
    for patch in range(4):
        wide = np.ravel(student(estimates, patch))
        value = estimates.patches(0).value[0, patch, 0]
        std_err = estimates.patches(0).std_err[0, patch, 0]
        exact = statistics.gamma_interval(value, std_err, 1 / (2 * RAYS), LEVEL)
        close(low[patch], min(wide[0], exact[0]))
        close(high[patch], max(wide[1], exact[1]))
        wider.add(bool(high[patch] > wide[1]))
    assert wider == {True, False}
    many = statistics.student_interval(
        301 * 0.5 / (2 * RAYS), 0.25 / RAYS, 2, LEVEL, 0, 0
    )
    close((low[5], high[5]), many)


@pytest.mark.parametrize("missing", [0, 1])
def test_a_total_of_deposits_leaves_bright_rays_open(missing):
    """Whether or not there are as many of them as rays; twin: the same of rays."""
    each = tally([(RAYS // 2, RAYS // 2), (RAYS // 2, RAYS // 2 - missing)], 0.25)
    unseen = statistics.upper_limit(2 * RAYS, LEVEL)
    for deposited in (True, False):
        one = Estimates(each, independent=False, deposited=deposited)
        (value,), (_, (high,)) = one.total(0).value, one.total(0).interval(LEVEL)
        bright = high - value > unseen * 0.74
        assert bright == (deposited or not missing)


def test_points_that_send_most_of_a_patch_are_counted():
    """About 2 to 12 of 2048 points each; twin: as one more branch alone allows for."""
    rng, met = np.random.default_rng(0), np.arange(2, 13)
    held = []
    for _ in range(400):
        each = tally(np.full((11, 16), 0))
        counts = rng.poisson(met / 16, (16, 11)) / 128
        sums = counts[:, None, None, :, None] * each.incident[0, 0]
        hits = np.full(each.hits.shape, 2048, np.uint64)
        one = Estimates(replace(each, hits=hits, sums=sums), SplitEstimate)
        kinds = SplitEstimate, ControlledEstimate
        limits = [np.ravel(kind.interval(one.patches(0), 0.95)) for kind in kinds]
        found = np.reshape(limits, (2, 2, 11))
        held.append((found[:, 0] <= met / 2048) & (met / 2048 <= found[:, 1]))
    agree(often_enough([np.mean(each[0]) for each in held]))
    for patch in (0, 3):
        agree(often_enough([each[0, patch] for each in held]))
    disagree(often_enough([each[1, 3] for each in held]))


def test_rounding_of_lines_is_in_what_rays_correct():
    """Exact: the total is off by as much to either side, and so is its error."""
    off, found = 0.5, []
    for rounding in (0.0, off):
        one = Estimates(
            tally(), ControlledEstimate, independent=False, rounding=rounding
        )
        found.append((one.total(0).std_err, *one.total(0).interval(LEVEL)))
    (before, low, _), (std_err, below, above) = found
    close(std_err, np.hypot(before, off * one.total(0).value))
    close([below, above], one.total(0).value * np.array([[1 - off], [1 + off]]))
    assert low > below


def test_an_empty_patch_may_be_of_the_largest_weight():
    estimates = Estimates(tally(weight=4.0), independent=True)
    _, high = estimates.patches(0).interval(LEVEL)
    close(high[0, 4, 0], 4 * statistics.upper_limit(2 * RAYS, LEVEL))


def test_equal_batches_leave_what_no_hit_leaves_open():
    """The second patch got 40 hits of each batch, which is no proof of no error."""
    even = Estimates(tally(), independent=False)
    assert even.patches(0).std_err[0, 1, 0] == 0
    low, high = (limit[0, 1, 0] for limit in even.patches(0).interval(LEVEL))
    limit = statistics.upper_limit(2 * RAYS, LEVEL) * 0.5
    close((low, high), np.array([-limit, limit]) + 40 * 0.5 / RAYS)
    total = Estimates(tally([(40, 40)]), independent=False)
    np.testing.assert_array_equal(np.ravel(total.total(0).interval(LEVEL)), (low, high))


def test_nothing_received_has_an_upper_limit():
    dark = Estimates(tally([(0, 0), (0, 0)]), independent=False)
    limit = statistics.upper_limit(2 * RAYS, LEVEL)
    for low, high in (dark.patches(0).interval(LEVEL), dark.total(0).interval(LEVEL)):
        assert not low.any()
        close(high, limit)


@pytest.mark.parametrize("deposited", [False, True])
def test_a_channel_that_no_hit_carried_has_an_upper_limit(deposited):
    """Rounding: the limit of a patch without a hit; the other channel's bits stay."""
    one = tally()
    nothing = np.zeros_like(one.sums)
    both = {
        "sums": np.concatenate([one.sums, nothing], axis=-1),
        "incident": np.repeat(one.incident, 2, axis=-1),
    }
    alone, beside = (
        Estimates(each, independent=True, deposited=deposited)
        for each in (one, replace(one, **both))
    )
    for of in ("patches", "total"):
        expected = getattr(alone, of)(0).interval(LEVEL)
        low, high = getattr(beside, of)(0).interval(LEVEL)
        np.testing.assert_array_equal(
            (low[..., 0], high[..., 0]), np.array(expected)[..., 0]
        )
        assert not low[..., 1].any()
        close(high[..., 1], statistics.upper_limit(2 * RAYS, LEVEL))
    assert np.isnan(beside.patches(0).std_err[..., 1]).all()
    dark = np.zeros((1, len(HITS), 2), bool)
    dark[..., 1] = dark[:, -1] = True
    np.testing.assert_array_equal(beside.patches(0).dark, dark)


@pytest.mark.parametrize("weight", [1.0, 0.5, 2.0])
def test_all_rays_in_one_patch_may_hide_others(weight):
    """Some may be lost, or carry more than these, but no more than came."""
    one = Estimates(tally([(RAYS, RAYS)], weight=weight), independent=False)
    assert one.patches(0).std_err == one.total(0).std_err == 0
    unseen = statistics.upper_limit(2 * RAYS, LEVEL)
    limits = weight - unseen * weight, weight + unseen * max(1 - weight, 0)
    close(np.ravel(one.patches(0).interval(LEVEL)), limits)
    close(np.ravel(one.total(0).interval(LEVEL)), limits)


@pytest.mark.parametrize("weight", [0.3, 0.9, 1.0])
def test_no_number_of_rays_tells_more_than_single_precision(weight):
    """A weight that was rounded once is covered, however many rays carried it."""
    few, n = tally([(RAYS, RAYS)]), np.uint64(10**6)
    unit = np.uint64(float(np.float32(weight)) * RAYS * 10**6 * WEIGHT_SCALE)
    many = {name: getattr(few, name) * n for name in ("hits", "incident", "fates")}
    many = replace(few, sums=np.full_like(few.sums, unit), **many)
    one = Estimates(many, independent=False)
    for low, high in (one.patches(0).interval(LEVEL), one.total(0).interval(LEVEL)):
        assert low <= weight <= high
        # as wide as what a table shows in place of a standard error below it; all
        # rays with their whole weight can only be lost
        value = one.patches(0).value.item()
        above = value if weight == 1 else value * (1 + 2.0**-24)
        close(np.ravel((low, high)), (value * (1 - 2.0**-24), above))


@pytest.mark.parametrize("row", [Fate.MISSED, Fate.UNLIT])
def test_rays_that_missed_are_not_incident(row):
    beside = tally()
    beside.fates[:, row] = 500
    estimates = Estimates(beside, independent=True)
    assert estimates.rays == 2 * RAYS
    whole = Estimates(tally(), independent=True)
    np.testing.assert_array_equal(
        estimates.patches(0).interval(LEVEL), whole.patches(0).interval(LEVEL)
    )


@pytest.mark.parametrize(
    ("hits", "of"), [(HITS, Estimates.patches), ([(40, 40)], Estimates.total)]
)
def test_passes_of_the_same_rays_count_once(hits, of):
    """Twice the hits and rays of two passes tell no more than those of one."""
    once = tally(hits)
    twice = replace(once, hits=once.hits * 2, fates=once.fates * np.uint64(2))
    one, two = (
        Estimates(once, independent=True),
        Estimates(twice, independent=True, passes=2),
    )
    assert two.rays == one.rays
    np.testing.assert_array_equal(two.hits, one.hits)
    expected = of(one, 0).interval(LEVEL)
    np.testing.assert_array_equal(of(two, 0).interval(LEVEL), expected)
    twin = of(Estimates(twice, independent=True), 0).interval(LEVEL)
    assert not np.array_equal(twin, expected)


def test_a_patch_that_one_pass_alone_hits_was_hit():
    """Its light is no more than what a hit carries; twin: without the other pass."""
    one = replace(tally(), fates=tally().fates * np.uint64(2))
    hits = one.hits.copy()
    hits[0, 0, :2] = 1, 0
    sums = one.sums.copy()
    sums[:, 0, 0, 1] = 0
    odd = Estimates(replace(one, hits=hits, sums=sums), passes=2)
    assert odd.hits[0, 0, :2].tolist() == [1, 0]
    low, high = odd.patches(0).interval(LEVEL)
    assert np.isfinite(high).all()
    assert (low <= odd.patches(0).value).all()
    assert (odd.patches(0).value <= high).all()


def test_counted_rays_are_binomial():
    record = synthetic.record(analog=True)
    (estimates,) = record.estimates
    assert estimates.binomial
    (one,) = record.tallies
    rays = one.ledger.emitted
    low, high = estimates.patches(0).interval(LEVEL)
    exact = statistics.binomial_interval(one.hits[0][..., None], rays, LEVEL)
    np.testing.assert_array_equal((low, high), exact)
    n = one.hits.sum()
    np.testing.assert_array_equal(
        np.ravel(estimates.total(0).interval(LEVEL)),
        statistics.binomial_interval(n, rays, LEVEL),
    )
    for other in (
        replace(one, scale=WEIGHT_SCALE),
        replace(one, incident=one.incident - np.uint64(1)),
        replace(one, hits=one.hits + np.uint64(1)),
        one.spread(3),
    ):
        assert not Estimates(other, independent=True).binomial
    assert not Estimates(one, independent=False).binomial


def integrals(sums=(0, 0), error=1e-3):
    """Two patches of flux 0.25, integrated, with `error`; `sums` are sampled."""
    shape = (1, 1, 2, 1)
    sampled = tally([(hits, hits) for hits in sums])
    return Integrals.beside(sampled, np.full(shape, 0.25), np.full(shape, error))


def test_integrals_are_wrong_by_their_error():
    estimates = Estimates(integrals(), IntegralEstimate)
    # the fixed point is 2**-62 of the flux of all batches, about; errors round up
    step = 2.0**-50
    low, high = estimates.patches(0).interval(LEVEL)
    np.testing.assert_allclose(low, 0.25 - 1e-3, rtol=0, atol=step)
    np.testing.assert_allclose(high, 0.25 + 1e-3, rtol=0, atol=step)
    np.testing.assert_allclose(estimates.patches(0).std_err, 1e-3, rtol=0, atol=step)
    assert np.all(estimates.patches(0).std_err >= 1e-3)
    # those of a total add up as if none cancelled
    np.testing.assert_allclose(
        np.ravel(estimates.total(0).interval(LEVEL)), (0.498, 0.502), atol=step
    )
    np.testing.assert_allclose(estimates.total(0).std_err, 2e-3, rtol=0, atol=step)


def test_errors_of_integrals_come_back():
    """Whatever the batches' sizes, of which the largest is what they are stored for."""
    sampled = tally()
    sampled.incident[1] //= np.uint64(3)
    shape = sampled.hits.shape + (1,)
    errors = np.reshape([1e-3, 2e-4, 3e-5, 5e-4, 7e-6], shape)
    one = Integrals.beside(sampled, np.zeros(shape), errors)
    largest = int(one.incident.max())
    for n, error in zip(one.errors.ravel().tolist(), errors.ravel().tolist()):
        # rounding: of one product
        exact = Fraction(error) * largest
        assert abs(Fraction(n) - exact) <= Fraction(EPS) * exact
    # and where nothing was sampled, they come back
    again = Estimates(one, IntegralEstimate).patches(0).std_err[0, 4]
    np.testing.assert_allclose(again, 7e-6, rtol=2 * EPS)  # rounding: of two operations


def test_what_is_sampled_of_integrals_scatters():
    one = integrals(sums=(100, 0))
    one.sums[0, 0, 0, 0, 0] += one.incident[0, 0] // np.uint64(100)  # 0.01 in one batch
    estimates = Estimates(one, IntegralEstimate)
    close(estimates.patches(0).std_err[0, 0, 0], np.hypot(0.005, 1e-3))
    close(estimates.patches(0).std_err[0, 1, 0], 1e-3)
    low, high = (limit[0, 0, 0] for limit in estimates.patches(0).interval(LEVEL))
    half = statistics.student_interval(0.0, 0.005, 2, LEVEL)[1] + 1e-3
    middle = estimates.patches(0).value[0, 0, 0]
    np.testing.assert_allclose((low, high), (middle - half, middle + half), rtol=1e-12)
    close(estimates.total(0).std_err[0], np.hypot(0.005, 2e-3))


@pytest.mark.parametrize("flux", [0.3, 1e-9, 1e-30])
def test_dark_integrals_keep_their_digits(flux):
    """Rounding: of a product, of sums over batches, and of a quotient."""
    sampled = tally(np.zeros((2, 3), int))
    one = Integrals.beside(sampled, np.full((1, 1, 2, 1), flux), np.zeros((1, 1, 2, 1)))
    fraction = Estimates(one, IntegralEstimate).patches(0).value
    np.testing.assert_allclose(fraction, flux, rtol=8 * EPS)
