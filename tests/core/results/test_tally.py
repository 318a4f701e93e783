"""Tallies add, join and split without losing a count."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic

from gonio_mi.collector import subdivision
from gonio_mi.results.tally import Fate, Integrals, Ledger, Tally, batch_sizes

PATCHES = subdivision("angle:2x3")


def tally(seed, channels=1, n_batches=3):
    weights = np.full((2, 2, 3), 1 / 16)
    rng = np.random.default_rng(seed)
    return synthetic.tally(PATCHES, weights, 1000, rng, channels, n_batches)


@pytest.mark.parametrize(("rays", "batches"), [(10, 3), (9, 3), (2, 5), (1, 1)])
def test_batches_differ_by_one_ray_at_most(rays, batches):
    sizes = batch_sizes(rays, batches)
    assert sum(sizes) == rays
    assert len(sizes) == min(rays, batches)
    assert max(sizes) - min(sizes) <= 1


def test_ledger_rows_are_the_fates():
    ledger = Ledger.from_counts(range(1, len(Fate) + 1))
    assert [*ledger.rows, "over_the_edge"] == [fate.name.lower() for fate in Fate]
    # rays over the edge are in the rows of where they arrive
    assert ledger.emitted == sum(range(1, len(Fate)))
    assert (ledger.reflected, ledger.direct) == (1, Fate.DIRECT + 1)
    assert repr(Ledger(absorbed=3, missed=2)) == "Ledger(absorbed=3, missed=2)"
    assert eval(repr(ledger)) == ledger
    assert (ledger + ledger).rows == {k: 2 * n for k, n in ledger.rows.items()}


def test_joined_batches_follow_each_other():
    a, b = tally(1), tally(2)
    both = Tally.join([a, b])
    assert both.n_batches == 6
    np.testing.assert_array_equal(both.hits, a.hits + b.hits)
    for name in ("sums", "incident", "fates"):
        np.testing.assert_array_equal(getattr(both, name)[:3], getattr(a, name))
        np.testing.assert_array_equal(getattr(both, name)[3:], getattr(b, name))
    assert both == a + b
    assert both != b + a
    assert both.ledger == a.ledger + b.ledger


def test_an_achromatic_tally_joins_one_of_colours():
    grey, tinted = tally(1), tally(2, channels=3)
    both = grey + tinted
    assert both.channels == 3
    for channel in range(3):
        np.testing.assert_array_equal(both.sums[:3, ..., channel], grey.sums[..., 0])
        np.testing.assert_array_equal(both.incident[:3, channel], grey.incident[:, 0])
    np.testing.assert_array_equal(both.sums[3:], tinted.sums)
    assert grey.spread(3).achromatic
    assert not tinted.achromatic
    with pytest.raises(ValueError, match="of 3 channels cannot become one of 2"):
        tinted.spread(2)


def test_parts_of_a_batch_add_up():
    a, b = tally(1), tally(2, channels=3)
    whole = a.accumulate(b)
    assert whole.n_batches == 3
    np.testing.assert_array_equal(whole.hits, a.hits + b.hits)
    np.testing.assert_array_equal(whole.sums, a.sums + b.sums)
    np.testing.assert_array_equal(whole.incident, a.incident + b.incident)
    np.testing.assert_array_equal(whole.fates, a.fates + b.fates)


def test_channels_keep_their_order():
    a, b = tally(1, channels=2), tally(2, channels=3)
    joined = Tally.join_channels([a, b])
    assert joined.channels == 5
    np.testing.assert_array_equal(joined.hits, a.hits + b.hits)
    np.testing.assert_array_equal(joined.fates, a.fates + b.fates)
    for name in ("sums", "incident"):
        np.testing.assert_array_equal(getattr(joined, name)[..., :2], getattr(a, name))
        np.testing.assert_array_equal(getattr(joined, name)[..., 2:], getattr(b, name))
    np.testing.assert_array_equal(joined.first(2).sums, a.sums)
    np.testing.assert_array_equal(joined.first(2).incident, a.incident)


def test_errors_of_integrals_follow_their_channels():
    shape = (2, 2, 3, 3)
    errors = np.linspace(1e-4, 1e-3, 36).reshape(shape)
    whole = Integrals.beside(tally(1, channels=3), np.zeros(shape), errors)
    np.testing.assert_array_equal(whole.first(2).errors, whole.errors[..., :2])
    grey = Integrals.beside(tally(1), np.zeros((2, 2, 3, 1)), errors[..., :1])
    for channel in range(3):
        np.testing.assert_array_equal(
            grey.spread(3).errors[..., channel], grey.errors[..., 0]
        )


def test_what_cannot_be_joined():
    a = tally(1)
    other = synthetic.tally(
        PATCHES, np.full((1, 2, 3), 0.1), 10, np.random.default_rng()
    )
    for one in (other, replace(a, scale=1)):
        with pytest.raises(ValueError, match="must share patches and scale"):
            a + one
    shape = (*a.hits.shape, 1)
    whole = Integrals.beside(a, np.zeros(shape), np.zeros(shape))
    with pytest.raises(ValueError, match="that hold integrals cannot be joined"):
        whole + whole
