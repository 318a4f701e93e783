"""Cosines that are wrong in all functions alike, which only an identity tells.

Weights are values over densities, whatever these are, so that nothing contradicts
anything, but for `eval` with wi and wo exchanged, and the density of what is drawn.
"""

import broken_bsdfs
import pytest
from broken_bsdfs import judged

# Plugin, and what is said of it.
VALUES = [
    ("value_without_cosine", "`eval` lacks the factor cos(theta_o)"),
    ("value_with_two_cosines", "`eval` has an extra factor cos(theta_o)"),
    ("value_with_cosine_of_wi", "`eval` has cos(theta_i) in place"),
]

# Twins: a power of the cosine that is none of these, one that is not everywhere, and
# a Fresnel term.
MODELS = (
    "value_over_root_of_cosine",
    "value_without_cosine_if_steep",
    "fresnel_not_reciprocal",
)


@pytest.fixture
def plugins(mono):
    broken_bsdfs.register()
    return mono


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(("name", "said"), VALUES)
def test_a_wrong_cosine_is_a_mistake(name, said):
    verdict = judged(name, "quick")
    assert not verdict.passed
    assert verdict.function == "eval"
    assert verdict.headline.startswith(f"{name}: FAILS: biases images. Most ")
    assert f"likely: {said}" in verdict.headline
    assert verdict.failures[0].reach == "all integrators"


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", MODELS)
def test_another_law_is_a_property_of_the_model(name):
    verdict = judged(name, "quick")
    assert verdict.passed, str(verdict)
    assert verdict["reciprocity"].status == "fails"
    assert verdict["reciprocity"].effect == "a property of the model"
    assert "cos" not in verdict.mistake


@pytest.mark.usefixtures("plugins")
def test_the_mistake_comes_before_its_symptom():
    """Of brighter facets much light is gained; the twin gains it by reflectance."""
    for name, said, passed in (
        ("bright_value_without_cosine", "`eval` lacks the factor cos(theta_o)", False),
        ("bright_facets", "`eval` is not energy conserving: ", True),
    ):
        verdict = judged(name, "quick")
        assert verdict["energy"].status == "fails"
        assert said in verdict.headline
        assert verdict.passed == passed


@pytest.mark.usefixtures("plugins")
def test_a_declared_law_passes():
    verdict = judged("value_without_cosine_by_declaration", "quick")
    assert verdict["reciprocity"].status == "lacks"
    assert verdict.passed, str(verdict)


@pytest.mark.usefixtures("plugins")
def test_the_cosine_of_the_half_vector_is_recognised():
    """The twin is tilted as no list knows: either function may be wrong."""
    known = judged("density_without_cosine_of_h", "quick")
    assert known.function == "pdf"
    assert known.mistake.startswith("`pdf` lacks the factor cos(theta_h) of")
    twin = judged("density_tilted", "quick")
    assert twin.function == "sample or pdf"
    assert twin.mistake.startswith("`sample` or `pdf`: directions are drawn with")
