"""Lobes between azimuths: a surface of known micro-normals, lit from all around."""

import numpy as np
import pytest
import synthetic
from sampled_material import check_samples
from synthetic import facet_lobes, facets_through

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.materials.interpolation.half_vectors import predicted_lobes, redirected
from gonio_mi.materials.interpolation.incident_grid import IncidentGrid

# Of the sums of some ten numbers of double precision.
DOUBLE = 1e-14

EVERY_30 = tuple(range(0, 360, 30))


def unit_vectors(generator, n):
    """Columns, above the horizon."""
    theta, phi = generator.uniform(0, 1.2, n), generator.uniform(0, 6, n)
    return np.moveaxis(direction(theta, phi), -1, 0)


def law(normal, wi, eta):
    """Reflection, or refraction by the angles of Snell's law; where light goes to."""
    cosine = np.sum(normal * wi, axis=0)
    if eta is None:
        return 2 * cosine * normal - wi
    along = (wi - cosine * normal) / np.sqrt(1 - cosine**2)
    theta_t = np.arcsin(np.sqrt(1 - cosine**2) / eta)
    return -np.sin(theta_t) * along - np.cos(theta_t) * normal


@pytest.mark.parametrize("eta", [None, 1.5, 1 / 1.5])
def test_a_micro_normal_sends_light_as_the_law_says(eta):
    """Directions by their angles, and the solid angle by differences."""
    generator = np.random.default_rng(0)
    before, after, normal = (unit_vectors(generator, 400) for _ in range(3))
    cosines = np.sum(normal * [before, after], axis=1)
    least = 0 if eta is None or eta > 1 else np.sqrt(1 - eta**2)
    keep = np.all(cosines > least + 0.01, axis=0) & np.all(cosines < 0.999, axis=0)
    before, after, normal = (one[:, keep] for one in (before, after, normal))
    depth = np.array([[1], [1], [1 if eta is None else -1]])
    wo = depth * law(normal, before, eta)
    to, scale, valid = redirected(wo, before, after, eta, np)
    assert keep.sum() > 50
    assert np.all(valid[wo[2] > 0])
    # the formula divides by the length of the half vector, above 0.2 of the unit
    assert np.allclose(to, depth * law(normal, after, eta), rtol=0, atol=5 * DOUBLE)
    # two small steps across wo span a solid angle
    across = np.cross(wo, before, axis=0)
    across /= np.linalg.norm(across, axis=0)
    step, spans = 1e-5, []
    for axis in (across, np.cross(wo, across, axis=0)):
        ends = []
        for sign in (1, -1):
            moved = wo + sign * step * axis
            moved /= np.linalg.norm(moved, axis=0)
            ends.append(np.array(redirected(moved, before, after, eta, np)[0]))
        spans.append((ends[0] - ends[1]) / (2 * step))
    area = np.linalg.norm(np.cross(*spans, axis=0), axis=0)
    # central differences: of the second order in the step, and rounding over it
    assert np.allclose(area, np.abs(scale), rtol=1e-6, atol=0)


def test_what_no_normal_refracts_stays():
    """Beyond the critical angle on either side; all that is returned is finite."""
    generator = np.random.default_rng(1)
    wo, before, after = (unit_vectors(generator, 1000) for _ in range(3))
    for eta in (1.5, 1 / 1.5):
        to, scale, valid = redirected(wo, before, after, eta, np)
        half = before + eta * wo * [[1], [1], [-1]]
        impossible = (1 + eta * np.sum(before * wo * [[1], [1], [-1]], axis=0)) > 0
        assert impossible.any() if eta > 1 else True
        assert not np.any(valid & impossible & (eta > 1))
        assert np.isfinite([*to, scale, *half]).all()
        assert 0 < valid.mean() < 1


@pytest.mark.parametrize("eta", [None, 1.5])
def test_a_lobe_is_predicted_up_to_its_patches(eta):
    """What finer patches leave of the error; twin: turned, it is as wrong as ever."""
    errors = []
    how = {} if eta is None else {"of": facets_through, "eta": eta}
    how["widths"] = (0.1, 0.2) if eta is None else (0.3, 0.6)
    for size in ("projected:12x36", "projected:24x72", "projected:48x144"):
        patches = gonio.subdivision(size)
        first, second = facet_lobes(patches, [(15, 0), (15, 20)], **how)[..., None]
        found = predicted_lobes(first, patches, 15.0, (0.0, 20.0), eta)
        assert np.allclose([one.sum() for one in found], 0.5, rtol=DOUBLE, atol=0)
        errors.append([np.abs(one - second).sum() for one in found])
    turned, moved = np.transpose(errors)
    # of the second order in the width of patches: a fourth, but for steps at edges
    assert np.all(moved[1:] < moved[:-1] / 2)
    assert np.all(turned[1:] > turned[:-1] / 2)
    assert moved[-1] < turned[-1] / 2


def record_of(patches, incidents, *hemispheres):
    """Record without noise."""
    theta_i, phi_i = np.transpose(incidents)
    weights = np.stack(hemispheres, axis=1)
    return synthetic.exact(weights, theta_i, str(patches), phi_i)


def test_records_say_how_their_lobes_move():
    """Brushed ones by micro-normals; those that turn with incidence do not.

    By which index light was refracted, a record knows but roughly.
    """
    patches = gonio.subdivision("projected:24x36")
    incidents = [(25, phi) for phi in EVERY_30]
    for widths, kept in (((0.1, 0.25), True), ((0.2, 0.2), False)):
        upper = facet_lobes(patches, incidents, widths)
        wide = 3 * np.array(widths)
        for eta in (1.5, 1 / 1.5):
            lower = facet_lobes(patches, incidents, wide, of=facets_through, eta=eta)
            record = record_of(patches, incidents, upper / 2, lower / 2)
            grid = IncidentGrid.of(record, record.flux_fraction)
            assert grid.reflects == kept
            assert (grid.eta is not None) == kept
            if kept:
                assert (grid.eta > 1) == (eta > 1)


def mixed(lobes, gap):
    """Every 30 degrees: lobes of neighbours a gap apart, that turn with incidence."""
    steps = gap // 30
    found = lobes.copy()
    for number in set(range(12)) - set(range(0, 12, steps)):
        past = number % steps
        ends = number - past, (number + steps - past) % 12
        low, high = (np.roll(lobes[end], 3 * (number - end), 1) for end in ends)
        found[number] = ((steps - past) * low + past * high) / steps
    return found


@pytest.mark.parametrize("eta", [None, 1.5])
def test_what_was_not_measured_is_filled_in(eta):
    """As lobes are looked up; twin: by lobes that turn, it is wrong twice as much."""
    patches = gonio.subdivision("projected:24x36")
    both = [(theta, phi) for theta in (50, 70) for phi in EVERY_30]
    lobes = facet_lobes(patches, both, (0.1, 0.25)) / 2
    if eta is not None:
        how = {"of": facets_through, "eta": eta}
        lower = facet_lobes(patches, both, (0.3, 0.6), **how) / 2
    every = [lobes] if eta is None else [lobes, lower]
    for gap in (90, 60):
        some = [*range(0, 12, gap // 30), *range(12, 24)]
        incidents = [both[n] for n in some]
        record = record_of(patches, incidents, *(one[some] for one in every))
        grid = IncidentGrid.of(record, record.flux_fraction)
        filled = grid.filled(record.flux_fraction)[:, 0, -1, ..., 0]
        truth = every[-1][:12]
        own, turned = (
            np.abs(one - truth).sum(axis=(1, 2)).max()
            for one in (filled, mixed(truth, gap))
        )
        assert own < turned / 2


@pytest.mark.parametrize("theta_i", [40, 75])
def test_samples_follow_the_values(theta_i, tmp_path):
    """Also where light stays above the horizon; twin: of another azimuth."""
    patches = gonio.subdivision("projected:24x36")
    incidents = [(theta_i, phi) for phi in EVERY_30]
    upper = facet_lobes(patches, incidents, (0.15, 0.4)) / 2
    how = {"of": facets_through, "eta": 1.5}
    lower = facet_lobes(patches, incidents, (0.3, 0.6), **how) / 2
    record = record_of(patches, incidents, upper, lower)
    assert IncidentGrid.of(record, record.flux_fraction).eta is not None
    check_samples(record, theta_i, 14, tmp_path)
