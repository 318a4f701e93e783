"""One lobe among others with a wrong cosine: which is, and what cannot be told.

All weights follow `eval`, so that nothing but reciprocity contradicts it. The twins are
right, or not reciprocal by a law of their own.
"""

import broken_bsdfs
import broken_lobes
import pytest

from gonio_mi.validation import validate

LACKS = "`eval` lacks the factor cos(theta_o), or division by cos(theta_i), in "
TWICE = "`eval` has an extra factor cos(theta_o), or an extra division by cos(theta_i)"
OF_WI = "`eval` has cos(theta_i) in place of cos(theta_o), in "
OF_IT = "the part of it that the parameter "
HORIZON = "one lobe of several: it does not fall to 0 as wo falls to the horizon"

# How lobes are told, their wrong powers of the cosine, and what is said of it.
WRONG = [
    ("components", {"diffuse_power": 0}, LACKS + "its component 0"),
    ("components", {"glossy_power": 2}, TWICE + ", in its component 1"),
    ("parameters", {"glossy_power": 0}, LACKS + OF_IT + "ks changes"),
    ("parameters", {"diffuse_power": -1}, OF_WI + OF_IT + "kd"),
    ("nothing", {"diffuse_power": 0}, LACKS + HORIZON),
    ("nothing", {"glossy_power": 0}, LACKS + HORIZON),
    ("nothing", {"diffuse_power": -1}, OF_WI + HORIZON),
]

# What is a law of a model, as far as is known, and which mistake would look so.
UNKNOWN = [
    ("components", {"coupled": True}, None),
    ("parameters", {"coupled": True}, "lacks the factor cos(theta_o)"),
    ("nothing", {"coupled": True}, "lacks the factor cos(theta_o)"),
    # a mistake indeed
    ("nothing", {"diffuse_power": 2}, "has an extra factor cos(theta_o)"),
]


@pytest.fixture
def plugins(mono):
    broken_lobes.register()
    broken_bsdfs.register()
    return mono


def judged(told, changes):
    return validate({"type": "lobes", "told": told} | changes, effort="quick")


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(("told", "changes", "said"), WRONG)
def test_a_wrong_cosine_of_one_lobe_is_a_mistake(told, changes, said):
    verdict = judged(told, changes)
    assert not verdict.passed
    assert verdict.function == "eval"
    assert verdict["reciprocity"].effect == "biases images"
    assert verdict["reciprocity"].mistake == verdict.mistake
    assert verdict.mistake.startswith(said)


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(("told", "changes", "alike"), UNKNOWN)
def test_what_would_look_so_is_told(told, changes, alike):
    verdict = judged(told, changes)
    assert verdict.passed, str(verdict)
    assert verdict["reciprocity"].effect == "a property of the model"
    if alike is None:
        # components were asked one by one
        assert "cosine" not in verdict.mistake
    else:
        assert f"one of several lobes that {alike}" in verdict.headline
        assert "; validate each lobe alone" in verdict.headline


@pytest.mark.usefixtures("plugins")
def test_right_lobes_and_declared_ones_pass():
    for changes in ({}, {"diffuse_power": 0, "declared": True}):
        verdict = judged("components", changes)
        assert verdict.function is None, str(verdict)


@pytest.mark.usefixtures("plugins")
def test_a_lobe_inside_of_another_plugin_is_found():
    """Mitsuba's own `blendbsdf`, that asks for components, of a right and a wrong one.

    The twin has a Fresnel term that is not reciprocal.
    """
    for name, said in (
        ("value_without_cosine", LACKS + "its component 1"),
        ("fresnel_not_reciprocal", "`eval` is not symmetric in wi and wo"),
    ):
        blend = {"type": "blendbsdf", "weight": 0.5, "a": {"type": "diffuse"}}
        verdict = validate(blend | {"b": {"type": name}}, effort="quick")
        assert verdict["reciprocity"].mistake.startswith(said), str(verdict)
        assert (verdict["reciprocity"].effect == "biases images") == ("lacks" in said)
