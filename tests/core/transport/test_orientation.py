"""Shapes that are mirrored or face away: Mitsuba's two normals need not agree there."""

from itertools import product

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, difference_scores, disagree, verdict
from specimens import both_sided, mesh, traced

import gonio_mi as gonio

RAYS = 2**17
FLAT_ON_TOP = ("rectangle", "disk", "cube")
DIFFUSE = {"type": "diffuse", "reflectance": 0.5}
GLASS = {"type": "roughdielectric", "alpha": 0.3}


def shape(kind, mirrored, bsdf, **parameters):
    """`kind` of shape, whose mirror image in x is the same set of points."""
    turn = mi.ScalarTransform4f()
    if kind == "cylinder":
        turn = turn.rotate([0, 1, 0], 90).translate([0, 0, -0.5])
    if kind.endswith(".ply"):
        parameters, kind = parameters | {"filename": kind}, "ply"
    x = mi.ScalarTransform4f().scale([-1 if mirrored else 1, 1, 1])
    return {"type": kind, "to_world": x @ turn, "bsdf": bsdf} | parameters


def is_black(specimen):
    """Whether Mitsuba's own path tracer sees none of the light from everywhere."""
    scene = {
        "type": "scene",
        "specimen": specimen,
        "light": {"type": "constant"},
        "integrator": {"type": "path", "max_depth": 2},
        "camera": {
            "type": "perspective",
            "fov": 1,
            "to_world": mi.ScalarTransform4f().look_at(
                origin=[0.1, 0.2, 4], target=[0.1, 0.2, 0], up=[0, 1, 0]
            ),
            "film": {"type": "hdrfilm", "width": 1, "height": 1},
            "sampler": {"type": "independent", "sample_count": 64},
        },
    }
    return not np.any(np.array(mi.render(mi.load_dict(scene))))


def measured(specimen, **settings):
    settings = {"rays": RAYS, "trace": True, "collector": "projected:4x8"} | settings
    return gonio.measure(specimen, 20, sampler="independent", **settings)


@pytest.mark.parametrize(
    ("kind", "mirrored", "flipped", "twosided"),
    [
        *product((*FLAT_ON_TOP, "sphere", "cylinder"), *[(False, True)] * 2, [False]),
        *(("rectangle", False, True, True), ("sphere", False, True, True)),
    ],
)
def test_black_is_what_mitsuba_says(kind, mirrored, flipped, twosided):
    """And a flat top that is lit sends every ray back."""
    bsdf = both_sided(DIFFUSE) if twosided else DIFFUSE
    specimen = shape(kind, mirrored, bsdf, flip_normals=flipped)
    record = measured(specimen, rays=2**14, footprint=0.2)
    black = is_black(specimen)
    assert (record.dhr[0] == 0) == black
    assert not (black and twosided)
    if kind in FLAT_ON_TOP and not black:
        met = record.ledger.emitted - record.ledger.missed
        assert record.ledger.reflected + record.ledger.rejected == met
        # each ray is rounded to 2^-24
        assert abs(record.dhr[0] - 0.5 * record.ledger.reflected / met) <= 2.0**-23


def smooth_sphere(path):
    """File of a coarse mesh with interpolated normals."""
    theta = np.linspace(0, np.pi, 9)[1:-1]
    phi = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    t, p = (x.ravel() for x in np.meshgrid(theta, phi, indexing="ij"))
    rings = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], 1)
    points = np.concatenate([rings, [[0, 0, 1], [0, 0, -1]]])
    faces = []
    for j in range(16):
        k = (j + 1) % 16
        faces += [(112, j, k), (113, 96 + k, 96 + j)]
        for i in range(0, 96, 16):
            faces += [(i + j, i + 16 + j, i + k), (i + k, i + 16 + j, i + 16 + k)]
    mesh(points, faces, normals=np.float32(points)).write_ply(str(path))
    return str(path)


@pytest.mark.parametrize(
    ("kind", "bsdf", "estimator"),
    [
        *(("cube", GLASS, "next_event"), ("cube", DIFFUSE, "weighted")),
        *(("rectangle", GLASS, "weighted"), ("rectangle", DIFFUSE, "next_event")),
        *(("cylinder", GLASS, "weighted"), ("cylinder", DIFFUSE, "next_event")),
        *(("smooth.ply", GLASS, "weighted"), ("smooth.ply", DIFFUSE, "next_event")),
    ],
    ids=lambda one: one["type"] if isinstance(one, dict) else one,
)
def test_mirror_image_of_symmetric_shapes(kind, bsdf, estimator, tmp_path):
    """Both measure the same, and so do their lower hemispheres. Twin: a darker one."""
    if kind.endswith(".ply"):
        kind = smooth_sphere(tmp_path / kind)
    # each ray of `next_event` lights all patches
    rays = RAYS // (64 if estimator == "next_event" else 4)
    settings = {"estimator": estimator, "rays": rays}
    plain = measured(shape(kind, False, bsdf), **settings)
    mirrored = measured(shape(kind, True, bsdf), seed=1, **settings)
    for hemisphere in range(1 + plain.has_lower):
        z = difference_scores(plain, mirrored, hemisphere)
        if z.size:
            agree(verdict(z))
    if kind == "cube" and bsdf is DIFFUSE:
        darker = shape(kind, True, bsdf | {"reflectance": 0.45})
        darker = measured(darker, seed=1, **settings)
        disagree(verdict(difference_scores(plain, darker)))


@pytest.mark.parametrize("theta_i", [0, 60, 89, 89.99])
def test_what_faces_away_loses_nothing(theta_i):
    """Exact: it is met from behind, however grazing light comes.

    Not at the very edge: a ray that looks again is moved by 2^-20 across the surface.
    """
    white = both_sided(DIFFUSE | {"reflectance": 1.0})
    floor = shape("rectangle", False, white, flip_normals=True)
    record = gonio.measure(floor, theta_i, rays=RAYS, trace=True, footprint=0.9)
    assert record.ledger.reflected + record.ledger.rejected == RAYS


def test_no_grazing_light_passes_what_faces_away():
    """Exact: below a wall is a floor, seen from behind; light goes down beside it."""
    white = both_sided(DIFFUSE | {"reflectance": 1.0})
    upright = mi.ScalarTransform4f().rotate([0, 1, 0], 90).translate([-0.5, 0, 0])
    scene = {
        "floor": shape("rectangle", False, white, flip_normals=True),
        "wall": {
            "type": "rectangle",
            "to_world": upright @ mi.ScalarTransform4f().scale([0.5, 1, 1]),
            "bsdf": white,
        },
    }
    rays = traced(scene, 60, period="none", n=2**20)
    over = rays.transmitted & rays.over_the_edge
    assert over.any()
    assert (rays.transmitted == over).all()
