"""A periodic cell stands for an infinite surface."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single, two_sample
from slabs import medium
from specimens import GREY, grooves, heightfield, traced

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
        ({"period": "0.1"}, "at most 121 copies of the geometry, which is 2 x 2"),
        ({"period": (0.01, 1)}, "got 0.01 x 1 and 603 copies"),
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


PITCH, WIDTH, TILT = 16.67, 34.0, 45.0


def slat(begin=-1.0, end=1.0, shift=0.0):
    """Part of a slat that is twice as wide as its pitch, in half widths."""
    to_world = mi.ScalarTransform4f().translate([0, shift, 0]).rotate([1, 0, 0], TILT)
    place = [0, (begin + end) / 4 * WIDTH, 0]
    half = [PITCH / 2, (end - begin) / 4 * WIDTH, 1]
    to_world = to_world.translate(place).scale(half)
    return {"type": "rectangle", "to_world": to_world, "bsdf": GREY}


def closed_blind(floor=False):
    """Slats in one piece, and cut at the sides of the cell and shifted by hand."""
    end = PITCH / WIDTH / np.cos(np.radians(TILT))
    whole = {"type": "scene", "slat": slat()}
    cut = {
        "type": "scene",
        "low": slat(-1, -end, PITCH),
        "middle": slat(-end, end),
        "high": slat(end, 1, -PITCH),
    }
    if floor:
        under = (
            mi.ScalarTransform4f().translate([0, 0, -15]).scale([PITCH / 2] * 2 + [1])
        )
        plate = {"type": "rectangle", "to_world": under, "bsdf": GREY}
        whole["floor"] = cut["floor"] = plate
    return whole, cut


@pytest.mark.parametrize(
    ("theta_i", "phi_i", "settings"),
    [
        (30, 90, {}),
        (60, 270, {"side": "back"}),
        (30, 250, {"estimator": "split"}),
        (80, 45, {"estimator": "next_event"}),
    ],
)
def test_slats_wider_than_their_pitch(theta_i, phi_i, settings):
    """Against slats cut and shifted by hand. Twin: a tenth of the light elsewhere."""
    both = {"hemispheres": "both", "collector": "solid:2x4", "rays": 2**14}
    one, two = (
        gonio.measure(
            shapes, theta_i, phi_i, period=PITCH, seed=seed, **(both | settings)
        )
        for seed, shapes in enumerate(
            closed_blind(settings.get("estimator") == "split")
        )
    )
    for of in ("dhr", "dht"):
        a, b = (getattr(each, of).item() for each in (one, two))
        if a == b == 0:  # no light passes the floor
            continue
        spread = np.hypot(*(getattr(each, f"{of}_std_err") for each in (one, two)))
        agree(single((a - b) / spread.item()))
        disagree(single((a - 0.9 * b) / spread.item()))


def bar(shift, bsdf, **inside):
    to_world = mi.ScalarTransform4f().translate([0, shift, 0]).rotate([1, 0, 0], 35)
    to_world = to_world.scale([0.4, 0.7, 0.12])
    return {"type": "cube", "to_world": to_world, "bsdf": bsdf, **inside}


@pytest.mark.parametrize("fog", [False, True])
def test_closed_shapes_that_cross_the_sides_of_their_cell(fog):
    """Bars of glass against two of them in twice the cell. Twin: a third more."""
    inside = {"interior": medium(3.0, 0.9)} if fog else {}
    glass = {"type": "dielectric"}
    one, two = (
        gonio.measure(
            {"type": "scene"} | {f"at{y}": bar(y, glass, **inside) for y in range(n)},
            *(50, 60),
            period=(1, n),
            rays=2**14,
            seed=n,
        )
        for n in (1, 2)
    )
    assert one.ledger.astray == 0
    spread = np.hypot(one.dhr_std_err, two.dhr_std_err).item()
    off = (one.dhr - two.dhr).item()
    agree(single(off / spread))
    disagree(single((off + 0.3 * two.dhr.item()) / spread))


def test_a_plate_wider_than_its_cell_has_no_edges():
    """Rounding: of its copies in one plane light meets one."""
    grey = {"type": "rectangle", "bsdf": GREY}
    record = gonio.measure(grey, 60, 20, period=(1.3, 0.9), rays=4096)
    assert record.ledger.reflected == 4096
    assert abs(record.dhr[0] - 0.8) < 2.0**-22


def test_media_that_vary_must_fit_into_their_cell():
    half = {"type": "constvolume", "value": 0.5}
    fog = {"type": "heterogeneous", "albedo": half, "sigma_t": half}
    shape = bar(0, {"type": "null"}, interior=fog)
    with pytest.raises(SpecimenError, match="hold the geometry of a medium that vari"):
        gonio.measure(shape, 30, period=1, rays=100)
