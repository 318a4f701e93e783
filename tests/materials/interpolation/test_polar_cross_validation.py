"""Lobes between polar angles: by micro-normals where the records say so."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import agree, count_verdict, disagree
from synthetic import facet_lobes, facets_through

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.materials.interpolation.incident_grid import tried_indices
from gonio_mi.materials.interpolation.interpolated_bsdf import (
    InterpolatedBSDF,
    half_vector_segments,
)
from gonio_mi.materials.interpolation.interpolated_lobes import HalfVectorSegments
from gonio_mi.materials.interpolation.lobes import MeasuredLobes
from gonio_mi.materials.prediction import Prediction
from gonio_mi.results.prediction_error import prediction_error

ANGLES = (0, 20, 40, 60)

# What double precision leaves of values that are found by one formula on two ways.
DOUBLE = 1e-13


def record_of(patches, angles, *hemispheres):
    """Record without noise, of one azimuth."""
    return synthetic.exact(np.stack(hemispheres, axis=1), angles, str(patches))


def facets_both(patches, angles, eta=1.5):
    """Half of the light reflected and half refracted by the same facets, about."""
    incidents = [(theta, 0) for theta in angles]
    upper = facet_lobes(patches, incidents, (0.1, 0.1))
    how = {"of": facets_through, "eta": eta}
    lower = facet_lobes(patches, incidents, (0.15, 0.15), **how)
    return upper / 2, lower / 2


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_records_say_how_their_lobes_move(eta):
    """Those of facets by micro-normals; what stays where it is by quantiles."""
    patches = gonio.subdivision("projected:24x48")
    # from inside, below where most facets reflect all light
    angles = ANGLES if eta > 1 else (0, 10, 20, 30)
    upper, lower = facets_both(patches, angles, eta)
    fixed = np.stack([synthetic.specular(patches, 20, 90, 20)] * len(angles)) / 4
    for reflected, transmitted, moving in (
        (upper, lower, [0, 1]),
        (upper, fixed, [0]),
        (fixed, lower, [1]),
        (fixed, fixed, []),
    ):
        record = record_of(patches, angles, reflected, transmitted)
        ways = half_vector_segments(MeasuredLobes(record))
        assert [way.hemisphere for way in ways if all(way.segments)] == moving
        if 1 in moving:
            assert (ways[-1].eta > 1) == (eta > 1)


def test_each_segment_moves_as_the_nearest_records_say():
    """Lobes that are fixed up to 40 degrees, and of facets beyond."""
    patches = gonio.subdivision("projected:24x48")
    angles = (0, 10, 20, 30, 40, 50, 60, 70)
    upper, _ = facets_both(patches, angles)
    upper[:5] = synthetic.specular(patches, 20, 90, 20) / 4
    record = record_of(patches, angles, upper)
    ((way,),) = [half_vector_segments(MeasuredLobes(record))]
    # the record at 40 degrees is between two that have nothing in common
    assert way.segments[:3] == (False,) * 3
    assert way.segments[5:] == (True,) * 2


@pytest.mark.parametrize("theta_i", [10, 30])
def test_diffuse_light_is_as_bright_at_the_horizon_as_elsewhere(theta_i):
    """Beneath lobes of facets; twin: not so where it moves with their micro-normals."""
    patches = gonio.subdivision("projected:24x48")
    facets, _ = facets_both(patches, ANGLES)
    even = patches.projected_solid_angles / patches.projected_solid_angles.sum() / 4
    lobes = MeasuredLobes(record_of(patches, ANGLES, facets + even))
    table, own = lobes.whole(), half_vector_segments(lobes)
    every = HalfVectorSegments(0, None, (True,) * 3)
    theta, phi = np.meshgrid(
        np.radians([83, 85, 87]), np.radians(np.arange(60, 301, 5))
    )
    wi, wo = direction(np.radians(theta_i), 0.0), direction(theta, phi).reshape(-1, 3)
    wi, wo = mi.Vector3f(wi.tolist()), mi.Vector3f(wo.T.astype(np.float32))
    # only the even light, of which the facets' is no part there, is looked at
    errors = [
        np.abs(face.values(wi, wo)[0][0].numpy() * 4 * np.pi - 1).mean()
        for face in (
            InterpolatedBSDF(table, half_vectors=ways) for ways in (own, [every], [])
        )
    ]
    assert errors[0] <= errors[2] < errors[1] / 2


def test_too_few_angles_say_nothing():
    """Of two no one is between others; twin: anisotropic ones predict each other."""
    patches = gonio.subdivision("projected:24x48")
    record = record_of(patches, ANGLES[:2], *facets_both(patches, ANGLES[:2]))
    assert not half_vector_segments(MeasuredLobes(record))
    incidents = [(theta, phi) for theta in (20, 40) for phi in (0, 90, 180, 270)]
    theta_i, phi_i = np.transpose(incidents)
    lobes = facet_lobes(patches, incidents, (0.1, 0.2))[:, None] / 2
    record = synthetic.exact(lobes, theta_i, str(patches), phi_i)
    (way,) = half_vector_segments(MeasuredLobes(record))
    assert way.segments == (True,)


def test_light_of_the_normal_alone_says_no_index():
    """It has a mean direction, by noise or an uneven lobe, but nothing bent it."""
    patches = gonio.subdivision("projected:6x8")
    light = np.zeros((2, *patches.shape))
    theta_i = np.array([0.0, 30.0])
    for number, some in ((0, False), (1, True)):
        light[number, 0, 4] = 0.1
        assert bool(tried_indices(light, theta_i, 0 * theta_i, patches)) == some


@pytest.mark.parametrize("theta_i", [10, 50])
def test_narrow_lobes_are_predicted_by_micro_normals(theta_i):
    """Up to what patches leave, of the second order; twin: not so by quantiles."""
    errors = []
    for size in ("projected:16x40", "projected:32x80"):
        patches = gonio.subdivision(size)
        incidents = [(theta, 0) for theta in (*ANGLES, theta_i)]
        *known, truth = facet_lobes(patches, incidents, (0.1, 0.1))
        record = record_of(patches, ANGLES, np.array(known))
        own = Prediction(record, 8)
        quantiles = Prediction(record, 8)
        quantiles.half_vectors = []
        true = record_of(patches, (theta_i,), truth[None])
        errors.append(
            [
                prediction_error(true, one.flux(theta_i, 0)).total_variation
                for one in (own, quantiles)
            ]
        )
    coarse, fine = np.array(errors)
    assert fine[0] < coarse[0] / 2
    assert fine[1] > coarse[1] / 2
    assert fine[0] < fine[1] / 2


def test_predictions_need_only_what_lies_around():
    """Of azimuths that differ by polar angle, past the last one and beyond the grid.

    Twin: not what lies around another direction.
    """
    patches = gonio.subdivision("projected:8x16")
    azimuths = {10: (0, 90, 180, 270), 30: range(0, 360, 45), 70: (0, 90, 180, 292.5)}
    incidents = [(theta, phi) for theta, some in azimuths.items() for phi in some]
    incidents = [(0, 0), *incidents]
    theta_i, phi_i = np.transpose(incidents)
    lobes = facet_lobes(patches, incidents, (0.2, 0.4))
    weights = np.stack([lobes, lobes[::-1]], axis=1) / 2
    record = synthetic.exact(weights, theta_i, str(patches), phi_i)
    around, whole, elsewhere = (Prediction(record, 4) for _ in range(3))
    table = InterpolatedBSDF(whole.lobes.whole(), half_vectors=whole.half_vectors)
    whole.face = lambda *_: table
    elsewhere.local_bsdf = lambda *_: around.local_bsdf(50, 140)
    assert any(any(way.segments) for way in around.half_vectors)
    for one in ((5, 30), (29, 359), (50, 100), (70, 300), (80, 20), (0, 0)):
        truth = whole.flux(*one)
        assert np.allclose(around.flux(*one), truth, rtol=DOUBLE, atol=0)
        assert np.abs(elsewhere.flux(*one) - truth).sum() > 0.1 * truth.sum()


def shares(face, wi, patches):
    """Density times area of both hemispheres' patches, by points."""
    points = patches.points(48).reshape(-1, 3)
    found = []
    for up in (1, -1):
        wo = mi.Vector3f(np.ascontiguousarray((points * [1, 1, up]).T, np.float32))
        _, pdf = face.eval_pdf(wi, wo, (True, True), mi.Bool(True), mi.Spectrum(0))
        density = (pdf.numpy() / points[:, 2]).reshape(patches.n_patches, -1)
        found += [density.mean(axis=1) * patches.projected_solid_angles.ravel()]
    return np.concatenate(found)


@pytest.mark.parametrize(("reflects", "eta"), [(True, None), (False, 1.5)])
def test_samples_follow_values_where_lanes_move_in_different_ways(reflects, eta):
    """On each segment, in each hemisphere, between azimuths.

    Twins: lit from elsewhere, and where lobes are reflected, staying.
    """
    patches, coarse = (
        gonio.subdivision("projected:12x24"),
        gonio.subdivision("projected:6x8"),
    )
    incidents = [(theta, phi) for theta in ANGLES for phi in range(0, 360, 60)]
    upper = facet_lobes(patches, incidents, (0.1, 0.2))
    how = {"of": facets_through, "eta": 1.5}
    lower = facet_lobes(patches, incidents, (0.2, 0.4), **how)
    theta_i, phi_i = np.transpose(incidents)
    weights = np.stack([upper / 2, lower / 2], axis=1)
    record = synthetic.exact(weights, theta_i, str(patches), phi_i)
    table = MeasuredLobes(record).whole()
    table = replace(table, grid=replace(table.grid, reflects=reflects, eta=eta))
    ways = (
        HalfVectorSegments(0, None, (False, True, False)),
        HalfVectorSegments(1, 1.5, (True, False, True)),
    )
    face = InterpolatedBSDF(table, half_vectors=ways)
    lights = direction(*np.radians([[30, 50, 75], [14, 200, 355]]))
    rays, generator = 2**16, np.random.default_rng(1)
    wi = mi.Vector3f(np.repeat(lights, rays, axis=0).T.astype(np.float32))
    numbers = generator.random((3, 3 * rays), np.float32)
    samples = mi.Float(numbers[0]), mi.Point2f(numbers[1:])
    wo = face.sample(wi, (True, True), *samples).numpy().T
    below = wo[:, 2] < 0
    patch = coarse.patch(wo * np.where(below, [[1], [1], [-1]], 1).T)
    patch += coarse.n_patches * below
    counts = [
        np.bincount(own, minlength=2 * coarse.n_patches) for own in patch.reshape(3, -1)
    ]
    lit = [mi.Vector3f(light.tolist()) for light in lights]
    dr.make_opaque(lit)
    expected = [shares(face, one, coarse) for one in lit]
    agree(count_verdict(counts, expected))
    disagree(count_verdict(counts, expected[1:] + expected[:1]))
    if reflects:
        face = InterpolatedBSDF(table)
        disagree(count_verdict(counts, [shares(face, one, coarse) for one in lit]))
