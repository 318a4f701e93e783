"""A periodic cell stands for an infinite surface."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single, two_sample
from specimens import grooves, heightfield, traced

import gonio_mi as gonio
from gonio_mi.errors import SpecimenError

RAYS = 100_000
SCENES = Path(__file__).parents[3] / "scenes"
FIELD = {"alpha": 0.7, "resolution": 32}


def histogram(rays):
    patches = gonio.subdivision("projected:6x8")
    return np.bincount(patches.patch(rays.d[rays.reflected]), minlength=48)


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


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"period": "1.0"}, "must hold the geometry"),
        ({"period": (3, 1)}, "must hold the geometry"),
        *(({"period": x}, "positive numbers") for x in ("-1", "nan", "1,2,3", "ball")),
        *(
            ({"order": x}, "order must be")
            for x in ("00", "0+", "-1", "1.5", "+", "two")
        ),
    ],
)
def test_bad_periods_and_orders_are_one_sentence(settings, message):
    with pytest.raises((SpecimenError, ValueError), match=message) as caught:
        gonio.measure({"type": "diffuse"}, 30, rays=1000, **settings)
    assert "\n" not in str(caught.value)


def test_a_footprint_that_misses_is_one_sentence():
    apart = {"type": "scene"}
    for name, x in (("left", -3), ("right", 3)):
        at = mi.ScalarTransform4f().translate([x, 0, 0])
        apart[name] = {"type": "rectangle", "to_world": at}
    with pytest.raises(SpecimenError, match="but all 1000 rays missed it"):
        gonio.measure(apart, 30, footprint=0.2, rays=1000)


@pytest.mark.parametrize("collector", ["apertures:10@30/0", "receptors:30/0/20"])
def test_light_that_passes_by_a_collector_is_in_no_aperture(collector):
    """Exact: it leaves far from the cell, and meets the sphere in no direction."""
    settings = {"rays": 1000, "collector_radius": 5.0}
    beads = SCENES / "beads.xml"
    record = gonio.measure(beads, 4, collector=collector, **settings)
    rings = gonio.measure(beads, 4, collector="projected:2x2", **settings)
    assert record.ledger == rings.ledger
    assert record.ledger.sideways > 0
    assert record.counts.sum() == rings.counts.sum()
    # the twin: without a sphere all light has a direction
    far = gonio.measure(beads, 4, collector=collector, rays=1000)
    assert far.ledger.sideways == 0
