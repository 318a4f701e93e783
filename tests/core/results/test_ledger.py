"""Every ray is in one row of the ledger, whatever a BSDF returns."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single

import gonio_mi as gonio

RAYS = 100_000


def scripted(weight, other=None, z=1.0, pdf=1.0):
    """BSDF whose `sample` returns a weight, in one half of the cases the `other` one.

    Its kernels are the same whatever the numbers are.
    """
    numbers = weight, weight if other is None else other, z, pdf
    weight, other, z, pdf = (dr.opaque(mi.Float, number) for number in numbers)

    class Scripted(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [self.m_flags]

        def sample(self, _ctx, _si, sample1, sample2, active):
            bs = dr.zeros(mi.BSDFSample3f)
            cosine = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.wo = z * cosine
            bs.pdf = pdf
            bs.eta = 1.0
            bs.sampled_type = mi.UInt32(int(self.m_flags))
            chosen = dr.select(sample1 < 0.5, weight, other)
            return bs, mi.Spectrum(chosen) & active

        def eval(self, *_):
            return mi.Spectrum(0.0)

        def pdf(self, *_):
            return mi.Float(0.0)

        def to_string(self):
            return "Scripted[]"

    mi.register_bsdf("scripted", Scripted)
    return {"type": "scripted"}


@pytest.mark.parametrize("trace", [False, True])
@pytest.mark.parametrize("estimator", ["analog", "weighted"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -0.5, 1e6])
def test_invalid_weights_have_their_row(value, estimator, trace):
    specimen = scripted(1.0, value)
    with pytest.warns(RuntimeWarning, match=r"negative, NaN or above .* invalid"):
        record = gonio.measure(
            specimen,
            30,
            rays=RAYS,
            estimator=estimator,
            trace=trace,
            sampler="independent",
        )
    ledger = record.ledger
    assert ledger.emitted == RAYS
    assert ledger.invalid + ledger.reflected == RAYS - ledger.missed
    assert record.counts.sum() == ledger.reflected
    # a valid ray weighs 1, an invalid one nothing: exact on a plane; where rays hit a
    # traced rectangle, Mitsuba's shading normal has a rounding error, and so the weight
    expected = ledger.reflected / (RAYS - ledger.missed)
    assert abs(record.dhr[0] - expected) <= trace * 2.0**-22
    met = RAYS - ledger.missed
    agree(single((ledger.invalid - met / 2) / np.sqrt(met / 4)))
    disagree(single((ledger.invalid - met * 0.48) / np.sqrt(met / 4)))


@pytest.mark.parametrize(
    ("weight", "z", "pdf", "row"),
    [
        (1.0, 1.0, 1.0, "reflected"),
        (0.0, 1.0, 1.0, "absorbed"),
        (0.0, 1.0, 0.0, "rejected"),
        (1.0, -1.0, 1.0, "transmitted"),
        (1.0, 0.0, 1.0, "invalid"),
        (1.0, 2.0, 1.0, "invalid"),
        (1.0, float("nan"), 1.0, "invalid"),
    ],
)
@pytest.mark.filterwarnings("ignore:the BSDF:RuntimeWarning")
def test_rows(weight, z, pdf, row):
    specimen = scripted(weight, z=z, pdf=pdf)
    record = gonio.measure(specimen, 30, rays=RAYS, sampler="independent")
    # exact: every ray has this fate
    assert record.ledger.rows[row] == RAYS
    assert record.ledger.emitted == RAYS
    if row not in ("reflected", "transmitted"):
        assert record.dhr[0] == 0
        assert record.counts.sum() == 0


@pytest.mark.filterwarnings("ignore:the BSDF is not energy conserving")
def test_weights_above_one_are_summed_exactly():
    """Exact: analog rays of weight 2.5 count twice or three times."""
    specimen = scripted(2.5)
    record = gonio.measure(specimen, 0, rays=RAYS)
    assert record.dhr[0] == 2.5
    analog = gonio.measure(
        specimen, 0, rays=RAYS, estimator="analog", sampler="independent"
    )
    assert analog.ledger.reflected == RAYS
    z = (analog.dhr[0] - 2.5) * np.sqrt(RAYS) / 0.5
    agree(single(z))
    disagree(single(z + 0.01 * 2.5 * np.sqrt(RAYS) / 0.5))


def test_truncated_rays():
    """Rays inside of a slab after `max_depth` events are truncated."""
    transform = mi.ScalarTransform4f().scale([1000, 1000, 0.5])
    slab = {"type": "cube", "to_world": transform, "bsdf": {"type": "dielectric"}}
    record = gonio.measure(slab, 0, rays=RAYS, max_depth=1)
    ledger = record.ledger
    # exact: what enters is still inside after one event
    assert ledger.transmitted == 0
    assert ledger.reflected + ledger.truncated == ledger.emitted == RAYS
    assert record.dhr[0] < 1


def test_missed_rays_are_not_incident():
    """A disk of light of twice the specimen's size: what misses it is no flux."""
    record = gonio.measure(
        {"type": "diffuse", "reflectance": 0.5},
        30,
        rays=RAYS,
        footprint=2.0,
        sampler="independent",
    )
    ledger = record.ledger
    assert ledger.missed + ledger.reflected + ledger.rejected == RAYS
    assert record.dhr[0] == 0.5 * ledger.reflected / (RAYS - ledger.missed)
    # the square of side 2 inside of a disk of radius 2
    p = 1 - 4 / (4 * np.pi)
    z = (ledger.missed - RAYS * p) / np.sqrt(RAYS * p * (1 - p))
    agree(single(z))
    disagree(single(z + 0.08 * np.sqrt(RAYS)))


@pytest.mark.usefixtures("rgb")
def test_same_reflectance_in_all_channels():
    """Exact: a ray weighs round(2^24 x) / 2^24 in each channel."""
    colour = [0.125, 0.3, 0.75]
    specimen = {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}
    record = gonio.measure(specimen, 45, rays=RAYS)
    ledger = record.ledger
    weight = np.round(np.float32(colour).astype(float) * 2**24) / 2**24
    # rounding: the BSDF divides by its density and multiplies, an ulp or two
    expected = weight * ledger.reflected / ledger.emitted
    np.testing.assert_allclose(record.dhr, expected, rtol=2.0**-22)
    assert not np.allclose(record.dhr, expected[::-1])


@pytest.mark.parametrize("trace", [False, True])
def test_same_seed_same_bits_on_any_number_of_threads(trace):
    def run(seed):
        return gonio.measure(
            {"type": "roughconductor", "alpha": 0.3},
            45,
            rays=300_000,
            seed=seed,
            trace=trace,
        ).tallies

    threads = dr.thread_count()
    try:
        first = run(5)
        for n in (1, 2, 5):
            dr.set_thread_count(n)
            assert run(5) == first
    finally:
        dr.set_thread_count(threads)
    assert run(6) != first


@pytest.mark.parametrize("trace", [False, True])
@pytest.mark.parametrize("estimator", ["analog", "weighted"])
def test_second_launch_compiles_nothing(estimator, trace):
    """Not at another angle, seed or number of rays either (the kernel history)."""

    def run(theta_i, seed, rays):
        gonio.measure(
            {"type": "roughconductor", "alpha": 0.123},
            theta_i,
            rays=rays,
            seed=seed,
            estimator=estimator,
            trace=trace,
        )

    def compiled():
        return [k for k in dr.kernel_history() if k.get("cache_hit") is False]

    # the plugin file's kernel may be cached on disk: only what comes after the first
    # run matters, and that run must show up in the history for the test to mean much
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        run(45, 0, 40_000)
        assert dr.kernel_history()
        for settings in ((45, 0, 40_000), (30, 0, 40_000), (45, 1, 40_000)):
            run(*settings)
            assert not compiled()
        run(45, 0, 70_000)
        assert not compiled()
