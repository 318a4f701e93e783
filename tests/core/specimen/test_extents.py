"""The box of a finite specimen is that of its surface, whatever shape it is made of."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single
from scipy.interpolate import BSpline
from specimens import GREY

import gonio_mi as gonio
from gonio_mi.errors import SpecimenError
from gonio_mi.specimen import shapes
from gonio_mi.specimen.shapes import bounds, farthest

SINGLE = 2.0**-22


def curve(path, points):
    np.savetxt(path, points)
    return {"type": "bsplinecurve", "filename": str(path), "bsdf": GREY}


def grid(values, **settings):
    """Signed distances, the axes in the order x, y, z."""
    values = np.ascontiguousarray(values.T[..., None], dtype=np.float32)
    shape = {"type": "sdfgrid", "grid": mi.TensorXf(values), "bsdf": GREY}
    # its other normals, of shading, bend at the border of the grid
    return shape | {"normals": "analytic"} | settings


def tilted_grid():
    """The plane z = 0.3 + 0.2 x: linear, so that the grid interpolates it exactly."""
    x, _, z = np.meshgrid(*[np.linspace(0, 1, 9)] * 3, indexing="ij")
    return grid((z - 0.3 - 0.2 * x) / np.hypot(1, 0.2))


def box(shape):
    return np.array(bounds([mi.load_dict(shape)]))


@pytest.mark.parametrize("radius", [0.1, None])
def test_curve(tmp_path, radius):
    """Circles about SciPy's spline, across its tangent: the square of their steps."""
    rng = np.random.default_rng(2)
    points = np.c_[rng.uniform(-1, 1, (9, 3)), rng.uniform(0.05, 0.2, 9)]
    if radius:
        points[:, 3] = radius
    spline = BSpline(np.arange(13) - 3.0, points, 3)
    t = np.linspace(0, 6, 6001)[:, None]
    p = spline(t[:, 0])
    tangent = spline.derivative()(t[:, 0])[:, :3]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.3, -0.5, 0.8])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, 721)[:, None, None]
    rings = np.cos(angle) * side + np.sin(angle) * np.cross(tangent, side)
    rings = (p[:, :3] + p[:, 3:] * rings).reshape(-1, 3)
    shape = curve(tmp_path / "curve.txt", points)
    own = np.array([rings.min(axis=0), rings.max(axis=0)])
    # angles of 0.25 degrees miss up to 1e-5 of a radius, and 0.001 of a segment less
    assert np.abs(box(shape) - own).max() < 2e-5
    loose = mi.load_dict(shape).bbox()
    assert np.abs(np.ravel([loose.min, loose.max]) - own.ravel()).max() > 0.1


def test_grid():
    """Exact: a plane, and the chords of a ball between the points of the grid."""
    assert np.allclose(box(tilted_grid()), [[0, 0, 0.3], [1, 1, 0.5]], atol=SINGLE)
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, n) for n in (9, 17, 33)], indexing="ij")
    ball = np.sqrt(x**2 + y**2 + z**2) - 0.5
    to_world = mi.ScalarTransform4f().translate([0, 0, 3]).scale([2, 4, 6])
    low, high = box(grid(ball, to_world=to_world))
    # the ball's poles are points of the grid
    assert np.allclose(low, [0.5, 1, 3 + 1.5], atol=8 * SINGLE)
    assert np.allclose(high, [1.5, 3, 3 + 4.5], atol=8 * SINGLE)


def test_other_boxes_are_mitsubas():
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], 45)
    ball, disk = {"type": "sphere", "radius": 0.5}, {"type": "disk", "to_world": turned}
    low, high = bounds([mi.load_dict(ball), mi.load_dict(disk)])
    assert np.allclose([-low, high], [1, 1, 0.5], atol=SINGLE)


def same_geometry(name, path):
    """One surface as a shape with a loose box, and as one with a tight box."""
    Transform = mi.ScalarTransform4f
    if name == "grid":
        matrix = np.eye(4)
        matrix[:3] = [[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0.1, 0, 1, 0.4]]
        rectangle = {"type": "rectangle", "to_world": Transform(matrix), "bsdf": GREY}
        return tilted_grid(), rectangle
    x = np.linspace(-0.9, 0.9, 4)
    line = curve(path / "line.txt", np.c_[x, 0 * x, 0 * x, 0 * x + 0.3])
    ends = {"p0": [-0.3, 0, 0], "p1": [0.3, 0, 0]}
    return line, {"type": "cylinder", **ends, "radius": 0.3, "bsdf": GREY}


@pytest.mark.parametrize("name", ["grid", "curve"])
def test_one_surface_is_measured_as_another_shape_of_it(name, tmp_path, monkeypatch):
    """Light over the edge is the same. Twin: the boxes that Mitsuba gives."""
    settings = {"rays": 60_000, "collector": "projected:4x6", "sampler": "independent"}

    angles = (40, 30) if name == "grid" else (60, 90)

    def scores(shape, other):
        one = gonio.measure(shape, *angles, **settings, seed=1)
        two = gonio.measure(other, *angles, **settings, seed=2)
        a, b = (
            r.ledger.over_the_edge / (r.ledger.emitted - r.ledger.missed)
            for r in (one, two)
        )
        spread = np.sqrt((a * (1 - a) + b * (1 - b)) / (60_000 - two.ledger.missed))
        total = np.hypot(one.dhr_std_err, two.dhr_std_err)
        return (a - b) / spread, ((one.dhr - two.dhr) / total).item()

    shape, other = same_geometry(name, tmp_path)
    for z in scores(shape, other):
        agree(single(z))
    monkeypatch.setattr(shapes, "SURFACES", {})
    disagree(single(scores(shape, other)[0]))


@pytest.mark.parametrize(
    ("kind", "points"),
    [
        ("sphere", None),
        ("rectangle", [(1, 1, 0), (-1, 1, 0), (1, -1, 0), (-1, -1, 0)]),
        ("disk", "circle"),
        ("cylinder", "circle"),
        ("cube", [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]),
    ],
)
def test_farthest_point_from_the_origin(kind, points):
    """That of many points, turned and moved by NumPy; no box has it."""
    turn = mi.ScalarTransform4f().translate([0.3, -0.2, 0.5])
    turn = turn.rotate([2 / 3, 1 / 3, 2 / 3], 40).scale(
        0.7 if kind == "sphere" else [0.7, 0.7, 1]
    )
    angle = np.linspace(0, 2 * np.pi, 100_001)
    if points == "circle":
        points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        if kind == "cylinder":
            points = np.concatenate([points, points + [0, 0, 1]])
    matrix = np.array(turn.matrix, dtype=float).reshape(4, 4)
    truth = 0.7 + np.linalg.norm(matrix[:3, 3])
    if points is not None:
        moved = np.array(points) @ matrix[:3, :3].T + matrix[:3, 3]
        truth = np.linalg.norm(moved, axis=1).max()
    shape = mi.load_dict({"type": kind, "to_world": turn})
    # a polygon about a circle is larger by (pi / 2048)^2 / 2 of its radius
    assert -SINGLE < farthest([shape]) - truth < 2e-6
    corner = np.linalg.norm(np.abs(bounds([shape])).max(axis=0))
    assert corner > 1.02 * truth


def test_a_collector_needs_to_enclose_a_ball_alone():
    """Exact: all light of a white ball arrives; its box has a corner at sqrt(3)."""
    ball = {"type": "sphere", "bsdf": {"type": "conductor", "material": "none"}}
    how = {"rays": 1000, "collector": "projected:2x4", "hemispheres": "both"}
    record = gonio.measure(ball, 30, collector_radius=1.01, **how)
    np.testing.assert_allclose(record.dhr + record.dht, 1, rtol=SINGLE)
    with pytest.raises(SpecimenError, match=r"reaches 1 from the origin, got 0\.99"):
        gonio.measure(ball, 30, collector_radius=0.99, **how)
