"""BSDFs of NumPy functions are judged like plugins."""

import sys

import budget
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi.validation import evidence, from_numpy, validate
from gonio_mi.validation.maps import four_maps, in_radiance_mode


def above(wi, wo):
    return (wi[:, 2] > 0) & (wo[:, 2] > 0)


def sample(wi, u):
    """Cosine-distributed directions."""
    radius, phi = np.sqrt(u[:, 1]), 2 * np.pi * u[:, 2]
    z = np.sqrt(1 - u[:, 1])
    wo = np.column_stack([radius * np.cos(phi), radius * np.sin(phi), z])
    return wo, 0.5 * above(wi, wo), z / np.pi * above(wi, wo)


def value(wi, wo):
    return 0.5 / np.pi * wo[:, 2] * above(wi, wo)


def density(wi, wo):
    return wo[:, 2] / np.pi * above(wi, wo)


def test_right_functions_pass():
    bsdf = from_numpy(sample, value, density)
    verdict = validate(bsdf, effort="quick", alpha=budget.ALPHA, strict=True)
    assert verdict.passed, str(verdict)


@pytest.mark.parametrize(
    ("functions", "guilty"),
    [
        ((sample, lambda wi, wo: 0.5 / np.pi * above(wi, wo), density), "eval"),
        ((sample, value, lambda wi, wo: 1.01 * density(wi, wo)), "pdf"),
        ((lambda wi, u: sample(wi, np.sqrt(u)), value, density), "sample"),
    ],
)
def test_wrong_functions_are_named(functions, guilty):
    """The twins."""
    verdict = validate(from_numpy(*functions), effort="quick")
    assert not verdict.passed
    assert verdict.function == guilty, str(verdict)


def test_they_can_be_measured():
    """Half of the light leaves; all weights are that, to rounding of one product."""
    record = gonio.measure(from_numpy(sample, value, density), theta_i=30, rays=2**14)
    assert abs(record.dhr[0] - 0.5) <= 4 * np.finfo(np.float32).eps


def test_maps_have_their_own_samples_after_one_that_failed(monkeypatch):
    """Their scores are pooled; a map whose integrals do not converge has none."""
    keys = []

    def fails_at_first(bsdf, condition, patches, n, key):
        keys.append(key)
        if len(keys) == 1:
            return None
        return four_maps(bsdf, condition, patches, n, key)

    def radiance(bsdf, maps, key):
        keys.append(key)
        return in_radiance_mode(bsdf, maps, key)

    monkeypatch.setattr(evidence, "four_maps", fails_at_first)
    module = sys.modules["gonio_mi.validation.examination"]
    monkeypatch.setattr(module, "in_radiance_mode", radiance)
    bsdf = from_numpy(sample, value, density, two_sided=True)
    validate(bsdf, effort="quick")
    assert len(set(keys)) == len(keys) > 2


def test_each_must_be_a_function():
    with pytest.raises(TypeError, match="pdf must be a function, got float"):
        from_numpy(sample, value, 0.3)
