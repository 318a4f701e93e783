"""Phase functions are judged: broken ones named, stock ones passed or confirmed."""

from functools import cache

import broken_phase_functions
import mitsuba as mi
import numpy as np
import pytest
from reproduced import is_short, told

from gonio_mi.cli import main
from gonio_mi.errors import SpecimenError
from gonio_mi.validation import reproducer, validate


def flakes(*values):
    grid = mi.VolumeGrid(np.array(values, np.float32).reshape(1, 1, 1, 6))
    return {"type": "gridvolume", "grid": grid, "filter_type": "nearest"}


@pytest.fixture
def plugins(mono):
    broken_phase_functions.register()
    return mono


# What is found in Mitsuba's own, confirmed by notebooks/reproducers/.
STOCK = {
    "isotropic": ({"type": "isotropic"}, []),
    "hg": ({"type": "hg", "g": 0.8}, []),
    "hg of 0": ({"type": "hg", "g": 0.0}, []),
    "hg backward": ({"type": "hg", "g": -0.3}, []),
    "hg_sharp": ({"type": "hg", "g": 0.999}, ["sampling", "weights"]),
    "rayleigh": ({"type": "rayleigh"}, []),
    "tabphase": ({"type": "tabphase", "values": "0.5, 1.0, 1.5"}, []),
    "blendphase": (
        {
            "type": "blendphase",
            "weight": 0.3,
            "a": {"type": "isotropic"},
            "b": {"type": "hg", "g": 0.6},
        },
        [],
    ),
    "sggx_straight_on": ((1, 1, 1, 0, 0, 0), ["ends"]),
    "sggx_density": ((0.05, 1, 0.3, 0.1, 0, 0), ["ends", "sampling", "weights"]),
}


@pytest.mark.parametrize("name", STOCK)
def test_stock(name):
    specimen, failures = STOCK[name]
    if isinstance(specimen, tuple):
        specimen = {"type": "sggx", "S": flakes(*specimen)}
    verdict = validate(specimen, effort="quick", strict=True)
    assert sorted(one.name for one in verdict.failures) == failures, str(verdict)
    assert not verdict.undecided


@pytest.mark.parametrize("name", broken_phase_functions.RIGHT)
@pytest.mark.usefixtures("plugins")
def test_right_one_passes(name):
    verdict = validate({"type": name}, effort="quick", strict=True)
    assert verdict.passed, str(verdict)


@cache
def judged(name):
    """Verdict on a broken one."""
    return validate({"type": name}, effort="quick", strict=True)


# What is said where a frame is known; the second is the twin of the first.
SAID = {
    "draws_local": "`sample` draws directions about z, not about wi",
    "draws_backward": "`sample` draws directions opposite to the right",
}


@pytest.mark.parametrize("name", broken_phase_functions.MISTAKES)
@pytest.mark.usefixtures("plugins")
def test_mistake_is_seen_and_its_function_named(name):
    verdict = judged(name)
    assert verdict.mistake.startswith(SAID.get(name, ""))
    assert not verdict.passed, str(verdict)
    guilty = broken_phase_functions.MISTAKES[name]
    assert guilty in verdict.function.split(" or "), str(verdict)


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        ("draws_another_g", "sampling"),
        ("weight_of_albedo", "sampled_weight"),
        ("of_one_way", "reciprocity"),
        ("gains_one_percent", "energy"),
    ],
)
@pytest.mark.usefixtures("plugins")
def test_finding_is_shown_by_its_script(name, finding):
    text = reproducer(judged(name), finding)
    assert "phase = mi.load_dict" in text
    assert is_short(text), text
    assert told(text) > 1, text


@pytest.mark.usefixtures("rgb")
def test_a_script_of_all_directions_runs_in_colours():
    """Its four moments are of the mean of three channels."""
    verdict = validate({"type": "hg", "g": 0.999}, effort="quick", strict=True)
    text = reproducer(verdict, "sampling")
    assert "moments" in text
    assert told(text) >= 0


def test_command(capsys):
    words = ["validate", "hg:g=0.8", "--variant", "llvm_ad_mono", "--effort", "quick"]
    assert main(words) == 0
    assert "hg:g=0.8: nothing wrong was found" in capsys.readouterr().out


def test_polarised_variants_are_refused():
    before = mi.variant()
    mi.set_variant("llvm_ad_mono_polarized")
    try:
        with pytest.raises(SpecimenError, match="in unpolarised variants"):
            validate({"type": "rayleigh"}, effort="quick")
    finally:
        mi.set_variant(before)


def test_microflakes_have_the_area_that_eval_is_divided_by():
    """All but the area is that of `sggx`, of which nothing is to be seen."""

    class Straight(mi.PhaseFunction):
        tilt = 0.0

        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            s = flakes(0.5, 1, 0.8, 0, 0, 0)
            self.sggx = mi.load_dict({"type": "sggx", "S": s})
            self.m_flags = mi.PhaseFunctionFlags.Microflake
            self.m_components = [self.m_flags]

        def sample(self, *asked):
            return self.sggx.sample(*asked)

        def eval_pdf(self, *asked):
            return self.sggx.eval_pdf(*asked)

        def projected_area(self, mei, active):
            return self.sggx.projected_area(mei, active) * (1 + self.tilt * mei.wi.x)

        def to_string(self):
            return "Flakes[]"

    class Tilted(Straight):
        tilt = 0.3

    mi.register_phase("straight", Straight)
    mi.register_phase("tilted", Tilted)
    right = validate({"type": "straight"}, effort="quick")
    assert right["reciprocity"].status == "holds"
    verdict = validate({"type": "tilted"}, effort="quick")
    found = verdict["reciprocity"]
    assert found.function == "eval or projected_area"
    assert found.mistake.startswith("`eval` or `projected_area`: their product is not")
    script = reproducer(verdict, "reciprocity")
    assert told(script) > 1
    assert told(script.replace('"tilted"', '"straight"')) < 1
