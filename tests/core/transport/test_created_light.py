"""More light than came is told, and never of a specimen that is right.

The intervals of level 1 - 1e-9 leave chance no part in these tests.
"""

import warnings

import pytest

import gonio_mi as gonio

SETTINGS = {"rays": 10_000, "collector": "projected:4x4"}


def diffuse(reflectance):
    return {
        "type": "diffuse",
        "reflectance": {"type": "uniform", "value": reflectance},
    }


@pytest.mark.parametrize("estimator", ["weighted", "quadrature"])
@pytest.mark.parametrize("reflectance", [1.7, 1.001])
def test_a_reflectance_above_one_is_told(estimator, reflectance):
    # so many rays that some lost unseen cannot be the reason
    settings = SETTINGS | {"rays": 10**5, "estimator": estimator}
    with pytest.warns(RuntimeWarning, match=f"energy conserving: {reflectance}"):
        gonio.measure(diffuse(reflectance), 30, **settings)


@pytest.mark.parametrize(
    ("specimen", "sampler"),
    [
        (diffuse(1.0), "independent"),
        ({"type": "conductor"}, "sobol"),
        ({"type": "roughconductor", "alpha": 0.02}, "independent"),
        ({"type": "dielectric"}, "independent"),
        ({"type": "roughdielectric", "alpha": 0.3}, "sobol"),
        ({"type": "cosinelobe", "exponent": 50, "reflectance": 1.0}, "sobol"),
    ],
    ids=lambda one: one["type"] if isinstance(one, dict) else one,
)
def test_white_specimens_are_right(specimen, sampler):
    for settings in ({}, {"trace": True}, {"rays": 40}, {"estimator": "analog"}):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            gonio.measure(
                specimen, [0, 60, 89], **SETTINGS | {"sampler": sampler} | settings
            )
