"""Where light leaves: distances from where it entered."""

from itertools import pairwise

import gonio_mi as gonio

# isort: split
import numpy as np
import pytest
from budget import agree, disagree, normal_scores, verdict
from slabs import medium, stack

RADII = [0.0, 0.1, 0.2, 0.4, 0.8, 1.6]


def profile(scene, **settings):
    settings = {"period": "box", "rays": 100_000, "sampler": "independent"} | settings
    return gonio.exit_profile(scene, RADII, **settings)


def single_scattering(low, high, sigma_t, albedo):
    """Flux that leaves a half space in a ring, once scattered, lit straight down.

    Of the depth z an attenuated part scatters; at the distance s from there the surface
    receives exp(-sigma_t s) z / (4 pi s^3) of it per area.
    """
    x, weights = np.polynomial.legendre.leggauss(200)
    r, r_w = (high - low) / 2 * x + (high + low) / 2, (high - low) / 2 * weights
    z = np.exp(5 * x)  # from 0.007 to 148, evenly in its logarithm
    z_w = 5 * weights * z
    s = np.hypot(r[:, None], z)
    per_area = np.exp(-sigma_t * (z + s)) * z / (4 * np.pi * s**3)
    return albedo * sigma_t * np.sum(per_area * z_w, axis=1) @ (r_w * 2 * np.pi * r)


@pytest.mark.parametrize("trace", [False, True])
def test_single_scattering(trace):
    """In closed form; deep and wide enough to have no other end."""
    thick = stack(medium(1.0, 0.9), thickness=30.0, size=20.0)
    found = profile(thick, order=1, trace=trace)
    rings = [single_scattering(a, b, 1.0, 0.9) for a, b in pairwise(RADII[1:])]
    areas = np.pi * np.diff(np.square(RADII))[1:]
    value, std_err = found.reflectance[1:, 0], found.reflectance_std_err[1:, 0]
    expected = np.array(rings) / areas
    n = found.settings["batches"] - 1
    agree(verdict(normal_scores((value - expected) / std_err, n)))
    disagree(verdict(normal_scores((value - 1.1 * expected) / std_err, n)))


def test_rings_and_the_rest_are_all_that_left():
    """Rounding: the sums are those of a measurement with the same seed."""
    scene = stack(medium(2.0, 0.9, 0.75))
    found = profile(scene)
    areas = np.pi * np.diff(np.square(RADII))[:, None]
    record = gonio.measure(
        scene, 0, period="box", rays=100_000, sampler="independent", footprint="point"
    )
    above = (found.reflectance * areas).sum(axis=0) + found.beyond[0]
    below = (found.transmittance * areas).sum(axis=0) + found.beyond[1]
    np.testing.assert_allclose(above, record.dhr, rtol=1e-12)
    np.testing.assert_allclose(below, record.dht, rtol=1e-12)
    assert found.ledger == record.ledger
    # direct light leaves below the point where it entered
    assert found.transmittance[0] * areas[0] > record.direct


def test_a_profile_says_what_it_is_in_a_line():
    found = gonio.exit_profile({"type": "diffuse"}, RADII, rays=1000)
    assert str(found) == (
        "<ExitProfile of diffuse: 5 rings from 0 to 1.6, 1 000 rays, dhr [0.5]>"
    )
    assert found == found, "one by one, not by arrays"


@pytest.mark.parametrize(
    ("radii", "words"),
    [
        ([1.0], "radii must be 2 to"),
        (1.0, "radii must be 2 to"),
        ([0.0, 1.0, 1.0], "ascending"),
        ([-1.0, 1.0], "radii must be numbers of at least 0"),
        ([0.0, np.nan], "radii must be numbers"),
    ],
)
def test_no_radii(radii, words):
    with pytest.raises(ValueError, match=words):
        gonio.exit_profile(stack(medium()), radii, period="box")


def test_settings_that_it_has_not():
    with pytest.raises(ValueError, match="exit_profile does not accept footprint"):
        gonio.exit_profile(stack(medium()), RADII, footprint=1.0)
    with pytest.raises(ValueError, match="exit_profile does not accept noise"):
        gonio.exit_profile(stack(medium()), RADII, noise=0.01)


@pytest.mark.parametrize("how", [{}, {"trace": True}])
def test_light_that_scatters_at_a_surface_leaves_where_it_came(how):
    """Estimators that deposit light by its direction know nothing of the place."""
    plate = {"type": "diffuse", "reflectance": 0.5}
    for estimator in ("weighted", "analog"):
        found = gonio.exit_profile(plate, RADII, estimator=estimator, **how)
        within = found.reflectance[0] * np.pi * RADII[1] ** 2
        assert within == pytest.approx(found.dhr, rel=4 * np.finfo(float).eps)
        assert not found.reflectance[1:].any()
        assert not found.beyond.any()
    for estimator in ("quadrature", "next_event"):
        with pytest.raises(ValueError, match="must be one of weighted, analog, got"):
            gonio.exit_profile(plate, RADII, estimator=estimator, **how)
