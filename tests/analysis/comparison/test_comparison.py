"""Records against records and against measured tables: verdicts, refusals, apertures.

Statistical verdicts share the suite's false-alarm budget; each has a twin that fails.
"""

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import budget
import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import Verdict, agree, disagree, of_comparison, single
from closed_forms import eval_flux
from scipy import special, stats

import gonio_mi as gonio
from gonio_mi.analysis.comparison import compare, measure_like
from gonio_mi.analysis.comparison.agreement import _two_hits_score
from gonio_mi.analysis.comparison.comparison import Comparison
from gonio_mi.analysis.comparison.figure import comparison_figure
from gonio_mi.analysis.points import CountedPoints
from gonio_mi.cli import main
from gonio_mi.collector import subdivision
from gonio_mi.collector.apertures import Apertures, disjoint_groups
from gonio_mi.collector.directions import direction
from gonio_mi.exchange.formats.reading import read_measured
from gonio_mi.files.measured_table import MeasuredTable
from gonio_mi.results.provenance import Provenance
from gonio_mi.results.record import Record
from gonio_mi.transport.collector_sphere import CollectorSphere

EPS = np.finfo(float).eps
HEADER = "theta_i,phi_i,theta_o,phi_o,value,sigma"


def truth(record):
    """Expected BRDF and direction of each patch of a synthetic record."""
    patches = record.subdivision
    mirror = record.theta_i[0], record.phi_i[0] + 180
    flux = 0.6 * synthetic.specular(patches, *mirror, 30)
    theta, phi = np.degrees(np.meshgrid(patches.theta, patches.phi, indexing="ij"))
    return (flux / patches.projected_solid_angles).ravel(), theta.ravel(), phi.ravel()


def table_of(record, values, phi_o=None, **settings):
    """Table with one point for each patch, whose mean it says that it is."""
    _, theta, phi = truth(record)
    n = len(values)
    settings["header"] = {"collector": str(record.subdivision)}
    return MeasuredTable(
        np.full(n, record.theta_i[0]),
        np.full(n, record.phi_i[0]),
        theta,
        phi if phi_o is None else phi_o,
        values,
        **settings,
    )


# Of a table that says to be of these patches.
OWN_PATCHES = {"collector": "angle:10x40"}


def noisy(values, uncertainty, seed, scale=0.0):
    rng = np.random.default_rng(seed)
    factor = 1 + scale * rng.standard_normal()
    return values * factor * (1 + uncertainty * rng.standard_normal(len(values)))


def gloss(seed=1, **settings):
    return synthetic.record(rays=50_000, n_batches=32, seed=seed, **settings)


# ------------------------------------------------------------- measured values, noise


@pytest.mark.promise("Measured data")
def test_right_model_agrees_and_two_percent_do_not():
    record = gloss()
    values, _, _ = truth(record)
    table = table_of(record, noisy(values, 0.005, 3), uncertainty=0.005)
    agree(of_comparison(compare(record, table)))
    for factor in (0.98, 1.02):
        wrong = table_of(record, noisy(factor * values, 0.005, 3), uncertainty=0.005)
        comparison = compare(record, wrong)
        disagree(of_comparison(comparison))
        assert not comparison.passed


def test_one_percent_shows_in_the_total():
    """A small error everywhere: no point shows it, all together do."""
    record = synthetic.record("projected:30x30", rays=30_000, n_batches=32)
    values, _, _ = truth(record)
    comparison = compare(record, table_of(record, 1.01 * values))
    disagree(of_comparison(comparison))
    assert comparison.p_values["total"] < budget.ALPHA / 3
    # neither alone would have seen it
    assert min(comparison.p_values[test] for test in ("chi2", "worst")) > 1e-3
    agree(of_comparison(compare(record, table_of(record, values))))


def test_the_worst_points_are_those_that_differ_most():
    """Scores keep their order where no probability is that small, as JSON has them."""
    record = gloss(analog=True)
    values, _, _ = truth(record)
    wrong = values * np.linspace(20, 200, len(values))
    found = compare(record, table_of(record, wrong, uncertainty=0.001))
    apart = np.abs(found.value - found.other)
    apart /= np.hypot(np.nan_to_num(found.std_err), found.other_std_err)
    hit = np.isfinite(found.std_err)
    assert np.abs(found.z).max() > 100
    order = np.argsort(-apart[hit])
    sizes = np.abs(found.z[hit][order])
    assert np.all(np.diff(sizes[sizes > 40]) < 0)
    worst = [abs(point["z"]) for point in found.to_dict()["worst"]]
    assert worst == sorted(np.abs(found.z), reverse=True)[:5]
    drawn = comparison_figure(found).axes
    _, high = drawn[1].get_ylim()
    assert high > 37.1


@pytest.mark.parametrize(("first", "noted"), [(-70, True), (0, False)])
def test_a_scan_from_the_other_side_is_noted(first, noted):
    """If most of its directions are turned into each other; twin: a scan of one side.

    The direction of incidence, which the source hides, is missing.
    """
    theta = np.array([one for one in range(first, 71, 5) if one != -30])
    phi_o = np.where(theta < 0, 0.0, 180.0)
    n = np.ones(len(theta))
    scan = MeasuredTable(
        30 * n, 0 * n, abs(theta), phi_o, n, uncertainty=0.01, aperture_half_angle=2
    )
    metal = {"type": "roughconductor", "alpha": 0.3}
    ours = compare(measure_like(metal, scan, rays=10**5), scan)
    columns = ours.theta_i, ours.phi_i, ours.theta_o, ours.phi_o + 180, ours.value
    turned = MeasuredTable(*columns, uncertainty=0.01, aperture_half_angle=2)
    found = compare(measure_like(metal, turned, rays=10**5, seed=1), turned)
    assert found.verdict == "differ"
    assert noted == any("180 degrees on would agree" in n for n in found.notes)


@pytest.mark.parametrize(
    ("azimuths", "factor", "noted"),
    [
        (lambda phi, _: -phi, 1, "azimuths of exit clockwise would agree"),
        (lambda phi, own: 2 * own - phi, 1, "at the plane of incidence would agree"),
        (lambda phi, _: phi + 180, 1, "180 degrees on would agree"),
        (lambda phi, _: phi, 1.5, None),
    ],
)
def test_azimuths_counted_in_another_way_differ_and_are_told(azimuths, factor, noted):
    """Twin: what is wrong in any way; whole turns are the same directions."""
    record = gloss()
    values, _, phi = truth(record)
    other = azimuths(phi, record.phi_i[0])
    how = {"uncertainty": 0.005}
    found = compare(record, table_of(record, factor * values, phi_o=other, **how))
    disagree(of_comparison(found))
    said = [note for note in found.notes if "would agree" in note]
    assert len(said) == (noted is not None)
    assert not said or noted in said[0]
    whole_turns = table_of(record, values, phi_o=phi + 720, **how)
    agree(of_comparison(compare(record, whole_turns)))


@pytest.mark.parametrize("turn", [-1e-12, 360, 720 - 1e-10, -1])
def test_azimuths_of_points_are_of_one_turn(turn):
    record = gloss()
    values, _, phi = truth(record)
    turned = table_of(record, values, phi_o=phi - phi[0] + turn, uncertainty=0.5)
    found = compare(record, turned)
    assert np.all((found.phi_o >= 0) & (found.phi_o < 360))
    exact = turn + 360 if turn == -1 else 0.0
    assert found.phi_o[0] == exact


def test_scale_uncertainty_is_common_to_all_points():
    record = gloss()
    values, _, _ = truth(record)
    table = table_of(record, 1.05 * values, scale_uncertainty=0.03)
    comparison = compare(record, table)
    agree(of_comparison(comparison))
    # 1 / 1.05 is the factor, known as well as the record's total is
    off = comparison.statistics["scale"] * 1.05 - 1
    relative = 1 / record.counts.sum() ** 0.5
    agree(single(off / relative))
    disagree(single((off + 0.01) / relative))
    disagree(
        of_comparison(compare(record, table, scale_uncertainty=0, uncertainty=0.005))
    )
    # a scale does not excuse another shape
    _, theta, _ = truth(record)
    tilted = table_of(record, values * (1 + 0.2 * theta / 90), scale_uncertainty=0.03)
    disagree(of_comparison(compare(record, tilted)))


def false_alarms(n, level, stated):
    """How many of `n` right models fail at `level`; the noise is 1 %."""
    failed = 0
    for seed in range(n):
        record = synthetic.record(
            "angle:4x6", rays=20_000, n_batches=8, seed=seed, power=4
        )
        flux = 0.6 * synthetic.specular(record.subdivision, 30, 200, 4)
        values = (flux / record.subdivision.projected_solid_angles).ravel()
        table = table_of(record, noisy(values, 0.01, 10_000 + seed), uncertainty=stated)
        failed += not compare(record, table, alpha=level).passed
    return failed


def test_uncertainties_of_few_repetitions_are_known_so_well():
    """Each of a table's is found from four values; the twin takes them for exact."""
    record = synthetic.record("projected:20x30", rays=300_000, n_batches=32)
    values, _, _ = truth(record)
    rng, dof = np.random.default_rng(11), 3
    noise = 0.1 * values * rng.standard_normal(len(values))
    sigma = 0.1 * values * np.sqrt(rng.chisquare(dof, len(values)) / dof)
    table = table_of(record, values + noise, sigma=sigma, degrees_of_freedom=dof)
    agree(of_comparison(compare(record, table)))
    disagree(of_comparison(compare(record, replace(table, degrees_of_freedom=None))))


def test_false_alarms_are_as_rare_as_stated():
    """Student's t of 8 batches, Welch, and the three tests together."""
    n, level = 300, 0.1
    failed = false_alarms(n, level, 0.01)
    agree(Verdict({"too many": float(stats.binom.sf(failed - 1, n, level))}, n))
    # twin: an uncertainty that is stated too small
    failed = false_alarms(n // 5, level, 0.004)
    disagree(Verdict({"too many": float(stats.binom.sf(failed - 1, n // 5, level))}, n))


def test_points_in_one_patch_count_once():
    """Twice the same points double the sum of squares, and not the evidence."""
    record = gloss()
    values, theta, phi = truth(record)
    once = table_of(record, values)
    columns = (once.theta_i, once.phi_i, theta, phi, values)
    n = len(values)
    found = {
        k: compare(
            record, MeasuredTable(*(np.tile(c, k) for c in columns), header=once.header)
        ).statistics
        for k in (1, 2, 4)
    }
    assert found[2]["chi2"] == pytest.approx(2 * found[1]["chi2"], rel=n * EPS)
    # as if independent they were 2 n; one each they are n but for the batches' noise
    assert found[2]["chi2_dof"] < 1.5 * n
    # exactly proportional, but for the share of single precision in each variance
    share = np.max((2.0**-20 * record.brdf / record.brdf_std_err) ** 2)
    assert found[4]["chi2_dof"] == pytest.approx(found[2]["chi2_dof"], rel=4 * share)


# ------------------------------------------------------------------ records, few hits


def test_two_records_of_one_specimen_agree():
    a, b = gloss(seed=1, both=True), gloss(seed=2, both=True)
    comparison = compare(a, b)
    agree(of_comparison(comparison))
    assert len(comparison.z) == 2 * a.subdivision.n_patches
    assert (comparison.theta_o > 90).sum() == a.subdivision.n_patches
    other = gloss(seed=2, both=True, power=33)
    disagree(of_comparison(compare(a, other)))


def test_rms_is_that_of_the_paper():
    """Table 1's closed form, for a counted Lambertian of m equal patches."""
    m, rays = 900, 2**20
    patches = subdivision("projected:30x30")
    rng = np.random.default_rng(5)
    weights = np.full((1, 30, 30), 1 / m)
    made = synthetic.tally(patches, weights, rays // 32, rng, 1, 32, analog=True)
    record = Record(
        patches, np.array([45.0]), np.array([0.0]), ("Y",), (made,),
        provenance=Provenance(sampler="independent", seeds=(1,)),
    )  # fmt: skip
    comparison = compare(record, table_of(record, np.full(m, 1 / np.pi)))
    flat = record.brdf[..., 0].ravel()
    by_hand = np.sqrt(np.sum((flat - 1 / np.pi) ** 2) / m)
    assert comparison.rms == pytest.approx(by_hand, rel=m * EPS)
    assert comparison.relative_rms == pytest.approx(np.pi * by_hand, rel=m * EPS)
    closed_form = m / np.pi * np.sqrt((1 / m) * (1 - 1 / m) / rays)
    # m - 1 free counts
    square = m * (by_hand / closed_form) ** 2 * (m - 1) / m
    p = 2 * min(stats.chi2.cdf(square, m - 1), stats.chi2.sf(square, m - 1))
    agree(Verdict({"rms": float(p)}))
    square *= 1.2**2  # twin: a tenth off in the exponent of N
    disagree(Verdict({"rms": float(2 * stats.chi2.sf(square, m - 1))}))


def with_hits(record, n, weight=1.0):
    """Record with so many hits in the first patch, one per batch, each of a weight."""
    made = synthetic.writeable(record.tallies[0])
    made.hits[0, 0, 0] = n
    made.sums[:, 0, 0, 0] = 0
    made.sums[:n, 0, 0, 0] = made.scale * weight
    return replace(record, tallies=(made,))


def first_score(record, expected, relative=0.0):
    """Score of the first patch, where so many hits were expected; and the comparison.

    Those are uncertain by a part of themselves; all other patches are as expected.
    """
    values = record.brdf[..., 0].ravel().copy()
    solid = record.subdivision.projected_solid_angles[0, 0]
    values[0] = expected / record.ledger.emitted / solid
    sigma = np.zeros(len(values))
    sigma[0] = relative * values[0]
    comparison = compare(record, table_of(record, values, sigma=sigma))
    return comparison.z[0], comparison


def test_empty_patches_take_part():
    """No hit where 20 were expected has the exact score of Poisson's law.

    If their mean is 20 give or take 10 it follows a gamma distribution, and they a
    negative binomial one: of 4 successes of a chance of 1 in 6.
    """
    record = with_hits(gloss(), 0)
    z, comparison = first_score(record, 20)
    # FEW_ROUNDINGS of the mean, and the inverse of a tail, to a few digits of eps
    assert z == pytest.approx(special.ndtri(np.exp(-20)), rel=2.0**-18)
    assert np.isnan(comparison.std_err[0])
    assert comparison.to_dict()["worst"][0]["std_err"] is None
    for nothing in (0, -1e-3):
        assert first_score(record, nothing)[0] == 0
    # FEW_ROUNDINGS of the mean and of its variance
    expected = special.ndtri(stats.nbinom.cdf(0, 4, 1 / 6))
    assert first_score(record, 20, 0.5)[0] == pytest.approx(expected, rel=2.0**-18)


@pytest.mark.parametrize("expected", [3, 30])
def test_a_hit_that_weighs_nothing_tells_as_much_as_none(expected):
    """Its own error, and what it weighs, would refute any value that is right.

    Twin: where thirty hits of the usual weight were expected, one does.
    """
    z, _ = first_score(with_hits(gloss(), 1, 1e-4), expected)
    # as without a hit, but for what it weighs
    assert z == pytest.approx(special.ndtri(np.exp(-expected)), rel=1e-3)
    assert (z < -6) == (expected == 30)


@pytest.mark.parametrize(("more", "chance"), [(1, 1 / 2), (3, 3 / 4)])
def test_empty_patch_of_one_of_two_records(more, chance):
    """Given 12 hits, those of one record are binomial: of as many rays a fair coin.

    One with a quarter of all rays gets none by (3 / 4)^12.
    """
    a = with_hits(gloss(seed=1), 0)
    b = synthetic.record(rays=more * 50_000, n_batches=32, seed=2)
    b = with_hits(b, 12)
    z = special.ndtri(chance**12)
    # rounding: of the flux that a hit is worth, twice, and of the inverse of a tail
    assert compare(a, b).z[0] == pytest.approx(z, rel=100 * EPS)
    assert compare(b, a).z[0] == pytest.approx(-z, rel=100 * EPS)


def test_a_hit_that_weighs_nothing_in_one_of_two_records():
    """Given twelve in the other one; alone it would be worth all of them."""
    a, b = with_hits(gloss(seed=1), 1, 1e-4), with_hits(gloss(seed=2), 12)
    # one more hit of the other's weight makes means of 1 / 2 and 12 / 13, but for what
    # it weighs: shares of 24 to 13
    z = special.ndtri(special.betainc(12, 2, 13 / 37))
    one, two = (
        CountedPoints.of(record, 0, 0, 0, np.zeros(1, int)) for record in (a, b)
    )
    assert _two_hits_score(one, two) == pytest.approx(z, rel=1e-3)
    assert _two_hits_score(two, one) == pytest.approx(-z, rel=1e-3)
    # Student's t, of twelve batches with one hit each and four without, says less
    assert z < compare(a, b).z[0] < 0


def test_passes_of_the_same_rays_count_once():
    """Hits, and what one is worth, are those of one pass of the rays."""
    once = with_hits(gloss(analog=True), 0)
    (made,) = once.tallies
    doubled = replace(made, hits=made.hits * 2, fates=made.fates * np.uint64(2))
    twice = replace(once, tallies=(doubled,)).with_provenance(passes=2)
    patch = np.arange(once.subdivision.n_patches)
    one, two = (CountedPoints.of(r, 0, 0, 0, patch) for r in (once, twice))
    for name in ("value", "hits", "exposure", "weight"):
        np.testing.assert_array_equal(getattr(two, name), getattr(one, name))
    assert one.weight[0] > 0, "of an empty patch"


def test_batches_that_agree_are_trusted_to_a_rounded_hit():
    """Of each batch 1 / 12 of a hit in square, where all have the same sum."""
    record = gloss()
    made = synthetic.writeable(record.tallies[0])
    made.hits[0, 0, 0] = 320
    made.sums[:, 0, 0, 0] = 10 * made.scale
    record = replace(record, tallies=(made,))
    even = CountedPoints.of(record, 0, 0, 0, np.zeros(1, int))
    assert even.chance == 0
    solid = record.subdivision.projected_solid_angles[0, 0]
    expected = np.sqrt(32 / 12) / (made.ledger.emitted * solid)
    # rounding: some ten operations
    assert even.error[0] == pytest.approx(expected, rel=16 * EPS)


@pytest.mark.parametrize("n_batches", [2, 8])
def test_the_total_is_students(n_batches):
    """With one degree of freedom less than batches, for their own scatter alone."""
    record = synthetic.record(rays=50_000, n_batches=n_batches)
    values, _, _ = truth(record)
    comparison = compare(record, table_of(record, 1.01 * values))
    # 0.606 of the flux, known up to FEW_ROUNDINGS
    rounding = 2.0**-20 * 0.606
    variance = record.dhr_std_err[0] ** 2 + rounding**2
    dof = variance**2 / (record.dhr_std_err[0] ** 4 / (n_batches - 1))
    t = (record.dhr[0] - 0.606) / np.sqrt(variance)
    expected = abs(budget.normal_scores(t, dof))
    # rounding: 48 patches are summed to 0.6 and taken from it, and t is of that size
    rtol = 48 * EPS * 0.606 / abs(record.dhr[0] - 0.606)
    assert comparison.statistics["total"] == pytest.approx(expected, rel=10 * rtol)


def test_a_total_of_few_hits_is_not_tested():
    """Some 600 hits, where Student's t needs 1000; three times as many are enough."""
    for rays, tested in ((250, False), (750, True)):
        record = synthetic.record(rays=rays)
        values, _, _ = truth(record)
        comparison = compare(record, table_of(record, 2 * values))
        assert np.isfinite(comparison.statistics["total"]) == tested
        words = "total       |z| = " if tested else "total       not tested: "
        assert words in str(comparison)
        known = comparison.to_dict()["statistics"]["total"] is not None
        assert known == tested
    assert comparison.p_values["total"] < 1
    same = compare(record, replace(record))
    assert "total       |z| = 0 of the sum" in str(same)


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("rays", [10_000, 10**8])
def test_a_test_without_power_says_so(sampler, rays):
    """Evenly distributed rays with few hits only; the verdict as printed holds it."""
    pair = [synthetic.record(rays=rays, seed=seed) for seed in (1, 2)]
    one, other = (record.with_provenance(sampler=sampler) for record in pair)
    noted = "next to no power" in str(compare(one, other))
    assert noted == (sampler == "sobol" and rays < 10**8)


def test_what_is_printed_belongs_together():
    """Rounding: three digits of p, and four of the degrees of freedom.

    Half a hundredth of a degree, of a law 10 wide, is far below the three digits of p.
    """
    records = [synthetic.record(rays=10**6, seed=seed) for seed in (1, 2)]
    comparison = compare(*records)
    line = re.search(r"chi-square  (\S+) for (\S+) .* p = (\S+)", str(comparison))
    chi2, dof, p = map(float, line.groups())
    assert stats.chi2.sf(chi2, dof) == pytest.approx(p, abs=0.001)
    assert "before correlation" not in line.group()
    fewer = comparison.statistics | {"chi2_dof": dof / 2}
    assert "before correlation" in str(replace(comparison, statistics=fewer))


def test_a_difference_is_on_no_safe_side():
    """A test without power that has found something needs no more of it."""
    one = synthetic.record(rays=10_000, seed=1)
    one = one.with_provenance(sampler="sobol")
    other = synthetic.record(rays=10_000, seed=2, power=8)
    comparison = compare(one, other)
    assert comparison.verdict == "differ"
    assert "safe side" not in str(comparison)
    assert "next to no power" not in str(comparison)


def test_a_record_agrees_with_itself_and_says_so():
    record = gloss()
    comparison = compare(record, record)
    assert comparison.rms == 0
    assert (comparison.z == 0).all()
    assert comparison.p_value == 1
    assert any("seed 1" in note for note in comparison.notes)
    assert "agree" in str(comparison)
    assert repr(comparison).startswith("<Comparison of 48 points: agree, p")


# --------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"collector": "projected:6x9"}, "same collector .*6x8 and projected:6x9"),
        ({"channels": ("R", "G", "B")}, "same channels"),
        ({"both": True}, "same hemispheres"),
        ({"theta_i": (31.0,)}, r"same incident directions, .*30, 20\) and \(31, 20\)"),
        ({"theta_i": (30.0, 40.0), "phi_i": (20.0, 0.0)}, "same number of incident"),
    ],
)
def test_records_that_cannot_be_compared(change, message):
    with pytest.raises(ValueError, match=message):
        compare(gloss(), gloss(**change))


def test_what_a_table_must_share_with_a_record():
    record = gloss()
    values, theta, phi = truth(record)
    n = len(values)
    other_angle = MeasuredTable(np.full(n, 45.0), np.full(n, 20.0), theta, phi, values)
    with pytest.raises(ValueError, match=r"lacks 45, 20 degrees \(it has 30, 20\)"):
        compare(record, other_angle)
    grey = compare(record, table_of(record, values, channel="550nm"))
    assert any("stands for 550nm" in note for note in grey.notes)
    tinted = gloss(channels=("R", "G", "B"))
    with pytest.raises(ValueError, match=r"\(R, G, B\), but the table names no"):
        compare(tinted, table_of(record, values))
    green = compare(tinted, table_of(record, values, channel="G", uncertainty=0.01))
    assert set(green.channel.tolist()) == {"G"}
    below = MeasuredTable(np.full(n, 30.0), np.full(n, 20.0), 180 - theta, phi, values,
                          quantity="btdf")  # fmt: skip
    with pytest.raises(ValueError, match="has no lower hemisphere"):
        compare(record, below)
    alone = gloss()
    alone = Record(alone.subdivision, alone.theta_i, alone.phi_i, alone.channels,
                   (synthetic.record(n_batches=1).tallies[0],))  # fmt: skip
    with pytest.raises(ValueError, match="at least 2 batches"):
        compare(alone, table_of(record, values))


@pytest.mark.parametrize(
    ("first", "other", "given", "message"),
    [
        *(
            (gloss(), gloss(seed=2), {"alpha": alpha}, "alpha must be a probability")
            for alpha in (0, 1, -1, float("nan"), "often")
        ),
        ([], gloss(), {}, "record must be a Record"),
        (gloss(), "measured.csv", {}, "other must be a Record, a MeasuredTable"),
        ([gloss()] * 2, gloss(), {}, "record must be one Record, unless"),
        (gloss(), gloss(seed=2), {"uncertainty": -0.1}, "uncertainty must be a finite"),
    ],
)
def test_what_no_comparison_can_be_made_of(first, other, given, message):
    with pytest.raises((TypeError, ValueError), match=message):
        compare(first, other, **given)


def test_a_specimen_is_measured_as_the_other_was():
    """Exact against 1 / (2 pi), by integrals; twin: another reflectance differs."""
    half, more = ({"type": "diffuse", "reflectance": one} for one in (0.5, 0.6))
    table = MeasuredTable([30], [0], [45], [180], [0.5 / np.pi], aperture_half_angle=2)
    assert compare(half, table, uncertainty=1e-4).passed
    assert not compare(more, table, uncertainty=1e-4).passed
    record = gonio.measure(half, 30, rays=2**14, collector="projected:4x4")
    assert compare(record, half).passed
    assert compare(half, record).passed
    assert not compare(record, more).passed
    with pytest.raises(TypeError, match="rays applies to a specimen, got none"):
        compare(record, record, rays=3)


# ------------------------------------------------------------------------- the reader


def written(tmp_path, *lines, **options):
    path = tmp_path / "measured.csv"
    path.write_text("\n".join(lines) + "\n", **options)
    return path


def test_reader_takes_the_documented_form(tmp_path):
    path = written(
        tmp_path,
        "# instrument: a goniophotometer",
        "# a comment without a key",
        "# units: 1/sr",
        "# quantity: brdf_cos",
        "# uncertainty: 0.005",
        "# aperture_solid_angle: 0.002",
        "# emitter_half_angle: 0.25",
        "# channel: 550nm",
        "",
        "sigma, value, theta_i, phi_i, theta_o, phi_o",
        "0.003, 0.2, 45, 0, 60, 180",
        '0, "-1e-3", 45, -30, 0, 0',
        encoding="utf-8-sig",
        newline="\r\n",
    )
    table = read_measured(path)
    assert table.value.tolist() == [0.2, -1e-3]
    assert table.incident == [(45.0, 0.0), (45.0, -30.0)]
    assert table.header == {"instrument": "a goniophotometer"}
    assert (table.channel, table.emitter_half_angle) == ("550nm", 0.25)
    # cos(60 degrees) = 1/2; sigma and 0.5 % in quadrature
    assert table.bsdf == pytest.approx([0.4, -1e-3], rel=4 * EPS)
    expected = [2 * np.hypot(0.003, 0.001), 5e-6]
    assert table.bsdf_std_err == pytest.approx(expected, rel=8 * EPS)
    half = np.radians(table.aperture_half_angle)
    assert 2 * np.pi * (1 - np.cos(half)) == pytest.approx(0.002, rel=2**10 * EPS)


def test_table_is_saved_and_read_without_loss(tmp_path):
    rng = np.random.default_rng(2)
    columns = [rng.uniform(0, 89, 7) for _ in range(6)]
    table = MeasuredTable(*columns, uncertainty=0.1, aperture_half_angle=0.7,
                          degrees_of_freedom=15, emitter_distance=3.0,
                          header={"who": "me"})  # fmt: skip
    path = tmp_path / "a.csv"
    table.save(path)
    again = read_measured(path)
    for name in ("theta_i", "phi_i", "theta_o", "phi_o", "value", "sigma"):
        assert np.array_equal(getattr(table, name), getattr(again, name))
    settings = "uncertainty", "aperture_half_angle", "degrees_of_freedom"
    for name in (*settings, "emitter_distance", "header"):
        assert getattr(table, name) == getattr(again, name)


ROW = "45,0,30,180,0.3,0.001"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["theta_i,phi_i,theta_o,value", "45,0,30,0.3"],
         "line 1 leaves open: .1. one column must be phi_o:"),
        ([HEADER, ROW, "45,0,30,180,bright,0"],
         "line 3, column value: must be a number, got 'bright'"),
        ([HEADER, "45,0,91,180,0.3,0"],
         r"line 2, column theta_o: must be .* \[0, 90\) for brdf, got 91"),
        (["# quantity: btdf", HEADER, ROW], r"line 3, column theta_o: must be .*\(90"),
        ([HEADER, "95,0,30,180,0.3,0"], "column theta_i: .* got 95"),
        ([HEADER, "45,0,30,180,0.3,-1"], "column sigma: .* 0 or more, got -1"),
        ([HEADER, "45,0,30,180,inf,0"], "column value: .* finite number, got inf"),
        ([HEADER, "45,inf,30,180,0.3,0"], "column phi_i: .* finite number, got inf"),
        ([HEADER, "45,0,30,180,0.3"], "line 2: must have 6 values .* got 5"),
        ([HEADER, "45;0;30;180;0,3;0"], "line 2: must have 6 values"),
        ([HEADER, "45,0,30,180,x,0"], "column value: must be a number, got 'x'"),
        ([HEADER], "has no values: nothing follows line 1"),
        ([""], "is empty"),
        (["# units: 1/sr"], "is empty"),
        (["once upon a time"], "must name the columns theta_i, phi_i"),
        ([HEADER + ",value", ROW + ",1"], "one column must be value"),
        (["# units: percent", HEADER, ROW], "line 1: units must be one of 1/sr"),
        (["# quantity: albedo", HEADER, ROW], "line 1: quantity must be one of"),
        (["# uncertainty: 0.5 %", HEADER, ROW], "line 1: uncertainty must be a finite"),
        (["# uncertainty: nan", HEADER, ROW], "uncertainty must be .*'nan'"),
        (["# uncertanty: 0.1", HEADER, ROW],
         "line 1: unknown key 'uncertanty'; did you mean uncertainty"),
        (["# uncertainty: 1", "# uncertainty: 2", HEADER, ROW], "line 2: .* once"),
        (["# aperture_half_angle: 0", HEADER, ROW], "must be positive"),
        (["# aperture_half_angle: 1", "# aperture_solid_angle: 1", HEADER, ROW],
         "either aperture_half_angle or"),
    ],
)  # fmt: skip
def test_reader_says_where_and_what(tmp_path, lines, message):
    path = written(tmp_path, *lines)
    with pytest.raises(gonio.FileFormatError, match=message) as caught:
        read_measured(path)
    assert "measured.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_reader_of_other_files(tmp_path):
    path = tmp_path / "a.csv"
    for content in (b"\x89PNG\r\n\x1a\n\xff\xfe", b"PK\x03\x04\0\0"):
        path.write_bytes(content)
        with pytest.raises(gonio.FileFormatError, match="is not a table of values"):
            read_measured(path)
    with pytest.raises(FileNotFoundError):
        read_measured(tmp_path / "none.csv")


def test_table_checks_its_columns():
    one = np.ones(3)
    with pytest.raises(ValueError, match="value must be a finite number, got nan"):
        MeasuredTable(one, one, one, one, [1, 2, np.nan])
    with pytest.raises(ValueError, match="sigma must hold one number for each of 3"):
        MeasuredTable(one, one, one, one, one, [1, 2])
    with pytest.raises(ValueError, match="at least one rows"):
        MeasuredTable([], [], [], [], [])


# -------------------------------------------------------------------------- apertures


def cones():
    return [(t, p) for t in range(0, 85, 8) for p in range(0, 360, 24) if t or not p]


def test_apertures_cover_the_hemisphere_once():
    """In NumPy, and in single precision in Dr.Jit."""
    apertures = Apertures(1.5, disjoint_groups(cones(), 1.5)[0])
    n = apertures.n_patches
    assert apertures.solid_angles.sum() == pytest.approx(2 * np.pi, rel=n * EPS)
    assert apertures.projected_solid_angles.sum() == pytest.approx(np.pi, rel=n * EPS)
    assert subdivision(str(apertures)) == apertures
    assert apertures.shape == (n, 1)
    # against the definition: the cone's axis and the cosine of the half-angle
    rng = np.random.default_rng(1)
    theta, phi = np.radians(apertures.directions).T
    axes = direction(theta, phi)
    v = np.concatenate([rng.standard_normal((20_000, 3)), -axes * [-1, -1, 1]])
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    cosine = np.column_stack([v[:, :2], np.abs(v[:, 2])]) @ axes.T
    inside = cosine > np.cos(np.radians(1.5))
    expected = np.where(inside.any(axis=1), inside.argmax(axis=1), n - 1)
    # what lies within rounding of a rim may go either way
    rim = np.abs(cosine - np.cos(np.radians(1.5))).min(axis=1) < 2.0**-20
    assert np.array_equal(apertures.patch(v)[~rim], expected[~rim])
    assert np.unique(expected).size == n
    rounded = mi.Vector3f(np.ascontiguousarray(v.T, dtype=np.float32))
    found = np.array(CollectorSphere(apertures).patch_index(rounded))
    assert np.array_equal(found[~rim], expected[~rim])


def test_rim_belongs_to_what_is_between():
    apertures = Apertures(2.0, [(30, 50)])
    for turn, patch in ((0, 0), (1 - 1e-5, 0), (1 + 1e-5, 1)):
        v = direction(np.radians(30 + 2 * turn), np.radians(50))
        assert apertures.patch(v) == patch


@pytest.mark.parametrize("half_angle", [0.02, 0.5, 5])
def test_projected_solid_angle_of_a_cone(half_angle):
    """Against the integral over the cone, in its own polar coordinates."""
    apertures = Apertures(half_angle, [(40, 10), (80, 200)])
    a = np.radians(half_angle)
    # average of cos(theta) over azimuth about the axis is cos(axis) cos(alpha)
    alpha, weight = np.polynomial.legendre.leggauss(20)
    alpha, weight = a * (alpha + 1) / 2, a * weight / 2
    ring = 2 * np.pi * np.sum(weight * np.sin(alpha) * np.cos(alpha))
    expected = ring * np.cos(np.radians([40, 80]))
    found = apertures.projected_solid_angles[:2, 0]
    assert found == pytest.approx(expected, rel=100 * EPS)


def test_overlapping_apertures_are_grouped():
    scan = [(float(t), 0.0) for t in range(30)]
    groups = disjoint_groups(scan, 1.0)
    assert [len(group) for group in groups] == [15, 15]
    assert sorted([*groups[0], *groups[1]]) == scan
    for group in groups:
        Apertures(1.0, group)
    with pytest.raises(ValueError, match="must not overlap"):
        Apertures(1.0, scan)
    assert len(disjoint_groups(scan, 0.5)) == 1


@pytest.mark.parametrize(
    ("half_angle", "directions", "message"),
    [
        (1, [(89.5, 0)], "must lie above the horizon"),
        (1, [(-1, 0)], "must lie above the horizon"),
        (1, [(float("nan"), 0)], "must lie above the horizon"),
        (0, [(0, 0)], "half_angle must be"),
        (1, [], "at least one direction"),
    ],
)
def test_apertures_refuse(half_angle, directions, message):
    with pytest.raises(ValueError, match=message):
        Apertures(half_angle, directions)
    with pytest.raises(ValueError, match="no rings and sectors"):
        Apertures(1, [(0, 0)]).in_rings(np.zeros((2, 1, 1)))


# -------------------------------------------------------- under the table's conditions


def lambertian_table(reflectance, seed=4, **settings):
    theta_o = np.abs(np.arange(-75.0, 76, 15))
    phi_o = np.where(np.arange(-75, 76, 15) > 0, 180.0, 0.0)
    theta_i = np.repeat([20.0, 60.0], len(theta_o))
    n = len(theta_i)
    values = noisy(np.full(n, reflectance / np.pi), 0.005, seed)
    return MeasuredTable(theta_i, np.zeros(n), np.tile(theta_o, 2), np.tile(phi_o, 2),
                         values, uncertainty=0.005, **settings)  # fmt: skip


DIFFUSE = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.7}}


@pytest.mark.parametrize("emitter_half_angle", [0.0, 2.0])
def test_record_at_the_solid_angles_of_a_table(emitter_half_angle):
    geometry = {"aperture_half_angle": 5, "emitter_half_angle": emitter_half_angle}
    table = lambertian_table(0.7, **geometry)
    records = measure_like(DIFFUSE, table, rays=500_000)
    assert len(records) == 2
    for record in records:
        ledger = record.ledger
        assert ledger.emitted == 500_000
        assert record.counts.sum() == ledger.reflected
    agree(of_comparison(compare(records, table)))
    disagree(of_comparison(compare(records, lambertian_table(0.7 * 1.02, **geometry))))
    with pytest.raises(ValueError, match="half-angle of the table, 4 degrees, got 5"):
        compare(records, lambertian_table(0.7, aperture_half_angle=4))
    with pytest.raises(ValueError, match="lacks 60, 0 degrees"):
        compare(records[:1], table)


def test_apertures_see_a_lobe_that_patches_smear():
    """Reference: `eval` integrated over each aperture, in its own coordinates."""
    bsdf = {"type": "roughconductor", "alpha": 0.1}
    half_angle, theta_o = 1.0, np.arange(24.0, 67, 3)
    a = np.radians(half_angle)
    alpha, w = np.polynomial.legendre.leggauss(8)
    alpha, w = a * (alpha + 1) / 2, a * w / 2
    psi = 2 * np.pi * (np.arange(16) + 0.5) / 16
    local = direction(*np.meshgrid(alpha, psi, indexing="ij"))
    values = []
    for theta in np.radians(theta_o):
        x, y, z = np.moveaxis(local, -1, 0)
        turned = (x * np.cos(theta) + z * np.sin(theta), y)
        wo = np.stack([*turned, z * np.cos(theta) - x * np.sin(theta)], axis=-1)
        flux = eval_flux(mi.load_dict(bsdf), 45, 180, wo.reshape(-1, 3))[:, 0]
        ring = flux.reshape(8, 16).mean(axis=1) * 2 * np.pi * np.sin(alpha)
        values.append(np.sum(w * ring) / (np.pi * np.sin(a) ** 2 * np.cos(theta)))
    n = len(theta_o)
    table = MeasuredTable(np.full(n, 45.0), np.full(n, 180.0), theta_o, np.zeros(n),
                          values, aperture_half_angle=half_angle)  # fmt: skip
    records = measure_like(bsdf, table, rays=1_000_000)
    comparison = compare(records, table)
    agree(of_comparison(comparison))
    # what decides most comes first
    assert any("count as exact" in note for note in comparison.notes)
    assert "count as exact" in str(comparison).splitlines()[0]
    assert str(comparison).count("count as exact") == 1
    stated = compare(records, replace(table, uncertainty=0.01))
    assert "count as exact" not in str(stated)
    # twin: means over patches of 9 degrees are something else
    coarse = gonio.measure(bsdf, 45, 180, collector="angle:10x40", rays=1_000_000)
    disagree(of_comparison(compare(coarse, replace(table, header=OWN_PATCHES))))
    with pytest.raises(ValueError, match="too coarse for 15 of 15 points"):
        compare(coarse, table)


def test_apertures_that_cross_the_horizon_are_left_out():
    """And counted; if all do, nothing is left to compare."""
    theta_o = np.array([0.0, 40.0, 86.0, 88.0])
    same = np.full(4, 30.0), np.zeros(4), theta_o, np.full(4, 180.0)
    table = MeasuredTable(*same, np.full(4, 0.7 / np.pi), aperture_half_angle=5)
    records = measure_like(DIFFUSE, table, rays=20_000)
    found = compare(records, table, uncertainty=0.05)
    assert sorted(found.theta_o) == [0, 40]
    assert any("2 of 4 points, whose apertures reach below" in n for n in found.notes)
    low = replace(table, theta_o=np.full(4, 87.0))
    with pytest.raises(ValueError, match=r"each aperture .* below the horizon"):
        measure_like(DIFFUSE, low, rays=20_000)
    with pytest.raises(ValueError, match="aperture around theta_o, phi_o"):
        compare(records, low)


def test_overlapping_and_transmitted_points():
    """Groups of apertures join in one comparison; below the horizon too."""
    theta_o = np.arange(120.0, 180, 5)
    n = len(theta_o)
    columns = (np.full(n, 10.0), np.zeros(n), theta_o, np.full(n, 180.0))
    table = MeasuredTable(*columns, np.zeros(n), quantity="btdf", uncertainty=0.01)
    with pytest.raises(ValueError, match=r"aperture_half_angle .* must be given"):
        measure_like(DIFFUSE, table)
    with pytest.raises(TypeError, match="collector must come from the table"):
        measure_like(DIFFUSE, table, aperture_half_angle=4, collector="angle:2x2")
    records = measure_like(DIFFUSE, table, aperture_half_angle=4, rays=2000)
    assert len(records) == 2
    assert records[0].settings["seed"] != records[1].settings["seed"]
    comparison = compare(records, table)
    assert len(comparison.z) == n
    assert comparison.passed
    assert comparison.rms == 0


# ------------------------------------------------------------- picture and commands


@pytest.fixture
def saved(tmp_path):
    """Two records and two tables, one of them wrong, as files."""
    pytest.importorskip("matplotlib")
    a, b = gloss(seed=1), gloss(seed=2)
    a.save(tmp_path / "a.npz")
    b.save(tmp_path / "b.npz")
    values, _, _ = truth(a)
    table_of(a, values, uncertainty=0.005).save(tmp_path / "right.csv")
    table_of(a, 1.1 * values, uncertainty=0.005).save(tmp_path / "wrong.csv")
    return tmp_path


def test_azimuths_are_saved_in_one_turn(tmp_path):
    """Exact: a table that counts from the mirror direction ends at 360, which is 0."""
    phi = [0.0, -0.0, 360.0, 540.0, -90.0, -1e-15, 359.5]
    n = len(phi)
    table = MeasuredTable([30.0] * n, phi, [20.0] * n, phi, [0.1] * n)
    table.save(tmp_path / "a.csv")
    rows = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    saved = ["0.0", "0.0", "0.0", "180.0", "270.0", "0.0", "359.5"]
    assert [row[1] for row in rows[-n:]] == [row[3] for row in rows[-n:]] == saved


def test_commands(saved, capsys):
    picture = saved / "fig.png"
    a, b = str(saved / "a.npz"), str(saved / "b.npz")
    assert main(["compare", a, b, "-o", str(picture)]) == 0
    assert "verdict     agree" in capsys.readouterr().out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["compare", a, str(saved / "wrong.csv"), "--json"]) == 3
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["passed"] is False
    assert len(numbers["points"]) == numbers["n_points"] == 48
    assert len(numbers["worst"]) == 5
    right = str(saved / "right.csv")
    assert main(["compare", a, right, "--alpha", "1e-6"]) == 0
    loose = ["--uncertainty", "0.2"]
    assert main(["compare", a, str(saved / "wrong.csv"), *loose]) == 0


def test_commands_refuse_in_one_line(saved, capsys):
    a, right = str(saved / "a.npz"), str(saved / "right.csv")
    bad = saved / "bad.csv"
    bad.write_text(f"{HEADER}\n45,0,91,180,0.3,0\n")
    points = saved / "points.csv"
    points.write_text(f"{HEADER}\n45,0,30,180,0.3,0\n")
    for arguments, message in (
        ([a, str(bad)], "column theta_o"),
        ([a, str(saved / "none.csv")], "none.csv"),
        ([a, right, "-o", "fig.txt"], "must end in .pdf or .png or .svg"),
        ([a, right, "--uncertainty", "-1"], "uncertainty must be"),
        ([right, a], "RECORD must be"),
        (["diffuse", str(points)], "(--aperture-half-angle) must be given"),
    ):
        assert main(["compare", *arguments]) == 1
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1


def test_all_that_a_table_leaves_open_is_asked_for_at_once(saved, capsys):
    """Twin: with the answers it is read; and of a record no aperture is asked for."""
    path = str(saved / "open.csv")
    Path(path).write_text("theta_i,theta_o,550nm,650nm\n45,30,0.2,0.1\n45,40,0.2,0\n")
    options = ("--channel", "--quantity", "--azimuth", "--aperture-half-angle")
    answers = ("550nm", "brdf", "source", "2")

    def asked(record, *more):
        assert main(["compare", record, path, *more]) == 1
        said = capsys.readouterr().err
        return [one for one in options if f"say {one}" in said]

    assert asked("diffuse") == list(options)
    assert asked(str(saved / "a.npz")) == list(options[:3])
    for n, option in enumerate(options):
        pairs = [one for one in zip(options, answers) if one[0] != option]
        if n < 3:
            assert asked("diffuse", *itertools.chain(*pairs)) == [option]
    answered = itertools.chain(*zip(options, answers))
    loose = ("--uncertainty", "1", "--rays", "1e4")
    assert main(["compare", "diffuse", path, *answered, *loose]) != 1


def test_record_of_apertures_is_saved_shown_and_drawn(tmp_path, capsys):
    table = lambertian_table(0.7, aperture_half_angle=5)
    record, _ = measure_like(DIFFUSE, table, rays=20_000)
    for name in ("a.npz", "a.exr"):
        record.save(tmp_path / name)
        assert gonio.load(tmp_path / name) == record
    assert main(["show", str(tmp_path / "a.npz")]) == 0
    assert "apertures:5.0@" in capsys.readouterr().out
    figure = ["-o", str(tmp_path / "a.png")]
    assert main(["plot", str(tmp_path / "a.npz"), *figure]) == 0


def test_command_measures_a_specimen_like_the_table(tmp_path, capsys):
    path = tmp_path / "measured.csv"
    lambertian_table(0.7, aperture_half_angle=5).save(path)
    arguments = [str(path), "--rays", "2e5", "--alpha", str(budget.ALPHA)]
    assert main(["compare", "diffuse:reflectance=0.7", *arguments]) == 0
    assert main(["compare", "diffuse:reflectance=0.74", *arguments]) == 3
    assert "DIFFER" in capsys.readouterr().out


def test_command_measures_a_specimen_in_the_patches_of_a_table(tmp_path, capsys):
    """Which the table says to hold the means of, as exported ones do."""
    path = tmp_path / "measured.csv"
    specimen = {"type": "roughplastic", "alpha": 0.2}
    record = gonio.measure(specimen, 45, rays=10**5, collector="projected:6x8")
    gonio.export(record, path)
    arguments = [str(path), "--alpha", str(budget.ALPHA)]
    assert main(["compare", "roughplastic:alpha=0.2", *arguments]) == 0
    assert main(["compare", "roughplastic:alpha=0.3", *arguments]) == 3
    assert "DIFFER" in capsys.readouterr().out
    table = read_measured(path)
    assert table.degrees_of_freedom == record.n_batches - 1
    for other in ("a photodiode", "apertures:5@30/180"):
        unknown = replace(table, header={"collector": other})
        with pytest.raises(ValueError, match=r"aperture_half_angle .* must be given"):
            measure_like(specimen, unknown)
    written = tmp_path / "budget.csv"
    budgeted = ["--rays", "1e5", "--budget", str(written)]
    assert main(["compare", "roughplastic:alpha=0.2", str(path), *budgeted]) != 1
    assert "aperture" not in written.read_text()
    assert len(written.read_text().splitlines()) == len(table) + 1


@pytest.mark.parametrize("seed", [0, 5])
def test_a_record_and_its_own_table_do_not_share_rays(seed):
    """Exact: of one seed they would be the same; twin: the record measured again."""
    how = {"rays": 2**14, "seed": seed}
    record = gonio.measure(DIFFUSE, 45, collector="projected:4x4", **how)
    again = gonio.measure(DIFFUSE, 45, collector="projected:4x4", **how)
    assert np.array_equal(again.brdf, record.brdf)
    anew = measure_like(DIFFUSE, table_of(record, record.brdf.ravel()), **how)
    assert not np.array_equal(anew[0].brdf, record.brdf)


def test_a_table_of_a_wavelength_is_met_in_colour(tmp_path, capsys):
    """Copper's at 450 nm, a file beside that of 550 nm; the twin is grey."""
    copper = "roughconductor:material=Cu,alpha=0.3"
    of_copper = ["measure", copper, "--rays", "1e5", "--collector", "projected:6x8"]
    of_copper += ["--variant", "llvm_ad_spectral", "--wavelengths", "450", "550"]
    assert main([*of_copper, "--theta-i", "30", "-o", str(tmp_path / "a.npz")]) == 0
    capsys.readouterr()
    outputs = str(tmp_path / "a.csv"), str(tmp_path / "a.zemax.bsdf")
    assert main(["export", str(tmp_path / "a.npz"), "-o", *outputs]) == 0
    out = capsys.readouterr().out
    for number in (450, 550):
        for ending in ("csv", "zemax.bsdf"):
            path = tmp_path / f"a.brdf{number}nm.{ending}"
            assert path.exists()
            assert f"{path}\n" in out
    assert sum(path.suffix in (".csv", ".bsdf") for path in tmp_path.iterdir()) == 4
    arguments = ["compare", copper, str(tmp_path / "a.brdf450nm.csv")]
    arguments += ["--alpha", str(budget.ALPHA)]
    assert main(arguments) == 0
    assert main([*arguments, "--variant", "llvm_ad_mono"]) == 3


# ---------------------------------------------- what is compared, and its name


def test_labels_of_two_records(tmp_path):
    """Text and JSON call records by the setting in which they differ."""
    settings = {"theta_i": 30, "rays": 4096, "collector": "projected:4x4"}
    sphere = {"type": "sphere"}
    first, second, all_orders = (
        gonio.measure(sphere, order=order, seed=seed, **settings)
        for seed, order in enumerate((1, 2, "all"))
    )
    found = compare(first, second)
    assert found.labels == ("order 1", "order 2")
    assert "value of order 1, other of order 2" in str(found)
    assert found.to_dict()["labels"] == ["order 1", "order 2"]
    again = gonio.measure(sphere, seed=9, **settings)
    assert compare(all_orders, again).labels == ("seed 2", "seed 9")
    assert compare(again, again).labels == ("record", "other")
    grey = gonio.measure({"type": "diffuse"}, seed=9, **settings)
    white = gonio.measure({"type": "diffuse", "reflectance": 1.0}, seed=8, **settings)
    assert compare(grey, white).labels == ("diffuse", "diffuse:reflectance=1.0")
    found.plot(tmp_path / "labels.svg")
    for label in found.labels:
        assert f"{label} +- std" in (tmp_path / "labels.svg").read_text()


def test_lower_hemisphere_of_one_record():
    """Dark ones are left out; light that would be left out is refused."""
    settings = {"theta_i": 30, "rays": 2**14, "collector": "projected:4x4"}
    plate = {"type": "diffuse", "reflectance": 0.4}
    upper = gonio.measure(plate, **settings)
    both = gonio.measure(plate, hemispheres="both", seed=1, **settings)
    for one, other in ((upper, both), (both, upper)):
        found = compare(one, other)
        agree(of_comparison(found))
        assert len(found.z) == 16
        assert any("no light came" in note for note in found.notes)
    wrong = gonio.measure({"type": "diffuse", "reflectance": 0.42}, seed=1, **settings)
    disagree(of_comparison(compare(both, wrong)))
    glass = gonio.measure({"type": "roughdielectric"}, **settings)
    with pytest.raises(ValueError, match="measure the second with hemispheres"):
        compare(glass, upper)


def test_a_point_for_each_incidence_is_drawn_over_incidence():
    """One panel for all of them; twin: two points each have panels of their own."""
    incidence = np.array([60.0, 0.0, 30.0])
    settings = {"collector": "projected:4x8", "rays": 4096}
    record = gonio.measure({"type": "diffuse"}, incidence, **settings)
    for k, panels in ((1, 1), (2, 3)):
        theta_i = np.repeat(incidence, k)
        theta_o, zero = np.tile([20.0, 40.0][:k], 3), np.zeros(3 * k)
        table = MeasuredTable(theta_i, zero, theta_o, zero + 10, zero + 0.16)
        figure = comparison_figure(compare(record, table))
        axes = figure.get_axes()
        assert len(axes) == 2 * panels
        above, below = axes[0], axes[panels]
        drawn = np.asarray(above.containers[0][0].get_xdata()).tolist()
        assert drawn == ([0, 30, 60] if k == 1 else [-40, -20])
        assert below.get_xlabel().startswith("θᵢ" if k == 1 else "θₒ")
        assert k == 1 or below.get_xlabel().endswith("negative at φₒ = 10°")
        assert k == 1 or above.get_title() == "θᵢ = 60°, φᵢ = 0°, Y"


def test_a_picture_says_what_it_leaves_out_and_parts_hemispheres():
    """A panel for each, on one kind of axis, in the colours of what is drawn."""
    theta_i = tuple(np.linspace(0, 80, 8))
    both = {"theta_i": theta_i, "phi_i": (0,) * 8, "both": True, "power": 6}
    records = [synthetic.record("projected:8x16", seed=seed, **both) for seed in (1, 2)]
    figure = comparison_figure(compare(*records))
    above, below = figure.get_axes()[:3], figure.get_axes()[3:6]
    assert len(figure.get_axes()) == 12
    assert len({one.get_yscale() for one in figure.get_axes()[::6]}) == 1
    sides = [one.get_title().rpartition(", ")[2] for one in above]
    assert set(sides) == {"reflection", "transmission"}
    for one, scores in zip(above, below, strict=True):
        drawn = np.asarray(one.containers[0][0].get_xdata())
        assert np.abs(drawn).max() < 90  # from the pole of its own hemisphere
        of_record = one.containers[1][0].get_color()
        assert scores.lines[-1].get_color() != of_record
    title = figure.get_suptitle()
    assert "6 of 16 panels are shown; " in title
    assert title.endswith(f"of {2 * 8 * 128} points")


def drawn(theta_o, value, other):
    """Axes of a picture of these values, in the plane of incidence."""
    n = len(value)
    zero = np.zeros(n)
    found = Comparison(
        zero + 30, zero, theta_o, zero + 180, np.full(n, "Y"), value, zero + 1e-3,
        other, zero + 1e-3, zero, {}, {"chi2": 1.0}, 1e-3,
    )  # fmt: skip
    return comparison_figure(found).axes


def test_a_hemisphere_that_is_dark_in_both_is_not_drawn():
    """Twins: the other one is; and so is one with light in either of the two."""
    theta_o, dark = np.array([20.0, 40, 160, 140]), np.zeros(4)
    upper, lower = np.array([[0.1, 0.2, 0, 0], [0, 0, 0.1, 0.2]])
    for value, other, panels in (
        (upper, upper, 1),
        (lower, lower, 1),
        (upper, lower, 2),
        (dark, dark, 2),
    ):
        axes = drawn(theta_o, value, other)
        assert len(axes) == 2 * panels
        named = [one.get_title().rpartition(", ")[2] for one in axes[:panels]]
        both = ["reflection", "transmission"]
        assert named == (both if panels == 2 else ["Y"])
        quantity = "BSDF" if panels == 2 else "BTDF" if value is lower else "BRDF"
        assert axes[0].get_ylabel() == f"{quantity} (1/sr)"


@pytest.mark.parametrize(
    ("least", "scale"), [(0.01, "linear"), (1e-4, "log"), (-1e-4, "linear")]
)
def test_values_over_decades_are_drawn_logarithmically(least, scale):
    """Unless one is not positive, which such an axis would not show."""
    values = np.array([0.5, 0.1, 0.05, least])
    axes = drawn(np.linspace(10, 70, 4), abs(values), values)
    assert axes[0].get_yscale() == scale
