"""Faint light keeps its value and its error bar, beside ordinary light or alone."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import Verdict, agree, disagree, normal_scores, of_total, single, verdict
from scipy.stats import poisson
from specimens import (
    both_sided,
    diffuse_groove_dhr,
    diffuse_groove_order,
    grooves,
    lamp,
)

import gonio_mi as gonio
from gonio_mi.instrument.launcher import LaunchSize
from gonio_mi.results.tally import WEIGHT_SCALE
from gonio_mi.specimen.loading import load_specimen
from gonio_mi.transport.method import USUAL_LEVELS
from gonio_mi.transport.sums import LEVELS, ONE, Digits, Exact, unit_of
from gonio_mi.transport.surface_events import RARE as RARE_CHANCE, whole_number

EPS32 = float(np.finfo(np.float32).eps)


def filters(n, transmittance):
    """Scene of `n` parallel clear plates that reflect nothing."""
    bsdf = {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.0}
    bsdf["specular_transmittance"] = transmittance
    places = [mi.ScalarTransform4f().translate([0, 0, -0.1 * i]) for i in range(n)]
    plates = [{"type": "rectangle", "to_world": one, "bsdf": bsdf} for one in places]
    return {"type": "scene"} | {f"plate{i}": one for i, one in enumerate(plates)}


def matte(reflectance):
    return {"type": "diffuse", "reflectance": reflectance}


def groove(rho, half_angle=40):
    return grooves(half_angle, 1, bsdf=both_sided(matte(rho)))


ORDINARY = [1.0, 0.3, 2**-13, 7.99]
RARE = [2**-13.01, 8.0, 1e-6, 1e-12, 1e-30, 1.2e-38, 3e5, 1e30]


def test_every_power_is_a_whole_number():
    """Exact: as ordinary numbers or in their level; what is no power is neither."""
    powers = [*ORDINARY, *RARE, 0.0, -0.0, -1.0, np.inf, np.nan]
    powers = np.array(powers, np.float32)
    digits = Digits(mi.Float(powers))
    ordinary, rare = np.array(digits.ordinary), np.array(digits.rare)
    number = np.array(digits.number()) / ONE
    level = np.array(digits.level())
    in_level = np.array(digits.number_in_level())
    n, m = len(ORDINARY), len(RARE)
    assert np.flatnonzero(ordinary).tolist() == [*range(n)]
    assert np.flatnonzero(rare).tolist() == [*range(n, n + m)]
    for i, power in enumerate(powers.tolist()):
        assert number[i] == (power if ordinary[i] else 0)
        if rare[i] or ordinary[i]:
            assert level[i] < LEVELS
            assert in_level[i] < 2**32
            one = Exact({unit_of(int(level[i])): in_level[i : i + 1]})
            assert one.powers() == power


def test_a_launch_of_the_largest_ordinary_powers_does_not_overflow():
    """Exact: 2**24 rays below 8, all in one patch; 1e12 of unit weight in float64."""
    largest = float(np.nextafter(np.float32(8), np.float32(0)))
    assert 2**24 * int(largest * ONE) < 2**63
    # of faint light, 2**7 deposits of each ray
    faint = np.nextafter(np.float32(2**-15), np.float32(0))  # the most of its level
    (number,) = np.array(Digits(mi.Float(faint)).number_in_level())
    assert 2**7 * 2**24 * int(number) < 2**63
    assert 1e12 * WEIGHT_SCALE + 1e4 > 1e12 * WEIGHT_SCALE


@pytest.mark.parametrize("transmittance", [0.3, 1e-4, 1e-9, 1e-30])
@pytest.mark.parametrize("n", [1, 4])
def test_filters_multiply(transmittance, n):
    """Transmittance of n filters: T^n; rounding: of n products in single precision."""
    expected = transmittance**n
    record = gonio.measure(filters(n, transmittance), 0, rays=1000, batches=4)
    if expected < 1e-38:  # nothing of that is left in single precision
        assert record.dht[0] == 0
        assert record.ledger.absorbed == record.ledger.emitted == 1000
        return
    np.testing.assert_allclose(record.dht[0], expected, rtol=2 * n * EPS32)
    assert record.ledger.transmitted == 1000


@pytest.mark.parametrize("transmittance", [0.3, 1e-9, 1e-30])
def test_russian_roulette_in_the_dark(transmittance):
    """Rounding: each batch of 2**16 evenly distributed rays has the mean by itself.

    A chance below 2**-24 would be that of the number 0, and far too high.
    """
    settings = {"rr_depth": 0, "trace": True, "rays": 2**18, "batches": 4}
    record = gonio.measure(filters(1, transmittance), 0, **settings)
    assert record.ledger.absorbed > 0.6 * 2**18
    np.testing.assert_allclose(record.dht[0], transmittance, rtol=8 * EPS32)


@pytest.mark.parametrize(
    ("half_angle", "theta_i", "rho", "estimator"),
    [
        (40, 25, 2e-3, "weighted"),
        (30, 50, 3e-5, "next_event"),
        (55, 0, 1e-9, "weighted"),
    ],
)
def test_third_order_of_dark_grooves(half_angle, theta_i, rho, estimator):
    """What leaves after three events, against the series of the radiosity equation."""
    truth, coarse = (
        diffuse_groove_order(half_angle, theta_i, rho, 3, nodes) for nodes in (32, 16)
    )
    settings = {"period": "box", "order": 3, "rays": 2**17, "estimator": estimator}
    settings["collector"] = "projected:4x6"
    record = gonio.measure(groove(rho, half_angle), theta_i, **settings)
    assert abs(truth - coarse) < record.dhr_std_err[0] / 100
    agree(of_total(record, truth))
    disagree(of_total(record, 0.8 * truth))


def test_the_series_of_orders_is_the_radiosity():
    """Rounding, of sums over a few hundred nodes: the reference's two ways."""
    orders = [diffuse_groove_order(30, 50, 0.3, order) for order in range(1, 30)]
    np.testing.assert_allclose(sum(orders), diffuse_groove_dhr(30, 50, 0.3), rtol=1e-13)


@pytest.mark.parametrize("power", [1e-7, 1e-25])
def test_coloured_emitter(power, rgb):  # noqa: ARG001
    """An emitter with little power in one channel: each channel's own reflectance.

    All rays that reach the diffuse plate leave it with a constant share. Rounding: of
    the products of a few events, in single precision.
    """
    emitter = lamp(1.0, 3.0)
    radiance = {"type": "rgb", "value": [power, 2.0, 3e4 * power]}
    emitter["emitter"]["radiance"] = radiance
    reflectance = [0.214, 0.5, 0.8]
    plate = matte({"type": "rgb", "value": reflectance})
    record = gonio.measure(plate, 20, emitter=emitter, rays=5000, batches=4)
    np.testing.assert_allclose(record.dhr, reflectance, rtol=8 * EPS32)


@pytest.mark.parametrize("dark", [1e-8, 1e-20])
def test_a_dark_channel_beside_a_bright_one(dark, rgb):  # noqa: ARG001
    """Rounding: of each weight; and the patches of all channels are alike."""
    plate = matte({"type": "rgb", "value": [0.9, dark, 0.5]})
    record = gonio.measure(plate, 20, rays=5000, batches=4, collector="projected:4x4")
    bright, faint = record.brdf[..., 0] / 0.9, record.brdf[..., 1] / dark
    np.testing.assert_allclose(faint, bright, rtol=8 * EPS32)
    shares = record.brdf_std_err / record.brdf
    # differences of sums that agree in two digits lose those, or are rounding alone
    np.testing.assert_allclose(
        shares[..., 1], shares[..., 0], rtol=800 * EPS32, atol=2**-50
    )


@pytest.mark.parametrize("chance", [1e-9, 1e-5, 0.3 * 2**-12, 0.3])
def test_small_chances_of_whole_numbers(chance):
    """Exact: all pairs of 24-bit numbers, of which each is compared by itself.

    Rounding: a step of the second number, or of the only one, of the chance.
    """
    chance = float(np.float32(chance))
    every = dr.arange(mi.Float, 2**24) * 2**-24
    rare = chance < RARE_CHANCE
    by_first = whole_number(mi.Spectrum(chance), every, mi.Float(0))
    by_second = whole_number(mi.Spectrum(chance), mi.Float(0), every)
    shares = [dr.count(whole[0] == 1)[0] / 2**24 for whole in (by_first, by_second)]
    assert shares[1] < 1 if rare else shares[1] == 1
    step = 2.0**-24 * (RARE_CHANCE if rare else 1)
    assert chance <= shares[0] * shares[1] < chance + step


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
def test_analog_rays_through_dark_filters(sampler, rgb):  # noqa: ARG001
    """Binomial, close to Poisson's law: a few rays in 10^5, none of 10^8 in 10^9."""
    chances = [1e-5, 1e-9, 1e-5]
    scene = filters(1, {"type": "rgb", "value": chances})
    settings = {"estimator": "analog", "sampler": sampler, "rays": 2**27}
    record = gonio.measure(scene, 0, collector="angle:1x1", **settings)
    hits = record.dht * 2**27
    some, none, again = np.round(hits)
    assert np.abs(hits - np.round(hits)).max() < 1e-3  # of a sum of whole numbers
    assert some == again  # the same random numbers for all channels
    expected = chances[0] * 2**27
    agree(single((some - expected) / np.sqrt(expected)))
    disagree(single((some - 1.2 * expected) / np.sqrt(1.2 * expected)))
    # chances that are multiples of 2^-24, or of 2^-23, would be at least 8 rays
    few = chances[1] * 2**27
    agree(Verdict({"many": poisson.sf(none - 1, few)}))
    disagree(Verdict({"many": poisson.sf(2**3 - 1, few)}))


@pytest.mark.parametrize("estimator", ["weighted", "next_event"])
def test_light_scales_with_reflectance(estimator):
    """A reflectance of 2**-40 takes 2**-80 of the second order, to the last bit."""

    def second(rho):
        settings = {"period": "box", "order": 2, "rays": 4000, "batches": 4}
        settings |= {"collector": "projected:3x4", "estimator": estimator}
        return gonio.measure(groove(rho), 25, **settings)

    white, dark = second(1.0), second(2.0**-40)
    assert dark.ledger == white.ledger
    assert np.array_equal(dark.tallies[0].hits, white.tallies[0].hits)
    exact = white.tallies[0].sums * 2.0**-80
    # rounding: the sum of a batch, once each
    np.testing.assert_allclose(dark.tallies[0].sums, exact, rtol=2**-52)
    assert (dark.brdf > 0).any()


def test_threads_and_launches_do_not_matter(monkeypatch):
    """Exact: the bits, for light from 1 down to 1e-24 in the same patches."""

    def tallies():
        settings = {"rays": 20_000, "batches": 2, "collector": "projected:3x4"}
        return gonio.measure(groove(1e-6), 25, period="box", **settings).tallies

    before, whole = dr.thread_count(), tallies()
    try:
        dr.set_thread_count(before + 3)
        assert tallies() == whole
    finally:
        dr.set_thread_count(before)
    for size in (2001, 7011):
        monkeypatch.setattr(
            LaunchSize, "next_part", lambda _, a, b, most, n=size: min(n, b - a, most)
        )
        assert tallies() == whole


def test_faint_light_in_a_stack_is_that_alone():
    """Exact: also where the room for rare powers is made as they are met."""
    theta_i = np.linspace(0, 80, 24)
    how = {"estimator": "weighted", "rays": 2**12, "collector": "projected:30x30"}
    stack = gonio.measure(matte(1e-5), theta_i.tolist(), **how)
    bins = theta_i.size * stack.n_batches * stack.subdivision.n_patches
    assert len(USUAL_LEVELS) * bins > dr.expand_threshold()
    for index in (0, 23):
        alone = gonio.measure(matte(1e-5), float(theta_i[index]), **how)
        assert np.array_equal(stack.brdf[index], alone.brdf)
        assert alone.brdf.any()


@pytest.mark.parametrize("suffix", ["npz", "exr"])
def test_files_keep_faint_light(suffix, tmp_path):
    record = gonio.measure(filters(1, 1e-30), 30, rays=1000, collector="projected:3x4")
    path = tmp_path / f"dark.{suffix}"
    record.save(path)
    assert gonio.load(path).tallies == record.tallies


def test_coverage_in_the_dark():
    """Errors of a dark traced groove's second order are as large as its error bars."""
    truth = diffuse_groove_order(40, 25, 1e-5, 2)
    scene = load_specimen(groove(1e-5))
    settings = {"period": "box", "order": 2, "collector": "projected:1x1", "rays": 1000}
    records = [gonio.measure(scene, 25, seed=seed, **settings) for seed in range(50)]
    degrees = records[0].n_batches - 1

    def scores(reference):
        t = [(one.dhr[0] - reference) / one.dhr_std_err[0] for one in records]
        return normal_scores(t, degrees)

    agree(verdict(scores(truth)))
    disagree(verdict(scores(0.95 * truth)))
