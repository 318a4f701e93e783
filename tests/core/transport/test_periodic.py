"""A periodic cell stands for an infinite surface; orders add up to the whole."""

import gonio_mi as gonio

# isort: split
import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single, verdict
from specimens import MIRROR, grooves, heightfield, traced

from gonio_mi.errors import SpecimenError
from gonio_mi.results.tally import Fate

pytestmark = pytest.mark.usefixtures("mono")

RAYS = 100_000
FIELD = {"alpha": 0.7, "resolution": 32}


def histogram(rays):
    patches = gonio.subdivision("projected:6x8")
    return np.bincount(patches.patch(rays.d[rays.reflected]), minlength=48)


def two_sample(a, b):
    keep = a + b > 100
    a, b = a[keep], b[keep]
    return verdict((a - b) / np.sqrt(a + b))


@pytest.mark.parametrize("theta_i", [40, 85])
def test_many_cells_are_one(theta_i):
    """The same record for one period and for a mesh of 4 x 4 of them."""
    z = 0.05 * np.random.default_rng(1).standard_normal((16, 16))
    one = traced(heightfield(z), theta_i, 30.0, n=RAYS)
    many = traced(
        heightfield(np.tile(z, (4, 4)), size=8.0), theta_i, 30.0, n=RAYS, seed=1
    )
    assert one.reflected.all()
    assert many.reflected.all()
    agree(two_sample(histogram(one), histogram(many)))
    edges = traced(heightfield(z), theta_i, 30.0, n=RAYS, seed=1, period="none")
    if theta_i == 85:
        disagree(two_sample(histogram(one), histogram(edges)))


def test_a_thousand_grooves_are_one():
    one, many = (traced(grooves(30, n), 50, n=RAYS, seed=n) for n in (1, 1000))
    assert one.reflected.all()
    assert many.reflected.all()
    for order in (1, 2):
        a, b = np.mean(one.depth == order), np.mean(many.depth == order)
        spread = np.sqrt((a * (1 - a) + b * (1 - b)) / RAYS)
        if spread:
            agree(single((a - b) / spread))
            disagree(single((a - b + 0.05) / spread))


def test_cell_larger_than_the_geometry():
    """A mirror on a quarter of the cell reflects a quarter; the others pass."""
    plate = {"type": "rectangle", "bsdf": MIRROR}
    rays = traced(plate, 30, n=RAYS, period="4.0,4.0")
    share = rays.reflected.mean()
    assert rays.reflected.sum() + rays.fate_is(Fate.DIRECT).sum() == RAYS
    z = (share - 0.25) / np.sqrt(0.25 * 0.75 / RAYS)
    agree(single(z))
    disagree(single(z + 0.02 / np.sqrt(0.25 * 0.75 / RAYS)))


@pytest.mark.parametrize(
    ("period", "message"),
    [
        ("1.0", "must hold the geometry"),
        ((3, 1), "must hold the geometry"),
        ("-1", "positive numbers"),
        ("nan", "positive numbers"),
        ("1,2,3", "positive numbers"),
        ("sphere", "positive numbers"),
    ],
)
def test_bad_periods_are_one_sentence(period, message):
    with pytest.raises((SpecimenError, ValueError), match=message) as caught:
        gonio.measure({"type": "diffuse"}, 30, period=period, rays=1000)
    assert "\n" not in str(caught.value)


def test_a_footprint_that_misses_is_one_sentence():
    apart = {"type": "scene"}
    for name, x in (("left", -3), ("right", 3)):
        at = mi.ScalarTransform4f().translate([x, 0, 0])
        apart[name] = {"type": "rectangle", "to_world": at}
    with pytest.raises(SpecimenError, match="but all 1000 rays missed it"):
        gonio.measure(apart, 30, footprint=0.2, rays=1000)


@pytest.mark.parametrize("order", ["00", "0+", "-1", "1.5", "+", "two"])
def test_bad_orders_are_one_sentence(order):
    with pytest.raises((SpecimenError, ValueError), match="order must be") as caught:
        gonio.measure({"type": "diffuse"}, 30, order=order, rays=1000)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("estimator", ["weighted", "analog"])
def test_orders_add_up(estimator):
    """Exact: the sums of orders 1, 2 and 3+ are those of all rays."""
    grey = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.8}}
    field = heightfield(bsdf=grey, **FIELD)
    total, *parts = (
        gonio.measure(
            field, 50, period="box", order=order, estimator=estimator, rays=50_000
        )
        for order in ("all", 1, 2, "3+")
    )
    assert all(part.ledger.emitted == 50_000 for part in parts)
    assert all(part.counts.sum() > 0 for part in parts)
    (sums,) = (tally.sums for tally in total.tallies)
    assert np.array_equal(sum(part.tallies[0].sums for part in parts), sums)
    assert parts[0].ledger.other_order > 0
    assert total.ledger.other_order == 0


def test_render_and_measure_are_the_same():
    """Exact: a scene file's own period, and the one that is asked for."""
    scene = {
        "type": "scene",
        "integrator": {"type": "goniophotometer", "rays": 10_000, "period": "box"},
        "sensor": {"type": "collector", "film": {"type": "patches"}},
        "emitter": {"type": "directional", "direction": [0.5, 0, -0.8]},
        "shape": heightfield(**FIELD),
    }
    loaded = mi.load_dict(scene)
    mi.render(loaded)
    record = loaded.sensors()[0].film().record
    assert record.settings["period"] == "box"
    assert record.ledger.reflected == 10_000
    del scene["integrator"]["period"]
    asked = gonio.measure(scene, rays=10_000, period="box")
    assert asked.tallies == record.tallies


# ------------------------------------------------------------------------ coherence


@pytest.mark.parametrize("n", [1, 5, 1000, 2**12, 31_250])
def test_curve_is_a_permutation_of_neighbours(n):
    """Exact: the same points; and lanes side by side are points side by side."""
    import drjit as dr

    sampler = mi.load_dict({"type": "sobol"})
    points = []
    for follows in (False, True):
        sampler.seed(3, n)
        if follows:
            _, number = sampler.follow_curve()
        numbers = np.array(dr.ravel(sampler.next_2d())).reshape(-1, 2)
        if follows:
            numbers = numbers[number.numpy() < n]  # no points of nobody
        assert len(numbers) == n
        points.append(numbers)
    plain, curve = points
    order = [np.lexsort(p.T) for p in points]
    assert np.array_equal(plain[order[0]], curve[order[1]])
    if n >= 1000:
        steps = [np.median(np.hypot(*np.diff(p, axis=0).T)) for p in points]
        # a Morton curve: most steps are between neighbouring cells of area 1 / n
        assert steps[1] < 3 / np.sqrt(n) < steps[0]
