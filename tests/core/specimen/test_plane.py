"""The flat rectangle that needs no ray tracing, wherever and however it lies."""

from dataclasses import replace

import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest
from budget import agree, difference_scores, disagree, normal_scores, single, verdict
from specimens import lamp

import gonio_mi as gonio
from gonio_mi.errors import SpecimenError

RAYS = 2**18
REFLECTING = {"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.5}
TRANSMITTING = {"type": "roughdielectric", "alpha": 0.4, "int_ior": 1.5}


def transform(*rows):
    return mi.ScalarTransform4f([*rows, [0, 0, 0, 1]])


def placed(name):
    """How a rectangle of 2 x 2 lies in the plane z = const."""
    sheared = transform([1, 0.6, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0])
    t = mi.ScalarTransform4f()
    return {
        "sheared": sheared,
        "rotated": t.rotate([0, 0, 1], 25).scale([1, 2, 1]),
        "both": sheared @ t.rotate([0, 0, 1], 25).scale([1, 2, 1]),
        "small": t.scale(1e-3) @ sheared,
        "mirrored": t.scale([-1, 1, 1]) @ sheared,
        "shifted": t.translate([3, -2, 0.5]) @ sheared,
    }[name]


def bitmap(pixels, filter_type="nearest"):
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.asarray(pixels, np.float32)[..., None]),
        "raw": True,
        "filter_type": filter_type,
    }


def textured(to_world):
    """Brushed metal, whose reflectance differs in 3 x 4 fields."""
    pixels = [[0.0, 0.3, 1.0], [0.9, 0.1, 0.0], [0.2, 0.8, 0.4], [0.0, 0.0, 0.7]]
    metal = REFLECTING | {"specular_reflectance": bitmap(pixels)}
    bsdf = {"type": "twosided", "bsdf": metal}
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def measured(specimen, theta_i=30, **settings):
    settings = {"rays": RAYS, "collector": "projected:6x12"} | settings
    return gonio.measure(specimen, theta_i, 40, sampler="independent", **settings)


def turned_map(record, sectors):
    """The record with its map turned by some sectors."""
    (tally,) = record.tallies
    rolled = replace(
        tally,
        hits=np.roll(tally.hits, sectors, axis=2),
        sums=np.roll(tally.sums, sectors, axis=3),
    )
    return replace(record, tallies=(rolled,))


CASES = {
    "metal": lambda: (REFLECTING, 50, {"footprint": "full"}),
    "point": lambda: (REFLECTING, 85, {"footprint": "point"}),
    "round": lambda: (REFLECTING, 85, {"footprint": 0.4}),
    "glass": lambda: (TRANSMITTING, 40, {"footprint": 0.4}),
    "from behind": lambda: (TRANSMITTING, 40, {"side": "back"}),
    "nearby": lambda: (TRANSMITTING, 40, {"collector_radius": 2.0}),
    "lamp": lambda: (REFLECTING, 30, {"emitter": lamp()}),
    "equal power": lambda: (
        TRANSMITTING,
        30,
        {"emitter": lamp(), "emission": "equal_power"},
    ),
}
PLACES = ("sheared", "rotated", "both", "small", "shifted", "mirrored")


@pytest.mark.parametrize("name", [*CASES, *PLACES])
def test_as_traced(name):
    """Patches, totals and what missed; twins: a sector aside, more light, more missed.

    Over an edge, where light lands tells what it meets, or that it missed.
    """
    if name in PLACES:
        # in units of the plate
        radius = 1.3 * (1e-3 if name == "small" else 1)
        specimen, theta_i, settings = textured(placed(name)), 30, {"footprint": radius}
    else:
        specimen, theta_i, settings = CASES[name]()
    plane = measured(specimen, theta_i, **settings)
    traced = measured(specimen, theta_i, **settings, trace=True, seed=1)
    assert plane.settings["transport"] == "plane"
    assert traced.settings["transport"] == "traced"
    for hemisphere in range(1 + plane.has_lower):
        agree(verdict(difference_scores(plane, traced, hemisphere)))
    brighter = int(plane.has_lower and plane.dhr[0] < 0.5)
    disagree(verdict(difference_scores(plane, turned_map(traced, 1), brighter)))
    of = "dht" if brighter else "dhr"
    (total, other), errors = (
        [getattr(record, name)[0] for record in (plane, traced)]
        for name in (of, f"{of}_std_err")
    )
    z = np.array([total - other, 1.05 * total - other]) / np.hypot(*errors)
    right, wrong = normal_scores(z, 2 * plane.n_batches - 2)
    agree(single(right))
    disagree(single(wrong))
    missed = [record.ledger.missed for record in (plane, traced)]
    assert any(missed) == (name in PLACES)
    if any(missed):
        p = sum(missed) / (2 * RAYS)
        spread = np.sqrt(2 * RAYS * p * (1 - p))
        agree(single((missed[0] - missed[1]) / spread))
        disagree(single((missed[0] - missed[1] + 0.01 * RAYS) / spread))


def test_a_rotated_rectangle_turns_the_lobe_of_brushed_metal():
    """As much as turning light and map the other way; twin: the light alone."""
    to_world = mi.ScalarTransform4f().rotate([0, 0, 1], 60).scale([2, 0.5, 1])
    specimen = {"type": "rectangle", "to_world": to_world, "bsdf": REFLECTING}
    settings = {"rays": RAYS, "collector": "projected:6x12", "sampler": "independent"}
    plane = gonio.measure(specimen, 50, 40, **settings)
    unturned = gonio.measure(REFLECTING, 50, -20, **settings, seed=2)
    agree(verdict(difference_scores(plane, turned_map(unturned, 2))))
    disagree(verdict(difference_scores(plane, unturned)))


@pytest.mark.parametrize("trace", [False, True])
def test_textured_rectangle(trace):
    """A quarter of the plate is white, seen by where light lands."""
    to_world = mi.ScalarTransform4f().rotate([0, 0, 1], 30).translate([3, -2, 0])
    bsdf = {"type": "diffuse", "reflectance": bitmap([[1.0, 0.0], [0.0, 0.0]])}
    specimen = {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}
    ledger = measured(specimen, trace=trace).ledger
    z = (ledger.reflected - RAYS / 4) / np.sqrt(RAYS * 3 / 16)
    agree(single(z))
    disagree(single(z + 0.02 * np.sqrt(RAYS)))


def of_bitmap(pixels, **settings):
    """A BSDF for each way in which a texture is nested in others."""
    texture = bitmap(pixels, **settings)
    plain = {"type": "diffuse", "reflectance": texture}
    halves = {"one": {"type": "diffuse"}, "other": {"type": "conductor"}}
    return {
        "diffuse": plain,
        "twosided": {"type": "twosided", "bsdf": plain},
        "mask": {"type": "mask", "opacity": texture, "bsdf": {"type": "diffuse"}},
        "blendbsdf": {"type": "blendbsdf", "weight": texture} | halves,
    }


@pytest.mark.parametrize("kind", ["diffuse", "twosided", "mask", "blendbsdf"])
def test_quadrature_sees_a_small_spot(kind):
    """Two by two of 200 x 200 texels, which few thousand random points miss."""
    pixels = np.full((200, 200), 0.001)
    pixels[57:59, 101:103] = 1
    settings = {"estimator": "quadrature", "collector": "projected:2x4"}
    with pytest.raises(SpecimenError, match="the same BSDF all over"):
        gonio.measure(of_bitmap(pixels)[kind], 30, **settings)
    # a bitmap of one value is no texture, though it is rounded between its texels
    same = of_bitmap(np.full((8, 8), 0.3), filter_type="bilinear")[kind]
    record = gonio.measure(same, 30, rays=1000, **settings)
    assert record.settings["transport"] == "plane"


def test_quadrature_sees_an_undeclared_texture():
    """A wrapper that tells of no texture is asked at random points."""
    nested = mi.load_dict({"type": "diffuse", "reflectance": {"type": "checkerboard"}})

    class Undeclared(plain_bsdf.plain()):
        def eval(self, ctx, si, wo, active=True):
            return nested.eval(ctx, si, wo, active)

    plain_bsdf.register([Undeclared])
    assert not any(
        isinstance(part, mi.Texture)
        for part in mi.traverse(mi.load_dict({"type": "undeclared"})).hierarchy
    )
    with pytest.raises(SpecimenError, match="the same BSDF all over"):
        gonio.measure({"type": "undeclared"}, 30, estimator="quadrature")


def test_a_collector_encloses_the_farthest_corner():
    """Exact: that of 2 x 2 is at sqrt(2), not at sqrt(3)."""
    settings = {"rays": 1000, "collector": "projected:2x4"}
    record = gonio.measure({"type": "diffuse"}, 30, collector_radius=1.5, **settings)
    assert record.settings["collector_radius"] == 1.5
    with pytest.raises(SpecimenError, match="must enclose the specimen"):
        gonio.measure({"type": "diffuse"}, 30, collector_radius=1.41, **settings)
