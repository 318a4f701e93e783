"""The flat rectangle that needs no ray tracing, wherever and however it lies."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, difference_scores, disagree, normal_scores, single, verdict

import gonio_mi as gonio
from gonio_mi.errors import SpecimenError

pytestmark = pytest.mark.usefixtures("mono")

RAYS = 2**18


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
    metal = {"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.5}
    return {
        "type": "rectangle",
        "to_world": to_world,
        "bsdf": {
            "type": "twosided",
            "bsdf": metal | {"specular_reflectance": bitmap(pixels)},
        },
    }


def measured(specimen, **settings):
    return gonio.measure(
        specimen,
        30,
        40,
        rays=RAYS,
        collector="projected:4x8",
        sampler="independent",
        **settings,
    )


def check(plane, traced):
    """Agreement of patches, totals, and of the rays that missed."""
    assert plane.settings["transport"] == "plane"
    assert traced.settings["transport"] == "traced"
    agree(verdict(difference_scores(plane, traced)))
    std_err = np.hypot(plane.dhr_std_err[0], traced.dhr_std_err[0])
    difference = plane.dhr[0] - traced.dhr[0]
    dof = 2 * plane.tallies[0].n_batches - 2
    agree(single(normal_scores(difference / std_err, dof)))
    disagree(single(normal_scores((difference + 0.05 * plane.dhr[0]) / std_err, dof)))


@pytest.mark.parametrize(
    "name", ["sheared", "rotated", "both", "small", "shifted", "mirrored"]
)
def test_as_traced(name):
    """Over an edge, where light lands tells what it meets, or that it missed."""
    specimen = textured(placed(name))
    # in units of the plate
    radius = 1.3 * (1e-3 if name == "small" else 1)
    plane = measured(specimen, footprint=radius)
    traced = measured(specimen, footprint=radius, trace=True, seed=1)
    check(plane, traced)
    missed = [record.ledger.missed for record in (plane, traced)]
    assert min(missed) > 0
    p = sum(missed) / (2 * RAYS)
    spread = np.sqrt(2 * RAYS * p * (1 - p))
    agree(single((missed[0] - missed[1]) / spread))
    disagree(single((missed[0] - missed[1] + 0.01 * RAYS) / spread))


# ------------------------------------------------------------- the same everywhere


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
    checks = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}

    class Wrapper(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.nested = mi.load_dict(checks)
            self.m_components = [mi.BSDFFlags.DiffuseReflection]
            self.m_flags = mi.BSDFFlags.DiffuseReflection

        def eval(self, ctx, si, wo, active=True):
            return self.nested.eval(ctx, si, wo, active)

        def to_string(self):
            return "Wrapper"

    mi.register_bsdf("undeclared", Wrapper)
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
