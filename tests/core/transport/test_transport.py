"""An emitter of finite size, and the geometry of a specimen."""

import functools

import mitsuba as mi
import numpy as np
import pytest
from budget import (
    agree,
    disagree,
    normal_scores,
    verdict,
)
from specimens import lamp

import gonio_mi as gonio
from gonio_mi.specimen.specimen import Specimen


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


@pytest.mark.parametrize(
    ("emission", "trace"), [("radiometric", True), ("equal_power", False)]
)
def test_mirror_shows_the_emitter(emission, trace):
    """The map of a mirror is the irradiance by direction, turned over the normal."""
    settings = {"rays": 10**6, "batches": 32, "collector": "projected:8x12"}
    settings |= {"emitter": lamp(), "emission": emission, "trace": trace}
    record = gonio.measure({"type": "conductor"}, 30, sampler="independent", **settings)
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


@pytest.mark.parametrize("theta_i", [0, 60, 89, 89.99])
def test_a_traced_plane_loses_nothing(theta_i):
    """Exact: also where a ray lands within rounding of an edge, grazing."""
    record = gonio.measure({"type": "diffuse"}, theta_i, rays=2**20, trace=True)
    assert record.ledger.reflected == 2**20


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


def test_a_specimen_is_frozen():
    """Also what is found only when it is asked for."""
    specimen = Specimen(ball(0.2))
    for name in ("period", "scene", "digest"):
        with pytest.raises(AttributeError, match=f"cannot set {name} of a specimen"):
            setattr(specimen, name, "box")
    assert specimen.period == "none"


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
