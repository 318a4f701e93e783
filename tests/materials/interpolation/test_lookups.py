"""Places in tables, found without a search: against NumPy's."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from lit_points import isotropic

from gonio_mi.materials.interpolation.interpolated_bsdf import InterpolatedBSDF
from gonio_mi.materials.interpolation.lobes import MeasuredLobes, check_table
from gonio_mi.materials.interpolation.lookups import Bins, SearchTree, singles

pytestmark = pytest.mark.usefixtures("mono")


def rising(n_rows, n):
    """Rows that rise to 1, of which some stretches are flat."""
    steps = np.random.default_rng(n).random((n_rows, n)) ** 8
    steps[:, -1] += 0.1
    rows = np.cumsum(np.where(steps < 0.01, 0, steps), axis=1)
    return (rows / rows[:, -1:]).astype(np.float32)


@pytest.mark.parametrize("n", [1, 7, 8, 9, 64, 65, 600])
def test_places_in_rows_are_found(n):
    """At each number, just below and in between; mixed rows as their mixture."""
    rows, others = rising(5, n), rising(5, n + 3)[:, :n]
    row = np.repeat(np.arange(5), 3 * n)
    # no denormal number, which kernels take for 0
    below = np.where(rows > 0, np.nextafter(rows, np.float32(0)), 0)
    values = np.stack([rows, below, rows * np.float32(0.99)], axis=-1)
    place = mi.UInt32(row), mi.Float(values.ravel())

    def expected(rows):
        return [np.searchsorted(rows[r], v, "right") for r, v in zip(row, values.flat)]

    assert np.array_equal(SearchTree(rows).find(*place).numpy(), expected(rows))
    mixed = SearchTree(rows, others).find(*place, 0.25).numpy()
    assert np.array_equal(mixed, expected(0.75 * rows + 0.25 * others))


def test_quantiles_are_the_inverse_of_the_rows():
    """What is below the bin and in it is the fraction; no bin of width 0 is drawn."""
    rows = rising(4, 100)
    fraction = np.append(np.random.default_rng(2).random(999), 0).astype(np.float32)
    for number, row in enumerate(rows):
        tree = SearchTree(rows[:, :-1])
        bins, inside = tree.quantile(mi.UInt32(number), mi.Float(fraction))
        low, high = (np.append(0, row)[bins.numpy() + k] for k in (0, 1))
        assert (high > low).all()
        error = np.abs(low + inside.numpy() * (high - low) - fraction)
        assert (error <= 4 * np.finfo(np.float32).eps).all()


@pytest.mark.parametrize("power", [1, 2, 9])
def test_bins_are_found(power):
    """Even ones, uneven ones, and some narrower than the steps of their table."""
    edges = (np.arange(41) / 40) ** power
    x = np.random.default_rng(3).random(5000).astype(np.float32) ** power
    found = Bins(edges).find(mi.Float(x)).numpy()
    expected = np.searchsorted(edges, x, "right") - 1
    clear = np.abs(x[:, None] - edges).min(axis=1) > np.finfo(np.float32).eps
    assert clear.mean() > 0.9 / power
    assert np.array_equal(found[clear], expected[clear])


@pytest.mark.parametrize("channels", [("L",), ("R", "G", "B")])
def test_a_table_needs_what_its_check_says(channels):
    """The memory of means, and of all that is held in Dr.Jit, within a tenth."""
    lobes = MeasuredLobes(isotropic(collector="angle:32x64", channels=channels))
    table = lobes.whole()
    face = InterpolatedBSDF(table)
    arrays = face.lobes.measured
    held = [arrays.cells, *arrays.ring_flux.arrays, *arrays.sector_flux.arrays]
    for pieces in (face.lobes.quantiles.strips, face.lobes.quantiles.cells):
        held += [pieces.packets, *pieces.tree.arrays]
    n_bytes = table.brdf.nbytes + 4 * sum(map(dr.width, held))
    # quantiles move between its three angles: two segments
    said = check_table(1, 3, lobes._shape) - check_table(1, 1, lobes._shape)
    said += check_table(2, 1, lobes._shape) / 2
    assert 0.9 * said <= n_bytes <= said


def test_memory_of_another_type_is_copied():
    values = np.arange(5.0)
    assert np.array_equal(singles(values).numpy(), values)
