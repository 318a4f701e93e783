"""Records are composed and taken apart without losing a count, or refuse to be."""

import numpy as np
import pytest
import synthetic

from gonio_mi import load
from gonio_mi.results.record import Record

STACK = synthetic.record(theta_i=(0, 30, 60), phi_i=(0, 10, 20), both=True)


def test_a_stack_is_its_directions():
    assert len(STACK) == 3
    again = Record.stack([STACK[i] for i in range(3)])
    assert again == STACK
    for i, (theta, phi) in enumerate(((0, 0), (30, 10), (60, 20))):
        one = STACK[i]
        assert (one.theta_i.tolist(), one.phi_i.tolist()) == ([theta], [phi])
        np.testing.assert_array_equal(one.brdf, STACK.brdf[i])
        np.testing.assert_array_equal(one.btdf_std_err, STACK.btdf_std_err[i])
        np.testing.assert_array_equal(one.dht, STACK.dht[i])
        for of in ("brdf", "btdf", "dhr", "dht"):
            np.testing.assert_array_equal(
                one.interval(0.9, of), np.stack(STACK.interval(0.9, of), axis=1)[i]
            )
    assert STACK[-1] == STACK[2]
    assert STACK.ledger.emitted == sum(STACK[i].ledger.emitted for i in range(3))


@pytest.mark.parametrize("index", [None, "x", 1.5, (0, 1), True])
def test_what_is_no_index(index):
    with pytest.raises(TypeError, match="index must be a whole number or a slice, got"):
        STACK[index]


def test_indices_that_a_stack_does_not_have():
    assert STACK[np.int64(1)] == STACK[1]
    for index in (3, -4):
        with pytest.raises(IndexError, match=f"of 3 incident directions, got {index}"):
            STACK[index]


def test_a_record_is_no_array():
    with pytest.raises(TypeError, match="a Record is no array: take one of its attr"):
        np.asarray(STACK)


@pytest.mark.parametrize("path", [None, 3])
def test_what_is_no_path(path):
    for use in (STACK.save, load):
        with pytest.raises(TypeError, match=f"path must be .* a path, got {path}"):
            use(path)


def test_what_sums_to_the_totals():
    fractions = STACK.flux_fraction
    assert fractions.shape == (3, 2, 6, 8, 1)
    # rounding: a sum over 48 patches
    rtol = 48 * np.finfo(float).eps
    totals = np.stack([STACK.dhr, STACK.dht], axis=1)
    np.testing.assert_allclose(fractions.sum(axis=(2, 3)), totals, rtol=rtol)
    projected = STACK.subdivision.projected_solid_angles[..., None]
    for hemisphere, values in enumerate((STACK.brdf, STACK.btdf)):
        np.testing.assert_array_equal(values, fractions[:, hemisphere] / projected)


@pytest.mark.parametrize("of", ["brdf", "btdf", "dhr", "dht"])
def test_intervals_hold_what_they_are_of(of):
    low, high = STACK.interval(0.95, of)
    value = getattr(STACK, of)
    assert low.shape == value.shape
    assert np.all((low <= value) & (value <= high))


def test_what_there_is_no_interval_of():
    with pytest.raises(ValueError, match="of must be brdf or dhr for a record without"):
        synthetic.record().interval(of="dht")
    with pytest.raises(ValueError, match="of must be one of"):
        STACK.interval(of="bsdf")
    for level in (0, 1, float("nan")):
        with pytest.raises(ValueError, match="level must be between 0 and 1"):
            STACK.interval(level)
    assert synthetic.record().btdf is None
    assert synthetic.record().dht_std_err is None


def test_merged_records_have_the_rays_of_both():
    a, b = (
        synthetic.record(theta_i=(0, 30), phi_i=(0, 10), seed=seed).with_settings(
            batches=4
        )
        for seed in (1, 2)
    )
    both = a.merge(b)
    assert both.tallies == tuple(x + y for x, y in zip(a.tallies, b.tallies))
    assert both.n_batches == 8
    assert both.settings["seed"] == [1, 2]
    assert both.settings["rays"] == a.settings["rays"] + b.settings["rays"]
    assert both.ledger == a.ledger + b.ledger
    with pytest.raises(
        ValueError, match=r"different seeds to be merged, got \[1, 2, 2"
    ):
        both.merge(b)


def test_channels_of_a_grey_record_are_repeated():
    grey, tinted = synthetic.record(), synthetic.record(seed=2, channels="RGB")
    grey, tinted = (record.with_settings(batches=4) for record in (grey, tinted))
    merged = grey.merge(tinted)
    assert merged.channels == ("R", "G", "B")
    assert merged.tallies[0].channels == 3
    tinted = tinted.with_settings(seed=1)
    stacked = Record.stack([grey, tinted])
    assert stacked.channels == ("R", "G", "B")
    assert stacked.brdf.shape == (2, 6, 8, 3)
    np.testing.assert_array_equal(stacked[0].brdf[..., 2], grey.brdf[..., 0])


def test_what_records_of_unlike_origin_tell_together(tmp_path):
    """Numbers of NumPy's are told like others, and can be written."""
    a, b = (
        synthetic.record(seed=seed).with_provenance(
            seeds=(np.int64(seed),),
            rays=np.int64(80_000),
            batches=np.uint32(4),
            reached=np.float32(0.5),
            defects=("wrong by 0.2", f"wrong by 0.{seed}"),
            interrupted=seed == 2,
        )
        for seed in (1, 2)
    )
    both = a.merge(b).provenance
    assert both.defects == ("wrong by 0.2", "wrong by 0.1")
    assert (both.interrupted, both.rays, both.batches) == (True, 160_000, 8)
    assert not a.merge(b.with_provenance(interrupted=False)).provenance.interrupted
    for name in ("rays", "batches"):
        for merged in (
            a.merge(b.with_provenance(**{name: None})),
            b.merge(a.with_provenance(**{name: None})),
        ):
            assert getattr(merged.provenance, name) is None
    stacked = Record.stack([a, a.with_provenance(defects=("wrong by 0.3",))])
    assert stacked.provenance.defects == (
        "wrong by 0.2",
        "wrong by 0.1",
        "wrong by 0.3",
    )
    a.save(tmp_path / "a.npz")
    assert load(tmp_path / "a.npz").settings == a.settings
    with pytest.raises(ValueError, match="rays must be a count, got"):
        a.with_provenance(rays=np.bool_(True))


def test_records_without_seeds_are_not_merged():
    a, b = synthetic.record(), synthetic.record(seed=2)
    unknown = a.with_provenance(seeds=())
    for one, other in ((unknown, unknown), (unknown, b), (b, unknown)):
        with pytest.raises(ValueError, match="know their seeds to be merged, got none"):
            one.merge(other)


def test_records_of_other_wavelengths_stay_apart():
    one = synthetic.record(channels=("500nm", "600nm"))
    for channels in (("510nm", "700nm"), ("500nm",), "RG"):
        other = synthetic.record(seed=2, channels=channels)
        with pytest.raises(ValueError, match="agree in channels to be merged, got"):
            one.merge(other)
        other = other.with_settings(seed=1)
        with pytest.raises(ValueError, match="agree in channels to be stacked, got"):
            Record.stack([one, other])
    assert one.merge(one.with_settings(seed=2)).channels == one.channels


def test_records_without_an_incident_direction_are_merged():
    """Those under a sky have none."""
    unknown = {"theta_i": (np.nan,), "phi_i": (np.nan,)}
    a, b = (
        synthetic.record(**unknown, seed=seed).with_settings(batches=4)
        for seed in (1, 2)
    )
    assert a.merge(b).n_batches == 8
    with pytest.raises(ValueError, match="agree in theta_i to be merged"):
        a.merge(synthetic.record(phi_i=(np.nan,), seed=2))


@pytest.mark.parametrize("part", [slice(0, 2), slice(1, None), slice(None, None, -2)])
def test_a_slice_is_a_stack(part):
    sliced = STACK[part]
    assert sliced == Record.stack([STACK[i] for i in range(3)[part]])
    assert sliced.stacked


def test_a_slice_of_nothing():
    with pytest.raises(ValueError, match="at least one incident direction"):
        STACK[2:2]


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (synthetic.record("angle:6x8", seed=2), "agree in collector to be merged"),
        (synthetic.record(theta_i=(31,), seed=2), "agree in theta_i to be merged"),
        (synthetic.record(phi_i=(21,), seed=2), "agree in phi_i to be merged"),
        (synthetic.record(analog=True, seed=2), "agree in estimator to be merged"),
        (synthetic.record(), r"different seeds to be merged, got \[1, 1\]"),
    ],
)
def test_records_that_cannot_be_merged(other, message):
    with pytest.raises(ValueError, match=message):
        synthetic.record().merge(other)


def test_records_that_cannot_be_stacked():
    with pytest.raises(ValueError, match="at least one to be stacked, got none"):
        Record.stack([])
    other = synthetic.record().with_settings(side="back")
    with pytest.raises(
        ValueError, match="agree in side to be stacked, got 'front' and"
    ):
        Record.stack([synthetic.record(), other])


def test_what_makes_two_records_equal():
    assert synthetic.record() == synthetic.record()
    for other in (
        synthetic.record(seed=2),
        synthetic.record("angle:6x8"),
        synthetic.record(theta_i=(31,)),
        synthetic.record(phi_i=(21,)),
        synthetic.record(channels=("550nm",)),
        synthetic.record(stacked=True),
        synthetic.record().with_settings(side="back"),
        "a record",
    ):
        assert synthetic.record() != other
    unknown = synthetic.record(theta_i=(np.nan,))
    assert unknown == synthetic.record(theta_i=(np.nan,))
