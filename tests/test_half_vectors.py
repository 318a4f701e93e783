"""Lobes between azimuths: a surface of known micro-normals, lit from all around."""

import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import agree, disagree, scores, verdict
from synthetic import facet_lobes

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.materials.half_vectors import predicted, reflected
from gonio_mi.materials.incident_grid import IncidentGrid

# Of the sums of some ten numbers of double precision.
DOUBLE = 1e-14

EVERY_30 = tuple(range(0, 360, 30))


def test_a_micro_normal_reflects_as_the_law_says():
    """Twice along the normal less what comes; the solid angle by differences."""
    generator = np.random.default_rng(0)
    theta, phi = generator.uniform(0, 1.2, (3, 50)), generator.uniform(0, 6, (3, 50))
    wo, before, after = np.moveaxis(direction(theta, phi), -1, 1)
    to, scale = reflected(wo, before, after)
    normal = (wo + before) / np.linalg.norm(wo + before, axis=0)
    law = 2 * np.sum(normal * after, axis=0) * normal - after
    assert np.allclose(to, law, rtol=0, atol=DOUBLE)
    # two small steps across wo span a solid angle
    across = np.cross(wo, before, axis=0)
    across /= np.linalg.norm(across, axis=0)
    step, spans = 1e-5, []
    for axis in (across, np.cross(wo, across, axis=0)):
        ends = []
        for sign in (1, -1):
            moved = wo + sign * step * axis
            moved /= np.linalg.norm(moved, axis=0)
            ends.append(np.array(reflected(moved, before, after)[0]))
        spans.append((ends[0] - ends[1]) / (2 * step))
    area = np.linalg.norm(np.cross(*spans, axis=0), axis=0)
    # central differences: of the second order in the step, and rounding over it
    assert np.allclose(area, np.abs(scale), rtol=1e-7, atol=0)


def test_a_lobe_is_predicted_up_to_its_patches():
    """What finer patches leave of the error; twin: turned, it is as wrong as ever."""
    errors = []
    for size in ("projected:12x36", "projected:24x72", "projected:48x144"):
        patches = gonio.subdivision(size)
        first, second = facet_lobes(patches, [(15, 0), (15, 20)])[..., None]
        found = predicted(first, patches, 15.0, (0.0, 20.0))
        assert np.allclose([one.sum() for one in found], 0.5, rtol=DOUBLE, atol=0)
        errors.append([np.abs(one - second).sum() for one in found])
    turned, moved = np.transpose(errors)
    # of the second order in the width of patches: a fourth, but for steps at edges
    assert np.all(moved[1:] < moved[:-1] / 2)
    assert moved[-1] < 0.01
    assert np.all(turned > 0.1)


def record_of(patches, incidents, weights):
    """Record without noise."""
    theta_i, phi_i = np.transpose(incidents)
    return synthetic.exact(weights[:, None], theta_i, str(patches), phi_i)


def test_records_say_how_their_lobes_move():
    """Brushed ones by micro-normals; those that turn with incidence do not."""
    patches = gonio.subdivision("projected:24x36")
    incidents = [(50, phi) for phi in EVERY_30]
    for widths, reflects in (((0.1, 0.25), True), ((0.2, 0.2), False)):
        weights = facet_lobes(patches, incidents, widths)
        record = record_of(patches, incidents, weights)
        grid = IncidentGrid.of(record, record.flux_fraction)
        assert grid.reflects == reflects
        # and so does what was not measured
        some = [n for n in range(12) if n % 3 == 0] + list(range(12, 24))
        both = [(50, phi) for phi in EVERY_30] + [(70, phi) for phi in EVERY_30]
        weights = facet_lobes(patches, both, widths)
        record = record_of(patches, [both[n] for n in some], weights[some])
        grid = IncidentGrid.of(record, record.flux_fraction)
        assert grid.reflects == reflects
        filled = grid.filled(record.flux_fraction)[:, 0, 0, ..., 0]
        # gaps of 90 degrees: what is left is far below that of a lobe that turns
        assert np.abs(filled - weights[:12]).sum(axis=(1, 2)).max() < 0.1


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("theta_i", [40, 75])
def test_samples_follow_the_values(theta_i, tmp_path):
    """Also where light stays above the horizon; twin: of another azimuth."""
    patches = gonio.subdivision("projected:24x36")
    incidents = [(theta_i, phi) for phi in EVERY_30]
    weights = facet_lobes(patches, incidents, (0.15, 0.4))
    record = record_of(patches, incidents, weights)
    record.save(tmp_path / "brushed.npz")
    plugin = {"type": "goniometric", "filename": str(tmp_path / "brushed.npz")}
    coarse = gonio.subdivision("projected:6x8")
    how = {"collector": coarse, "rays": 2**17, "sampler": "independent"}
    seen = gonio.measure(plugin, theta_i, 10, **how)
    # all light of the neighbours is kept
    assert abs(seen.dhr[0] - 0.5) <= 2.0**-20
    bsdf = mi.load_dict(plugin)
    means = []
    for phi_i in (10, 14):
        wo = coarse.points(96).reshape(-1, 3)
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(direction(*np.radians([theta_i, phi_i])).tolist())
        context = mi.BSDFContext(mi.TransportMode.Importance)
        value = bsdf.eval(context, si, mi.Vector3f(*wo.T.tolist())).numpy()[0]
        means.append((value / wo[:, 2]).reshape(*coarse.shape, -1).mean(axis=-1))
    right, wrong = (one * coarse.projected_solid_angles for one in means)
    assert abs(right.sum() - 0.5) < 1e-3  # what points leave of it
    agree(verdict(scores(seen, right)))
    disagree(verdict(scores(seen, wrong)))
