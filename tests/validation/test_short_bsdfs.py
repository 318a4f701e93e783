"""Short plugins of many kinds: broken ones are found and named, right ones pass.

GONIO_EFFORT=normal (or thorough) examines them harder than quick.
"""

import os
from dataclasses import replace

import mitsuba as mi
import pytest
import right_bsdfs
import short_bsdfs
from broken_bsdfs import judged
from right_bsdfs import PUBLISHED
from short_bsdfs import MISTAKES, MISTAKES_IN_RGB, RIGHT

from gonio_mi.validation import save_report, validate
from gonio_mi.validation.checks import cost
from gonio_mi.validation.conditions import Condition
from gonio_mi.validation.evidence import Evidence

EFFORT = os.environ.get("GONIO_EFFORT", "quick")


def check_found(name, guilty):
    found = judged(name, EFFORT)
    verdict = replace(found, settings=found.settings | {"strict": True})
    assert not verdict.passed, str(verdict)
    assert {*verdict.function.split(" or ")} & {*guilty.split(" or ")}, str(verdict)


@pytest.mark.parametrize(("name", "guilty"), MISTAKES.items())
def test_broken_plugin_is_found_and_named(name, guilty):
    short_bsdfs.register()
    check_found(name, guilty)


def test_counts_explain_the_wrong_mean_of_right_weights():
    """However small the share of `sampling` is beside that of `weights`."""
    short_bsdfs.register()
    verdict = judged("sample_of_another_exponent", "quick")
    assert verdict.function == "sample", str(verdict)
    assert "directions are drawn" in verdict.mistake


def test_page_begins_with_the_direction_that_fails(tmp_path):
    """Of a sector of incidence, where no other map is; what holds is folded."""
    short_bsdfs.register()
    verdict = judged("pdf_in_a_sector", "quick")
    verdict = replace(verdict, maps=verdict.maps[:2])
    save_report(verdict, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    first, *others = (str(maps.condition) for maps in verdict.maps)
    assert 60 < verdict.maps[0].condition.phi_i < 75
    drawn = text.index(f"<h2>{first}</h2>")
    folded = text.index("<details>", drawn)
    assert text.index('class="fails"') < text.index("<details>") < drawn
    assert all(text.index(f"<h2>{one}</h2>") > folded for one in others)
    assert len({first, *others}) == len(verdict.maps)


def test_cost_is_not_compared_with_itself():
    """The twin is a plugin of the same lobes."""
    short_bsdfs.register()
    for name, same in (("diffuse", True), ("two_lobes", False)):
        evidence = Evidence(mi.load_dict({"type": name}))
        cost.check_time(evidence, Condition(40.0))
        assert ("times as long" in evidence.remarks["cost"][0]) == (not same)


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize(("name", "guilty"), MISTAKES_IN_RGB.items())
def test_exchanged_colours_are_found(name, guilty):
    short_bsdfs.register()
    check_found(name, guilty)


@pytest.mark.parametrize("name", [*RIGHT, *PUBLISHED])
def test_unusual_right_plugin_passes(name):
    """The twins; the false-alarm probability is that of the user."""
    (right_bsdfs if name in PUBLISHED else short_bsdfs).register()
    verdict = validate({"type": name}, effort=EFFORT)
    assert verdict.passed, str(verdict)
    interface = [one.name for one in verdict.failures]
    assert interface == ["eval_pdf_sample"] * (name == "own_eval_pdf_sample")
    assert mi.variant() == "llvm_ad_mono"
