"""A collimated beam whose directions fill a cone."""

import numpy as np
import pytest
from budget import agree, disagree, verdict

import gonio_mi as gonio

MIRROR = {"type": "conductor", "material": "none"}
RAYS = 2**18
DIVERGENCE, INNER = 4.0, 2.0
SETTINGS = {
    "rays": RAYS,
    "estimator": "analog",
    "sampler": "independent",
    "footprint": "point",
    "divergence": DIVERGENCE,
}


def reflected(half_angle, **settings):
    """Rays in an aperture about the mirror direction of 30 degrees, 40 degrees."""
    record = gonio.measure(
        MIRROR,
        30,
        40,
        collector=gonio.Apertures(half_angle, ((30, 220),)),
        **SETTINGS | settings,
    )
    return int(record.counts.ravel()[0])  # the rest is that of the hemisphere


def solid_angle(half_angle):
    return 1 - np.cos(np.radians(half_angle))


@pytest.mark.parametrize("trace", [False, True])
def test_mirror_reflects_the_cone(trace):
    """Statistics: of a smaller cone the share is the ratio of the solid angles.

    The twin: of a smaller cone half a degree wider. Rounding: none is out of its own.
    """
    inside = reflected(INNER, trace=trace, seed=int(trace))
    share = solid_angle(INNER) / solid_angle(DIVERGENCE)

    def score(p):
        return (inside - RAYS * p) / np.sqrt(RAYS * p * (1 - p))

    agree(verdict([score(share)]))
    disagree(verdict([score(solid_angle(INNER + 0.5) / solid_angle(DIVERGENCE))]))
    assert reflected(DIVERGENCE * (1 + 1e-5), trace=trace) == RAYS
    assert reflected(DIVERGENCE * (1 - 0.02), trace=trace) < RAYS


def test_records_tell_the_divergence():
    with_divergence = gonio.measure(MIRROR, 30, **SETTINGS | {"rays": 100})
    assert with_divergence.settings["divergence"] == DIVERGENCE
    assert gonio.measure(MIRROR, 30, rays=100).settings["divergence"] == 0


@pytest.mark.parametrize(
    ("theta_i", "settings", "reason"),
    [
        (87, {}, "theta_i and divergence together must be below 90 degrees, got 87"),
        (30, {"estimator": "quadrature"}, "needs a collimated beam"),
        (
            None,
            {"emitter": {"type": "point", "position": [0, 0, 5]}},
            "divergence must be 0 for light that is not collimated, got 4 degrees",
        ),
    ],
)
def test_refused(theta_i, settings, reason):
    with pytest.raises(gonio.SpecimenError, match=reason):
        gonio.measure(MIRROR, theta_i, **SETTINGS | settings)
