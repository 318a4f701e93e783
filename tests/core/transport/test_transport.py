"""The cheap path and the full path agree; emitters and collectors of finite size."""

import functools
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from budget import (
    Verdict,
    agree,
    difference_scores,
    disagree,
    normal_scores,
    scores,
    single,
    verdict,
)
from scipy import stats

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.transport.specimen import Specimen

pytestmark = pytest.mark.usefixtures("mono")

COLLECTOR = "projected:12x24"
RAYS = 10**6

REFLECTING = {"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.5}
TRANSMITTING = {"type": "roughdielectric", "alpha": 0.4, "int_ior": 1.5}


def transform():
    return mi.ScalarTransform4f()


def emitter(radius=2.0, distance=5.0):
    """Disk above the specimen that faces it."""
    look = transform().look_at(origin=[0, 0, distance], target=[0, 0, 0], up=[0, 1, 0])
    return {
        "type": "disk",
        "to_world": look @ transform().scale(radius),
        "emitter": {"type": "area", "radiance": 1.0},
    }


def both(specimen, theta_i, **settings):
    """Records of the plane and of the traced transport, of different seeds."""
    settings = {
        "rays": RAYS,
        "collector": COLLECTOR,
        "sampler": "independent",
        "phi_i": 40.0,
    } | settings
    plane = gonio.measure(specimen, theta_i, **settings)
    traced = gonio.measure(specimen, theta_i, trace=True, seed=1, **settings)
    assert plane.settings["transport"] == "plane"
    assert traced.settings["transport"] == "traced"
    return plane, traced


def check(plane, traced):
    """Agreement of both hemispheres and totals, and the twin's failure."""
    hemispheres = range(1 + plane.has_lower)
    for hemisphere in hemispheres:
        z = difference_scores(plane, traced, hemisphere)
        if z.size:
            agree(verdict(z))
    turned = difference_scores(
        plane, turned_map(traced, 1), int(plane.dhr[0] < 0.5 and plane.has_lower)
    )
    disagree(verdict(turned))


def turned_map(record, sectors):
    """The record with its map turned by some sectors."""
    (tally,) = record.tallies
    rolled = replace(
        tally,
        hits=np.roll(tally.hits, sectors, axis=2),
        sums=np.roll(tally.sums, sectors, axis=3),
    )
    return replace(record, tallies=(rolled,))


@pytest.mark.parametrize("footprint", ["full", "point", 0.4])
@pytest.mark.parametrize("theta_i", [50, 85])
def test_reflecting(theta_i, footprint):
    check(*both(REFLECTING, theta_i, footprint=footprint))


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("footprint", ["full", "point", 0.4])
def test_transmitting(side, footprint):
    check(*both(TRANSMITTING, 40, side=side, footprint=footprint))


@pytest.mark.parametrize("emission", ["radiometric", "equal_power"])
@pytest.mark.parametrize(
    "specimen", [REFLECTING, TRANSMITTING], ids=lambda s: s["type"]
)
def test_emitter(specimen, emission):
    check(*both(specimen, 30, emitter=emitter(), emission=emission))


def test_rotated_rectangle():
    """The local frame turns with the shape, and the lobe of brushed metal with it."""
    specimen = {
        "type": "rectangle",
        "to_world": transform().rotate([0, 0, 1], 60).scale([2, 0.5, 1]),
        "bsdf": REFLECTING,
    }
    plane, traced = both(specimen, 50)
    check(plane, traced)
    # and as much as turning light and map the other way
    unturned = gonio.measure(
        REFLECTING,
        50,
        -20.0,
        rays=RAYS,
        collector=COLLECTOR,
        sampler="independent",
        seed=2,
    )
    agree(verdict(difference_scores(plane, turned_map(unturned, 4))))
    disagree(verdict(difference_scores(plane, unturned)))


def test_textured_rectangle():
    """A quarter of the plate is white, seen by where light lands."""
    pixels = np.zeros((2, 2, 1), np.float32)
    pixels[0, 0] = 1
    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(pixels),
        "raw": True,
        "filter_type": "nearest",
    }
    specimen = {
        "type": "rectangle",
        "to_world": transform().rotate([0, 0, 1], 30).translate([3, -2, 0]),
        "bsdf": {"type": "diffuse", "reflectance": texture},
    }
    for record in both(specimen, 20):
        n = record.ledger.emitted
        z = (record.ledger.reflected - n / 4) / np.sqrt(n * 3 / 16)
        agree(single(z))
        disagree(single(z + 0.02 * np.sqrt(n)))


# ------------------------------------------------------------------------ emitters


@functools.cache
def mirrored_emitter(theta_i, emission, runs, radius=2.0, distance=5.0, n=100_000):
    """Flux fractions of a mirror's patches by NumPy alone, in independent runs.

    Uniform points on emitter and plate; the radiometric weight is the product of both
    cosines over the square of the distance.
    """
    patches = gonio.subdivision("projected:8x12")
    t = np.radians(theta_i)
    turn = np.array([[np.cos(t), 0, np.sin(t)], [0, 1, 0], [-np.sin(t), 0, np.cos(t)]])
    shares = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        r, a = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
        q = np.stack([r * np.cos(a), r * np.sin(a), np.full(n, distance)], axis=1)
        d = q @ turn.T - np.c_[rng.uniform(-1, 1, (n, 2)), np.zeros(n)]
        length = np.linalg.norm(d, axis=1)
        wi = d / length[:, None]
        weight = np.ones(n)
        if emission == "radiometric":
            weight = wi[:, 2] * (wi @ turn[:, 2]) / length**2
        index = patches.patch(wi * [-1, -1, 1])
        shares.append(np.bincount(index, weight, patches.n_patches) / weight.sum())
    return np.array(shares)


@pytest.mark.parametrize("emission", ["radiometric", "equal_power"])
@pytest.mark.parametrize("trace", [False, True])
def test_mirror_shows_the_emitter(emission, trace):
    """The map of a mirror is the irradiance by direction, turned over the normal."""
    record = gonio.measure(
        {"type": "conductor"},
        30,
        emitter=emitter(),
        emission=emission,
        rays=RAYS,
        collector="projected:8x12",
        sampler="independent",
        trace=trace,
        batches=32,
    )
    agree(verdict(against_runs(record, mirrored_emitter(30, emission, 32))))
    other = {"radiometric": "equal_power", "equal_power": "radiometric"}[emission]
    disagree(verdict(against_runs(record, mirrored_emitter(30, other, 32))))


def against_runs(record, runs):
    """Scores against independent runs of as many as the record's batches."""
    (tally,) = record.tallies
    assert len(runs) == tally.n_batches
    use = (record.counts[0].ravel() > 3000) & (runs > 0).all(axis=0)
    own = tally.sums[:, 0, :, :, 0].reshape(tally.n_batches, -1) / tally.incident
    own, runs = own[:, use], runs[:, use]
    a, b = (x.var(axis=0, ddof=1) / len(x) for x in (own, runs))
    # Welch's degrees of freedom
    dof = (a + b) ** 2 / (a**2 + b**2) * (len(own) - 1)
    return normal_scores((own.mean(axis=0) - runs.mean(axis=0)) / np.sqrt(a + b), dof)


@pytest.mark.parametrize("emission", ["radiometric", "equal_power"])
def test_lambertian_does_not_care_for_the_emitter(emission):
    record = gonio.measure(
        {"type": "diffuse", "reflectance": 0.5},
        30,
        emitter=emitter(),
        emission=emission,
        rays=RAYS,
        collector=COLLECTOR,
        sampler="independent",
    )
    # rounding: each ray is rounded to 2^-24 of the mean power, before and after
    rejected = record.ledger.rejected / RAYS
    assert abs(record.dhr[0] - 0.5) <= 0.5 * rejected * 10 + 2.0**-22
    share = record.subdivision.projected_solid_angles / np.pi
    agree(verdict(scores(record, 0.5 * share)))
    disagree(verdict(scores(record, 0.51 * share)))


def test_small_far_emitter_is_collimated():
    settings = {"rays": RAYS, "collector": COLLECTOR, "sampler": "independent"}
    far = gonio.measure(
        REFLECTING, 50, emitter=emitter(10.0, 10_000.0), seed=1, **settings
    )
    collimated = gonio.measure(REFLECTING, 50, **settings)
    agree(verdict(difference_scores(far, collimated)))
    near = gonio.measure(REFLECTING, 50, emitter=emitter(), seed=1, **settings)
    disagree(verdict(difference_scores(near, collimated)))


# ------------------------------------------------------------------------ collector


@pytest.mark.parametrize("trace", [False, True])
@pytest.mark.parametrize("radius", [2.0, 10.0])
def test_collector_of_finite_radius(radius, trace):
    """A mirror's exits meet the sphere where geometry says, computed by NumPy."""
    theta_i, rays = 40, RAYS // 4
    record = gonio.measure(
        {"type": "conductor"},
        theta_i,
        rays=rays,
        collector="projected:20x24",
        sampler="independent",
        collector_radius=radius,
        trace=trace,
    )
    patches = record.subdivision
    d = direction(np.radians(theta_i), np.pi)
    # the share of each patch: a fine grid of the plate, refined once for its own error
    shares = []
    for n in (1000, 2000):
        x = (np.arange(n) + 0.5) / n * 2 - 1
        p = np.stack([*np.meshgrid(x, x), np.zeros((n, n))], axis=-1).reshape(-1, 3)
        along = p @ d
        t = -along + np.sqrt(along**2 + radius**2 - (p**2).sum(axis=1))
        index = patches.patch((p + t[:, None] * d) / radius)
        shares.append(np.bincount(index, minlength=patches.n_patches) / n**2)
    fine = shares[1]
    std_err = np.sqrt(fine * (1 - fine) / rays)
    use = fine > 0.01
    error = np.abs(shares[1] - shares[0])[use]
    # which widens the spread below by at most a twentieth: hypot(1, 0.3)
    assert np.all(error < 0.3 * std_err[use])
    counts = record.counts[0].ravel()
    # the grid's own error is added, as large as its last change
    spread = np.hypot(std_err[use], error)
    z = (counts[use] / rays - fine[use]) / spread
    # several patches share all rays: only the worst of them is asked for (Bonferroni)
    agree(worst(z))
    far = np.bincount(patches.patch(d[None]), minlength=patches.n_patches)[use]
    disagree(worst((counts[use] / rays - far) / spread))


def worst(z):
    """Verdict on the largest of several scores."""
    return Verdict(
        {"worst": float(2 * stats.norm.sf(np.abs(z).max()) * z.size)}, z.size
    )


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("theta_i", [0, 60, 89, 89.99])
def test_a_traced_plane_loses_nothing(theta_i):
    """Exact: also where a ray lands within rounding of an edge, grazing."""
    record = gonio.measure({"type": "diffuse"}, theta_i, rays=2**20, trace=True)
    assert record.ledger.reflected == 2**20


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("loaded", [True, False])
def test_shapes_that_mitsuba_merges(loaded):
    """Exact: two white plates of one BSDF, which become a mesh without a box."""
    white = {"type": "diffuse", "reflectance": 1.0}
    aside = mi.ScalarTransform4f().translate([2, 0, 0])
    plates = {
        "type": "scene",
        "one": {"type": "rectangle", "bsdf": white},
        "other": {"type": "rectangle", "bsdf": white, "to_world": aside},
    }
    if loaded:
        plates = mi.load_dict(plates)
        assert not plates.bbox().valid()  # when this fails, Mitsuba has mended it
    record = gonio.measure(plates, 30, rays=10_000)
    assert record.ledger.reflected == 10_000


def ball(radius):
    """Scene of a mesh and a ball in front of it."""
    field = {"type": "heightfield", "alpha": 0.5, "resolution": 16}
    sphere = {"type": "sphere", "radius": radius, "center": [0, 0, 1]}
    return mi.load_dict({"type": "scene", "field": field, "sphere": sphere})


def tallies(scene):
    return gonio.measure(scene, 30, rays=10_000).tallies


def shrink(scene, parameter):
    """Shrink a shape by half, towards the origin."""
    parameters = mi.traverse(scene)
    value = parameters[parameter]
    if isinstance(value, mi.Float):
        parameters[parameter] = value * 0.5
    else:
        parameters[parameter] = mi.Transform4f().scale(0.5) @ value
    parameters.update()


def test_geometry_is_built_once():
    """Exact: a loaded scene that is measured again is not built again; same bits."""
    scene, other = ball(0.2), ball(0.2)
    built = Specimen(scene).scene
    assert Specimen(scene, "box").scene is built
    again = tallies(scene)
    assert Specimen(scene).scene is built
    assert Specimen(other).scene is not built
    assert tallies(other) == again


@pytest.mark.parametrize("parameter", ["field.vertex_positions", "sphere.to_world"])
def test_changed_geometry_is_seen(parameter):
    """Exact: after a change of a mesh or a ball, what a new scene gives; same bits."""
    scene = ball(0.2)
    before = tallies(scene)
    shrink(scene, parameter)
    after = tallies(scene)
    assert after != before
    other = ball(0.2)
    shrink(other, parameter)
    assert tallies(other) == after
