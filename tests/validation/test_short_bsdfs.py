"""Short plugins of many kinds: broken ones are found and named, right ones pass."""

import mitsuba as mi
import pytest
import short_bsdfs
from short_bsdfs import MISTAKES, MISTAKES_IN_RGB, RIGHT

from gonio_mi.validation import validate


def check_found(name, guilty):
    verdict = validate({"type": name}, effort="quick", strict=True)
    assert not verdict.passed, str(verdict)
    assert {*verdict.function.split(" or ")} & {*guilty.split(" or ")}, str(verdict)


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize(("name", "guilty"), MISTAKES.items())
def test_broken_plugin_is_found_and_named(name, guilty):
    short_bsdfs.register()
    check_found(name, guilty)


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize(("name", "guilty"), MISTAKES_IN_RGB.items())
def test_exchanged_colours_are_found(name, guilty):
    short_bsdfs.register()
    check_found(name, guilty)


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("name", RIGHT)
def test_unusual_right_plugin_passes(name):
    """The twins; the false-alarm probability is that of the user."""
    short_bsdfs.register()
    verdict = validate({"type": name}, effort="quick")
    assert verdict.passed, str(verdict)
    interface = [one.name for one in verdict.failures]
    assert interface == ["eval_pdf_sample"] * (name == "own_eval_pdf_sample")
    assert mi.variant() == "llvm_ad_mono"
