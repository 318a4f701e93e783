"""Small emitters near to a large specimen, and far off its middle."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, of_total

import gonio_mi as gonio

HALF = 50.0


def specimen(**bsdf):
    scale = mi.ScalarTransform4f().scale([HALF, HALF, 1])
    return {"type": "rectangle", "to_world": scale, "bsdf": {"type": "diffuse", **bsdf}}


def disk(x, y, height, radius):
    """Lambertian emitter that looks at the specimen, from below if that is negative."""
    turn = mi.ScalarTransform4f().translate([x, y, height])
    if height > 0:
        turn = turn.rotate([1, 0, 0], 180)
    return {
        "type": "disk",
        "to_world": turn.scale(radius),
        "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 3.0}},
    }


def sphere(x, y, height, radius):
    emitter = disk(x, y, height, radius) | {"type": "sphere", "radius": radius}
    return emitter | {"to_world": mi.ScalarTransform4f().translate([x, y, height])}


def bulb(x, y, height):
    return {
        "type": "point",
        "position": [x, y, height],
        "intensity": {"type": "uniform", "value": 0.01},
    }


@pytest.mark.parametrize(
    ("emitter", "settings"),
    [
        ((disk, 40, 0, 0.1, 0.05), {}),
        ((disk, 0, 10, 0.1, 0.05), {"emission": "equal_power"}),
        ((disk, -30, 20, 0.06, 0.03), {"trace": True}),
        ((sphere, 49.9, -49.9, 0.05, 0.02), {}),
        ((bulb, 10, -45, 0.02), {"emission": "radiometric"}),
        ((bulb, -5, 44, 0.03), {"footprint": 50.0, "trace": True}),
    ],
    ids=[
        "disk",
        "equal power",
        "traced disk",
        "sphere at a corner",
        "point",
        "in a round footprint",
    ],
)
def test_reflectance_under_a_near_emitter(emitter, settings):
    """A grey diffuse plate reflects the same however it is lit.

    Single rays near the emitter carry more than 2^30 of what the middle gets. Exact but
    for the rounding of each power to single precision.
    """
    kind, *place = emitter
    record = gonio.measure(
        specimen(reflectance=0.625), emitter=kind(*place), rays=2**20, **settings
    )
    assert record.ledger.invalid == 0
    assert record.ledger.reflected > 0
    np.testing.assert_allclose(record.dhr, 0.625, rtol=4 * np.finfo(np.float32).eps)


def form_factor(x, y):
    """Part of a Lambertian point's light on a rectangle below, corner under it.

    `x` and `y` are its signed sides in units of the height (Howell, factor B-3).
    """
    a, b = np.hypot(1, x), np.hypot(1, y)
    return (x / a * np.arctan(y / a) + y / b * np.arctan(x / b)) / (2 * np.pi)


def lit_between(low, high, place):
    """The same for the rectangle with the corners `low` and `high`."""
    x, y, height = place
    (x0, y0), (x1, y1) = (np.subtract(end, (x, y)) / height for end in (low, high))
    ends = form_factor(x0, y0) + form_factor(x1, y1)
    return ends - form_factor(x0, y1) - form_factor(x1, y0)


@pytest.mark.parametrize("place", [(40, 0, 6), (5, -40, 5), (-30, -30, 7)])
def test_share_of_two_halves(place):
    """A plate of two reflectances under a small emitter; twin: 3 % off."""
    texels = np.array([[[0.25], [0.75]]], dtype=np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True}
    plate = specimen(reflectance=texture | {"filter_type": "nearest"})
    record = gonio.measure(plate, emitter=disk(*place, 0.01), rays=2**20, seed=5)
    left = lit_between((-HALF, -HALF), (0, HALF), place)
    right = lit_between((0, -HALF), (HALF, HALF), place)
    truth = (0.25 * left + 0.75 * right) / (left + right)

    agree(of_total(record, truth))
    disagree(of_total(record, 1.03 * truth))


def test_spotlight_beside_the_middle():
    """A spot that leaves the middle dark lights the specimen all the same."""
    to_world = mi.ScalarTransform4f().look_at(
        origin=[30, 0, 10], target=[30, 0, 0], up=[0, 1, 0]
    )
    spot = {"type": "spot", "to_world": to_world, "cutoff_angle": 20.0}
    record = gonio.measure(specimen(reflectance=0.625), emitter=spot, rays=2**16)
    assert record.ledger.unlit > 0
    np.testing.assert_allclose(record.dhr, 0.625, rtol=4 * np.finfo(np.float32).eps)


def test_emitter_that_lights_nothing():
    """An emitter that looks away is refused."""
    emitter = disk(0, 0, 1, 0.1)
    emitter["to_world"] = mi.ScalarTransform4f().translate([0, 0, 1])
    with pytest.raises(ValueError, match="must light the specimen, got no light"):
        gonio.measure(specimen(), emitter=emitter, rays=100)
