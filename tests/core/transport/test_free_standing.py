"""Free-standing specimens: light counts by its direction, whatever side it passes."""

import mitsuba as mi
import numpy as np
import pytest
import solids
from budget import (
    agree,
    difference_scores,
    disagree,
    of_total,
    scores,
    single,
    verdict,
)
from slabs import medium
from specimens import GREY, both_sided, heightfield, specimen_of

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.results.summary import summarize
from gonio_mi.transport.beam import Beam

WHITE = {"type": "diffuse", "reflectance": 1.0}
NULL = {"type": "null"}
RAYS = 2**15
THETA_I = 40.0
COS, SIN = np.cos(np.radians(THETA_I)), np.sin(np.radians(THETA_I))
WI = np.array([SIN, 0.0, COS])

# Convex bodies, and the mean of n.z over the light that meets them from THETA_I, phi 0.
BODIES = {
    "sphere": ({"type": "sphere"}, 2 / 3 * COS),
    "cylinder": (
        {"type": "cylinder", "p0": [0, -1, 0], "p1": [0, 1, 0]},
        np.pi / 4 * COS,
    ),
    "cube": ({"type": "cube"}, COS / (COS + SIN)),
}


def measured(shape, theta_i=THETA_I, bsdf=WHITE, **settings):
    """Lit over more than its shadow, which on the plane of its top is beside it."""
    settings = {
        "rays": RAYS,
        "footprint": 2.9,
        "collector": "solid:4x6",
        "sampler": "independent",
    } | settings
    return gonio.measure(shape | {"bsdf": bsdf}, theta_i, **settings)


@pytest.mark.parametrize(
    ("body", "estimator"),
    [
        ("sphere", "analog"),
        ("cylinder", "next_event"),
        ("cube", "weighted"),
    ],
)
def test_white_bodies_have_the_totals_of_their_normals(body, estimator):
    """In closed form: a face sends (1 + n.z) / 2 up. Twin: less what passed a side."""
    shape, mean = BODIES[body]
    record = measured(shape, estimator=estimator)
    ledger = record.ledger
    met = ledger.emitted - ledger.missed
    assert ledger.reflected + ledger.transmitted + ledger.rejected == met
    agree(of_total(record, (1 + mean) / 2))
    agree(of_total(record, (1 - mean) / 2, "dht"))
    kept = 1 - ledger.over_the_edge / met
    disagree(of_total(record, kept * (1 + mean) / 2))


def lambert_sphere(subdivision):
    """Flux fractions of patches of both hemispheres (Lambert 1760; Schoenberg 1929)."""
    theta_low, theta_high, phi_low, phi_high = subdivision.cells.T[..., None, None]
    x, weights = np.polynomial.legendre.leggauss(12)
    z_low, z_high = np.cos(theta_high), np.cos(theta_low)
    z = (z_low + z_high + (z_high - z_low) * x[:, None]) / 2
    phi = (phi_low + phi_high + (phi_high - phi_low) * x) / 2
    area = (z_high - z_low) * (phi_high - phi_low) / 4 * weights[:, None] * weights
    across = np.sqrt(1 - z**2) * np.cos(phi)
    flux = []
    for sign in (1, -1):
        phase = np.arccos(SIN * across + sign * COS * z)
        bright = np.sin(phase) + (np.pi - phase) * np.cos(phase)
        flux.append((2 / (3 * np.pi**2) * bright * area).sum(axis=(1, 2)))
    return np.reshape(flux, (2, *subdivision.shape))


@pytest.mark.parametrize("estimator", ["weighted", "next_event"])
def test_a_white_sphere_is_lamberts(estimator):
    """All patches in closed form. Twin: those of the other azimuths."""
    record = measured(
        {"type": "sphere"}, footprint=2.2, estimator=estimator, rays=2**17
    )
    expected = lambert_sphere(record.subdivision)
    # exact: the mean normal of the total above
    np.testing.assert_allclose(expected[0].sum(), (1 + 2 / 3 * COS) / 2, rtol=1e-4)
    for hemisphere in (0, 1):
        agree(verdict(scores(record, expected[hemisphere], hemisphere)))
        mirrored = np.roll(expected[hemisphere], 3, axis=1)
        disagree(verdict(scores(record, mirrored, hemisphere)))


def lit_points(body, n, rng):
    """Points of a body that light meets, and their normals."""
    if body == "sphere":
        r, phi = np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
        x, y = r * np.cos(phi), r * np.sin(phi)
        axes = np.array([[COS, 0, -SIN], [0, 1, 0], WI])
        p = np.stack([x, y, np.sqrt(1 - r**2)], axis=1) @ axes
        return p, p
    p = rng.uniform(-1, 1, (n, 3))
    top = rng.uniform(size=n) < COS / (COS + SIN)
    p[top, 2] = p[~top, 0] = 1
    return p, np.stack([~top, 0 * top, top], axis=1).astype(float)


def arrived(p, d, radius, shape):
    """Counts of the patches of both hemispheres, of equal steps of z and azimuth."""
    along = np.sum(p * d, axis=1)
    t = -along + np.sqrt(along**2 + radius**2 - np.sum(p * p, axis=1))
    x, y, z = (p + t[:, None] * d).T / radius
    ring = ((1 - np.abs(z)) * shape[0]).astype(int)
    sector = (np.arctan2(y, x) / (2 * np.pi) % 1 * shape[1]).astype(int)
    number = np.ravel_multi_index((z < 0, ring, sector), (2, *shape))
    return np.bincount(number, minlength=2 * shape[0] * shape[1])


@pytest.mark.parametrize("body", ["sphere", "cube"])
def test_white_bodies_in_a_collector_nearby(body):
    """Against rays in NumPy, and `next_event`. Twin: the same rays from far away."""
    near = {"collector_radius": 2.5}
    record = measured(BODIES[body][0], **near)
    rng, n = np.random.default_rng(0), 400_000
    p, normal = lit_points(body, n, rng)
    # Lambert's law: the normal and a point of the unit sphere
    d = normal + direction(
        np.arccos(rng.uniform(-1, 1, n)), rng.uniform(0, 2 * np.pi, n)
    )
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    counts, met = record.counts.ravel(), record.counts.sum()

    def compared(radius):
        expected = arrived(p, d, radius, (4, 6))
        share = (counts + expected) / (met + n)
        some = share > 30 / met
        z = counts / met - expected / n
        spread = np.sqrt(share * (1 - share) * (1 / met + 1 / n))
        return verdict(z[some] / spread[some])

    agree(compared(2.5))
    disagree(compared(1e6))
    deposited = measured(BODIES[body][0], **near, estimator="next_event", seed=1)
    far = measured(BODIES[body][0], estimator="next_event", seed=1)
    for hemisphere in (0, 1):
        agree(verdict(difference_scores(record, deposited, hemisphere)))
        disagree(verdict(difference_scores(record, far, hemisphere)))


PERFECT = {"type": "conductor", "material": "none"}


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"estimator": "analog", "side": "back"},
        {"estimator": "next_event"},
        {"divergence": 5.0},
        {"incident": "solid:6x8"},
    ],
    ids=["weighted", "analog", "next_event", "diverging", "patches"],
)
def test_a_mirror_ball_scatters_evenly_from_everywhere(settings):
    """In closed form: 0.5, by the default footprint. Twin: 4 % more.

    Exact: a direction has the bits that it has alone.
    """
    ball = {"type": "sphere", "to_world": mi.ScalarTransform4f().translate([3, 1, 2])}
    settings = {"footprint": None, "sampler": None, "rays": 2**16} | settings
    angles = [0, 40, 70]
    stack = measured(ball, angles, bsdf=PERFECT, **settings)
    for record in stack:
        agree(of_total(record, 0.5))
        disagree(of_total(record, 0.52))
    alone = measured(ball, 70, bsdf=PERFECT, **settings)
    again = stack[angles.index(70)]
    np.testing.assert_array_equal(alone.flux_fraction, again.flux_fraction)
    assert alone.ledger == again.ledger


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_a_mirror_ball_of_any_size_at_grazing_incidence(scale):
    """In closed form. Twin: 6 % more."""
    ball = {"type": "sphere", "to_world": mi.ScalarTransform4f().scale(scale)}
    record = measured(ball, 89, bsdf=PERFECT, footprint=None)
    agree(of_total(record, 0.5))
    disagree(of_total(record, 0.53))


def mesh(vertices, faces):
    shape = mi.Mesh("mesh", len(vertices), len(faces))
    shape_parameters = mi.traverse(shape)
    shape_parameters["vertex_positions"] = np.ravel(vertices).astype(np.float32)
    shape_parameters["faces"] = np.ravel(faces).astype(np.uint32)
    shape_parameters.update()
    return shape


TORUS = solids.torus(7, 4, 1.0, 0.4)
BOX = solids.box(1.0, 0.6, 0.35)
PIPE = {"type": "cylinder", "p0": [0, -1.5, 0], "p1": [0, 1.5, 0], "radius": 0.8}
TRACED = {
    "tube": (PIPE, solids.tube(0.8, 1.5), 1.71),
    "box": (BOX, solids.triangles(*BOX), 1.22),
    "torus": (TORUS, solids.triangles(*TORUS), 1.41),
}


@pytest.mark.parametrize(
    ("solid", "mirror", "theta_i", "phi_i"),
    [
        ("tube", True, 70, 120),
        ("tube", False, 40, 30),
        ("box", False, 70, 120),
        ("torus", True, 60, 30),
    ],
)
def test_solids_are_lit_all_over(solid, mirror, theta_i, phi_i, tmp_path):
    """Against rays in NumPy, by the default footprint. Twin: from 10 degrees higher."""
    shape, hits, radius = TRACED[solid]
    if solid != "tube":
        path = tmp_path / f"{solid}.ply"
        mesh(*shape).write_ply(str(path))
        shape = {"type": "ply", "filename": str(path), "face_normals": True}
    n = 5_000 if solid == "torus" else 40_000
    record = measured(
        shape,
        theta_i,
        both_sided(PERFECT if mirror else WHITE),
        phi_i=phi_i,
        footprint=None,
        estimator="analog",
    )
    counts, met = record.counts.ravel(), record.counts.sum()

    def compared(theta):
        wi = direction(np.radians(theta), np.radians(phi_i))
        d = solids.outgoing(hits, wi, radius, n, mirror)
        expected = arrived(0 * d, d, 1.0, (4, 6))
        share = (counts + expected) / (met + len(d))
        some = share * min(met, len(d)) > 30
        z = counts / met - expected / len(d)
        return verdict(
            z[some] / np.sqrt(share * (1 - share) * (1 / met + 1 / len(d)))[some]
        )

    agree(compared(theta_i))
    disagree(compared(theta_i - 10))


@pytest.mark.parametrize(
    ("place", "normal", "radius", "settings"),
    [
        ((0, 0, 2), (0, 0, -1), 0.7, {}),
        ((2.5, 0.5, 1.8), (-1, -0.2, -0.7), 0.5, {"estimator": "analog"}),
        ((1.5, -1, 1.6), None, 0, {}),
    ],
    ids=["a disk above", "a disk beside", "a point"],
)
def test_a_mirror_ball_under_a_near_emitter(place, normal, radius, settings):
    """Against rays in NumPy from the emitter. Twin: 6 % more."""
    emitter = {"type": "point", "position": list(place)}
    if radius:
        towards = mi.ScalarTransform4f().look_at(
            place, np.add(place, normal), [0, 1, 0]
        )
        emitter = {"type": "disk", "to_world": towards.scale(radius)}
        emitter["emitter"] = {"type": "area"}
    record = measured(
        {"type": "sphere"},
        None,
        PERFECT,
        emitter=emitter,
        footprint=None,
        rays=2**16,
        **settings,
    )
    o, d, weight = solids.from_disk(place, normal, radius, 1.0, 100_000)
    t, n = solids.ellipsoid(1, 1, 1)(o, d)
    weight *= np.isfinite(t) & (d[:, 2] < 0)
    up = (d - 2 * (d * n).sum(1)[:, None] * n)[:, 2] > 0
    share = weight @ up / weight.sum()
    std_err = np.sqrt(weight**2 @ (up - share) ** 2) / weight.sum()

    def compared(expected):
        off = record.dhr[0] - expected
        return single(off / np.hypot(std_err, record.dhr_std_err[0]))

    agree(compared(share))
    disagree(compared(1.06 * share))


@pytest.mark.parametrize(
    ("shape", "period", "outlined"),
    [
        (heightfield, "none", False),
        (lambda: plate(0), "none", False),
        (lambda: plate(17), "none", False),
        (lambda: {"type": "disk"}, "none", False),
        (lambda: {"type": "cube"}, "box", False),
        (lambda: {"type": "cube"}, "none", True),
        (lambda: {"type": "disk", "to_world": plate(30)["to_world"]}, "none", True),
    ],
)
def test_what_is_lit_over_its_outline(shape, period, outlined):
    """Sheets, cells and what has no height keep the top of their box."""
    emitter = mi.load_dict({"type": "directional", "direction": [-1, 0, -1]})
    beam = Beam(specimen_of(shape(), period), emitter, "full", "radiometric")
    assert (beam.outline is not None) == outlined


MIRROR = both_sided(
    {"type": "conductor", "material": "none", "specular_reflectance": 0.75}
)


def plate(tilt):
    to_world = mi.ScalarTransform4f().rotate([0, 1, 0], tilt)
    return {"type": "rectangle", "to_world": to_world}


@pytest.mark.parametrize(
    ("tilt", "theta_i", "phi_i", "side", "theta_o", "estimator"),
    [
        (17, 37, 180, "front", 71, "weighted"),
        (17, 37, 0, "back", 71, "weighted"),
        (44, 0, 0, "front", 88, "weighted"),
        (60, 0, 0, "front", 120, "weighted"),
        (60, 0, 0, "front", 120, "next_event"),
    ],
)
def test_tilted_mirrors_reflect_all_in_one_direction(
    tilt, theta_i, phi_i, side, theta_o, estimator
):
    """Rounding: three quarters of the light, in the patch of twice the angle."""
    settings = {"phi_i": phi_i, "side": side, "estimator": estimator}
    record = measured(
        plate(tilt), theta_i, MIRROR, footprint=0.2, rays=1000, **settings
    )
    below = theta_o > 90
    totals = record.dhr, record.dht
    assert abs(totals[below] - 0.75) < 2.0**-22
    assert totals[not below] == 0
    azimuth = 0.0 if side == "front" else np.pi
    up = direction(np.radians(min(theta_o, 180 - theta_o)), azimuth)
    number = record.subdivision.patch(up)
    assert np.flatnonzero(record.counts[int(below)]).tolist() == [number]


def test_a_ball_of_white_fog_loses_nothing():
    """Rounding: all leaves, above or below; in closed form: what goes straight on.

    Twin: the latter of a denser ball.
    """
    fog = {"type": "sphere", "interior": medium(1.0, 1.0)}
    settings = {"footprint": 2.2, "bsdf": NULL, "rays": 2**17}
    record = measured(fog, **settings)
    ledger = record.ledger
    assert ledger.reflected + ledger.transmitted == ledger.emitted - ledger.missed
    assert abs(record.dhr + record.dht - 1) < 1e-6  # a few thousand events
    straight = measured(fog, **settings, order=0)
    assert straight.ledger.over_the_edge > 0

    def passed(depth):
        """Mean of exp(-depth c) over chords of a ball, c by the longest."""
        return 2 / depth**2 * (1 - (1 + depth) * np.exp(-depth))

    agree(of_total(straight, passed(2.0), "dht"))
    disagree(of_total(straight, passed(2.2), "dht"))


@pytest.mark.needs("analysis")
def test_exit_profile_of_a_white_block():
    """Rounding: rings and what is beyond add up to all light, by sides too."""
    block = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -0.5]).scale([1, 1, 0.5]),
        "bsdf": NULL,
        "interior": medium(4.0, 1.0),
    }
    radii = np.array([0.0, 0.5, 2.0])
    found = gonio.exit_profile(block, radii, rays=5000)
    per_area = found.reflectance + found.transmittance
    rings = per_area[:, 0] @ (np.pi * np.diff(radii**2))
    assert abs(rings - 1) < 1e-5
    assert not found.beyond.any()
    assert found.ledger.over_the_edge > 0


def gutter():
    """A ridge of two planes, open below and at its ends."""
    turn = mi.ScalarTransform4f().rotate
    halves = {
        f"half{sign}": {
            "type": "rectangle",
            "to_world": turn([0, 1, 0], 45 * sign).translate([sign, 0, 0]),
        }
        for sign in (1, -1)
    }
    return {"type": "scene"} | halves


def pane():
    """Two faces of a glass plate, without the walls between them."""
    glass = {"type": "rectangle", "bsdf": {"type": "dielectric"}}
    end = mi.ScalarTransform4f().translate([0, 0, -1]).rotate([1, 0, 0], 180)
    return {"top": glass, "end": glass | {"to_world": end}}


@pytest.mark.parametrize(
    ("shapes", "period", "edges"),
    [
        (lambda: {"type": "sphere"}, "none", "closed"),
        (lambda: {"type": "cube"}, "none", "closed"),
        (lambda: BODIES["cylinder"][0], "none", "closed"),
        (lambda: BODIES["cylinder"][0] | {"flip_normals": True}, "none", "closed"),
        (gutter, "none", "open"),
        (lambda: {"type": "disk", "to_world": plate(30)["to_world"]}, "none", "closed"),
        (lambda: plate(17), "none", "open"),
        (heightfield, "none", "open"),
        (heightfield, "box", None),
        (pane, "none", "open"),
        (lambda: {"type": "rectangle"}, "none", None),
    ],
)
def test_what_may_stand_for_a_larger_surface(shapes, period, edges):
    """An open surface over all of its box; no solid, no lone leaf, and no cell."""
    assert specimen_of(shapes(), period).edges == edges


@pytest.mark.filterwarnings("ignore:.* rays left over the edge")
def test_a_warning_where_light_leaves_over_edges_that_may_be_none():
    """Twin: not where there is nothing but a ball."""
    said = [
        [one for one in summarize(record).warnings if "over the edge" in one]
        for record in (
            measured(heightfield(), 60, footprint="full", bsdf=GREY, rays=2000),
            measured({"type": "sphere"}, rays=2000),
        )
    ]
    assert [len(one) for one in said] == [1, 0]
    assert "give a period (--period box)" in said[0][0]
